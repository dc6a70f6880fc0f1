from typing import Any

import pytest
from tests.tools.report.made_runs import climb, made

from qdgrasp_tools.report.run_groups import group_runs
from qdgrasp_tools.report.run_history import RunHistory
from qdgrasp_tools.report.setting_sweeps import draw_sweeps, setting_sweeps


def swept(sigma: float, cells: int, seed: int = 0, **settings: Any) -> RunHistory:
    """A run with a sigma that found so many cells."""
    values = {"method": "me_scs"} | settings
    return made(values.pop("method"), climb(cells), seed, mutation_sigma=sigma, **values)


def test_a_setting_that_differs_within_a_method_is_an_axis() -> None:
    runs = [
        swept(sigma, cells, seed) for sigma, cells in ((0.4, 3), (0.1, 8), (0.02, 9)) for seed in (0, 1, 2)
    ]
    (sweep,) = setting_sweeps(group_runs([*runs, made("contact_rand", climb(1))]))
    assert (sweep.setting, sweep.scene.words, sweep.method_variant) == (
        "mutation_sigma",
        "jaw on block",
        ("me_scs", ""),
    )
    assert [(one.value, one.range, len(one.reached)) for one in sweep.values] == [
        (0.02, (9, 9, 9), 3), (0.1, (8, 8, 8), 3), (0.4, (3, 3, 3), 3),
    ]  # fmt: skip
    assert (sweep.best.value, sweep.default and sweep.default.value) == (0.02, 0.1)


def test_the_range_of_a_value_is_over_its_seeds() -> None:
    runs = [swept(sigma, cells, seed) for seed, cells in enumerate((4, 6, 11)) for sigma in (0.2, 0.3)]
    (sweep,) = setting_sweeps(group_runs(runs))
    assert sweep.values[0].range == (4, 6, 11)
    assert sweep.default is None


def test_all_runs_on_a_scene_are_compared_after_as_many_evaluations() -> None:
    found = climb(1, 2, 3)
    runs = [made("me_scs", found, evaluations=20, mutation_sigma=0.1)]
    runs += [made("me_scs", found, mutation_sigma=0.2), made("me_rand", found, mutation_sigma=0.1)]
    (sweep,) = setting_sweeps(group_runs(runs))
    assert (sweep.evaluations, [one.range for one in sweep.values]) == (20, [(2, 2, 2), (2, 2, 2)])


def test_of_two_settings_that_differ_each_is_an_axis_with_the_other_one_equal() -> None:
    runs = [
        swept(sigma, cells, mutation_probability=probability)
        for sigma, probability, cells in ((0.1, 0.3, 1), (0.1, 1.0, 2), (0.2, 0.3, 3), (0.2, 1.0, 4))
    ]
    lines = {
        (sweep.setting, sweep.variant): [one.range[1] for one in sweep.values]
        for sweep in setting_sweeps(group_runs(runs))
    }
    assert lines == {
        ("mutation_sigma", "mutation probability 0.3"): [1, 3],
        ("mutation_sigma", "mutation probability 1.0"): [2, 4],
        ("mutation_probability", "mutation sigma 0.1"): [1, 2],
        ("mutation_probability", "mutation sigma 0.2"): [3, 4],
    }


@pytest.mark.parametrize(
    "settings",
    [
        ({"overlaps": "count"}, {"overlaps": "redraw"}),
        ({"surface_seed": 0}, {"surface_seed": 1}),
        ({"in_flight": None}, {"in_flight": 1000}),
    ],
)
def test_words_names_of_draws_and_a_lone_number_are_no_axis(settings: tuple[dict[str, Any], ...]) -> None:
    assert setting_sweeps(group_runs([made("aimed", climb(1), seed=0, **each) for each in settings])) == []


def test_objects_are_pooled_before_they_stand_alone() -> None:
    runs = [
        swept(sigma, cells, object=name) for sigma in (0.1, 0.2) for name, cells in (("mug", 2), ("bowl", 6))
    ]
    found = setting_sweeps(group_runs(runs))
    assert [(sweep.scene.words, sweep.values[0].range[1]) for sweep in found] == [
        ("jaw on 2 objects", 4), ("jaw on bowl", 6), ("jaw on mug", 2),
    ]  # fmt: skip


def test_each_setting_begins_a_row() -> None:
    runs = [
        swept(sigma, 1, object=name, population=population)
        for name in ("a", "b", "c", "d", "e")
        for sigma, population in ((0.1, 60), (0.2, 60), (0.1, 120))
    ]
    grid = draw_sweeps(setting_sweeps(group_runs(runs)))
    assert (grid.rows, grid.columns) == (4, 4)
