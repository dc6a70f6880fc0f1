from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import made_scene
from tests.tools.report.made_runs import climb, made

from qdgrasp_coordinator.metrics.reference_coverage import (
    CoverageTarget,
    ReferenceLookup,
    ReferenceOrigin,
    ReferenceSet,
)
from qdgrasp_coordinator.search.registry import METHODS
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.spec import FirstWeights
from qdgrasp_tools.report.run_groups import (
    CELLS,
    COVERAGE,
    RunGroup,
    curve_panels,
    default_groups,
    group_runs,
    measure_of,
    measure_words,
    pool_objects,
    quartile_curve,
    quartiles,
    read_histories,
    run_words,
    search_run_folders,
)
from qdgrasp_tools.report.run_history import RunHistory
from qdgrasp_tools.report.setting_sweeps import setting_sweeps


def test_runs_that_differ_in_their_seed_alone_are_one_entry() -> None:
    found = group_runs([made("me_scs", climb(1), seed=seed) for seed in (2, 0, 1)])
    assert [[run.spec.seed for run in group.runs] for group in found] == [[0, 1, 2]]
    assert found[0].name == "me_scs"


def test_hands_stand_in_the_paper_s_order_and_methods_in_that_of_the_table() -> None:
    runs = [
        made(method, climb(1), gripper=hand, object=thing)
        for hand in ("shadow", "panda", "own", "ref_bh280")
        for thing in ("mug", "bowl")
        for method in ("me_scs", "contact_rand")
    ]
    found = group_runs(runs)
    hands = dict.fromkeys(group.scene.gripper for group in found)
    assert list(hands) == ["panda", "ref_bh280", "shadow", "own"]
    assert [(group.scene.object, group.method) for group in found[:4]] == [
        ("bowl", "contact_rand"), ("bowl", "me_scs"), ("mug", "contact_rand"), ("mug", "me_scs"),
    ]  # fmt: skip


def test_settings_that_differ_within_a_method_tell_its_variants_apart() -> None:
    runs = [
        made("me_scs", climb(1), seed=seed, mutation_sigma=sigma) for seed in (0, 1) for sigma in (0.3, 0.05)
    ]
    found = group_runs([*runs, made("cma_mae", climb(1), population=540)])
    assert [(group.name, len(group.runs)) for group in found] == [
        ("me_scs mutation sigma 0.05", 2), ("me_scs mutation sigma 0.3", 2), ("cma_mae", 1),
    ]  # fmt: skip


def test_runs_whose_seed_chooses_the_surface_points_too_are_one_entry() -> None:
    def groups(*runs: RunHistory) -> list[tuple[str, int]]:
        return [(group.name, len(group.runs)) for group in group_runs(runs)]

    own, fixed, default = (
        [made("me_scs", climb(1), seed=seed, surface_seed=of(seed)) for seed in (0, 1, 2)]
        for of in (lambda seed: seed, lambda _: 2, lambda _: 0)
    )
    assert groups(*own) == groups(*fixed) == groups(*default) == [("me_scs", 3)]
    others = [made("me_scs", climb(1), seed=seed, surface_seed=7) for seed in (0, 1)]
    assert groups(*own, *others) == [("me_scs surface seed 7", 2), ("me_scs surface seed of the run", 3)]
    assert groups(*default, made("me_scs", climb(1), mutation_sigma=0.2)) == [
        ("me_scs mutation sigma 0.1", 3), ("me_scs mutation sigma 0.2", 1)
    ]  # fmt: skip


def test_runs_with_and_without_a_warm_start_are_variants() -> None:
    starts = [None, *(FirstWeights(touch=(weight,)) for weight in (0.5, 1.0, 1.0))]
    found = group_runs([made("aimed", climb(1), seed=i, first_weights=one) for i, one in enumerate(starts)])
    assert sorted(len(group.runs) for group in found) == [1, 1, 2]
    assert (
        next(group for group in found if group.runs[0].spec.seed == 0).name == "aimed first weights default"
    )
    assert len({group.name for group in found}) == 3


def test_the_usual_variant_of_a_method_is_the_one_nearest_to_the_defaults() -> None:
    runs = [made("me_scs", climb(1), mutation_sigma=sigma, population=60) for sigma in (0.02, 0.1, 0.4)]
    (by_method,) = default_groups(group_runs(runs)).values()
    assert by_method["me_scs"].runs[0].spec.mutation_sigma == 0.1


def test_a_run_with_the_flight_of_a_single_run_is_the_usual_one() -> None:
    usual = {"overlaps": "redraw", "aim_for": "hold", "generations_in_flight": 2}
    alone, other = (
        made("aimed", climb(1), population=population, in_flight=in_flight, **usual)
        for population, in_flight in ((METHODS["aimed"].population, 1200), (60, None))
    )
    (by_method,) = default_groups(group_runs([other, alone])).values()
    assert by_method["aimed"].runs[0].spec.in_flight == 1200
    less = made("aimed", climb(1), population=METHODS["aimed"].population, in_flight=300, **usual)
    (sweep,) = setting_sweeps(group_runs([less, alone]))
    assert (sweep.setting, sweep.default and sweep.default.value) == ("in_flight", 1200)


@pytest.mark.parametrize(("method", "counting"), [("aimed", "redraw"), ("me_scs", "count")])
def test_the_usual_variant_counts_as_its_method_does(method: str, counting: str) -> None:
    population = METHODS[method].population
    runs = [
        made(method, climb(1), overlaps=overlaps, population=population) for overlaps in ("count", "redraw")
    ]
    (by_method,) = default_groups(group_runs(runs)).values()
    assert by_method[method].overlaps == counting


def test_protocols_are_scenes_of_their_own() -> None:
    found = group_runs([made("me_scs", climb(1), protocol=name) for name in ("paper", "released")])
    assert [group.scene.words for group in found] == ["jaw on block", "jaw on block (released)"]


def test_an_unfinished_run_settles_nothing_beside_finished_ones() -> None:
    finished, going = made("me_scs", climb(1)), made("me_scs", climb(1), seed=1, evaluations=10)
    waiting = made("me_scs", climb(), seed=2, evaluations=0)
    (group,) = group_runs([finished, going, waiting])
    assert (group.unfinished, group.finished_runs) == (2, (finished,))
    (alone,) = group_runs([going, waiting])
    assert alone.finished_runs == (going,)


@pytest.mark.parametrize("home", ["runs", "."])
def test_runs_are_found_in_a_campaign_and_side_by_side(tmp_path: Path, home: str) -> None:
    (tmp_path / home).mkdir(exist_ok=True)
    (tmp_path / home / "analysis").mkdir()
    for name in ("b", "a"):
        record(tmp_path / home / name, made_scene(), random_rows(20))
    assert [folder.path.name for folder in search_run_folders(tmp_path)] == ["a", "b"]
    assert [folder.path.name for folder in search_run_folders(tmp_path / home / "a")] == ["a"]


def test_a_run_without_the_files_of_its_job_is_one_all_the_same(tmp_path: Path) -> None:
    (record(tmp_path / "a", made_scene(), random_rows(20)).path / "job.json").unlink()
    (found,) = read_histories(search_run_folders(tmp_path), ReferenceLookup())
    assert found.evaluations == 20


def test_runs_that_score_given_poses_are_passed_over(tmp_path: Path) -> None:
    pose = (0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0)
    scored = record(tmp_path / "scored", made_scene(), random_rows(1), method="given", poses=(pose,))
    with pytest.raises(FolderError, match="score given poses"):
        search_run_folders(scored.path)
    record(tmp_path / "searched", made_scene(), random_rows(20))
    assert [folder.path.name for folder in search_run_folders(tmp_path)] == ["searched"]


def test_a_folder_without_runs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FolderError, match="holds no runs: expected run folders in"):
        search_run_folders(tmp_path)
    with pytest.raises(FolderError, match="There is no folder"):
        search_run_folders(tmp_path / "nowhere")


def test_a_run_whose_scene_is_elsewhere_has_no_target(tmp_path: Path) -> None:
    folder = record(tmp_path / "a", made_scene(), random_rows(20))
    (folder.path / "scene.bundle").unlink()
    (found,) = read_histories([folder], ReferenceLookup())
    assert (found.target.size, found.target.why) == (0, "the run's scene is not here")
    assert found.evaluations == 20


def covered(thing: str, size: int, *found: int, seed: int = 0, **settings: Any) -> RunHistory:
    """A run that finds so many entries of a set, ten evaluations each."""
    known = ReferenceSet(thing, np.zeros((size, 3), np.int64), np.zeros(size, np.uint8))
    values: dict[str, Any] = {"method": "me_scs", "object": thing, "target": CoverageTarget(known)} | settings
    method = values.pop("method")
    return made(method, climb(1), seed, found=climb(*found), published=climb(*found), **values)


def pool(*runs: RunHistory) -> list[RunGroup]:
    return pool_objects(group_runs(runs))


def test_each_object_counts_alike_however_large_its_set() -> None:
    (group,) = pool(covered("mug", 10, 1, 2), covered("bowl", 1000, 200, 600))
    assert group.scene.words == "jaw on 2 objects"
    (run,) = group.runs
    assert run.coverage([0, 10, 15, 20]).tolist() == pytest.approx([0, 0.15, 0.15, 0.4])
    assert run.published_coverage(20) == pytest.approx(0.4)
    assert quartile_curve(group, COVERAGE).median[-1] == pytest.approx(0.4)


def test_a_pooled_run_is_as_long_as_the_shortest_and_finished_when_all_are() -> None:
    (group,) = pool(covered("mug", 10, 1), covered("bowl", 10, 1, evaluations=60))
    assert (group.runs[0].evaluations, group.unfinished) == (60, 1)


def test_objects_without_a_set_and_objects_that_a_method_lacks_are_left_out() -> None:
    both = [
        covered(thing, 10, 1, method=name) for thing in ("mug", "bowl") for name in ("me_scs", "contact_rand")
    ]
    lone = [covered("can", 10, 9, method="me_scs"), made("me_scs", climb(1), object="box")]
    found = pool(*both, *lone, *(made("contact_rand", climb(1), object="box"),))
    assert [(group.method, group.scene.object) for group in found] == [
        ("contact_rand", "2 objects"), ("me_scs", "2 objects"),
    ]  # fmt: skip
    assert found[1].runs[0].coverage(100) == pytest.approx(0.1)


def test_seeds_that_not_every_object_has_are_left_out() -> None:
    runs = [covered("mug", 10, 1, seed=seed) for seed in (0, 1)]
    (group,) = pool(*runs, covered("bowl", 10, 1, seed=1), covered("bowl", 10, 1, seed=0, evaluations=0))
    assert [run.spec.seed for run in group.runs] == [1]


def test_a_hand_with_one_object_in_common_has_its_scenes() -> None:
    found = pool(
        covered("mug", 10, 1),
        covered("mug", 10, 2, gripper="claw"),
        covered("bowl", 10, 1, gripper="claw", method="contact_rand"),
    )
    assert [group.scene.words for group in found] == ["claw on bowl", "claw on mug", "jaw on mug"]


def test_objects_of_which_fewer_than_two_have_a_set_are_pooled_by_their_cells() -> None:
    (group,) = pool(covered("mug", 10, 1), made("me_scs", climb(1, 3), object="box"))
    assert measure_of([group]) is CELLS
    assert CELLS.values(group.runs[0], [10, 20]).tolist() == [1, 2]
    assert measure_words(CELLS, group) == "success cells of 1 cm, mean over objects: no S_G"


def group(*runs):
    (one,) = group_runs(runs)
    return one


def test_a_curve_is_the_median_over_its_runs() -> None:
    one = group(*(made("me_scs", climb(*(k * step for step in range(1, 11))), seed=k) for k in (1, 2, 6)))
    found = quartile_curve(one, CELLS)
    place = found.evaluations.tolist().index(50)
    assert (found.low[place], found.median[place], found.high[place]) == (7.5, 10, 20)
    assert (found.evaluations[0], found.median[0], found.evaluations[-1], found.median[-1]) == (0, 0, 100, 20)


def test_a_shorter_run_counts_as_far_as_it_goes() -> None:
    long = made("me_scs", climb(*range(1, 11)), seed=0)
    found = quartile_curve(group(long, made("me_scs", climb(30, 60), seed=1, evaluations=25)), CELLS)
    at = {e: (n, m) for e, n, m in zip(found.evaluations, found.runs, found.median, strict=True)}
    assert at[25] == (2, (2 + 60) / 2)
    assert at[26] == (1, 2)
    assert found.evaluations[: found.common_points][-1] == 25


def test_a_run_that_has_not_begun_does_not_count() -> None:
    waiting = made("me_scs", climb(), seed=1, evaluations=0)
    found = quartile_curve(group(made("me_scs", climb(4)), waiting), CELLS)
    assert (found.runs[-1], found.median[-1]) == (1, 4)


@given(st.lists(st.lists(st.integers(0, 5), min_size=1, max_size=10), min_size=1, max_size=5))
def test_where_all_runs_are_in_it_a_curve_never_falls(gains: list[list[int]]) -> None:
    runs = [
        made("me_scs", climb(*np.cumsum(gain).tolist()), seed=seed, evaluations=10 * len(gain))
        for seed, gain in enumerate(gains)
    ]
    found = quartile_curve(group(*runs), CELLS)
    for part in (found.low, found.median, found.high):
        assert (np.diff(part[: found.common_points]) >= 0).all()
    assert (found.low <= found.median).all()
    assert (np.diff(found.runs) <= 0).all()


def test_scenes_compare_by_cells_where_one_entry_lacks_a_set() -> None:
    lacking = group(made("me_scs", climb(1)))
    assert measure_of([lacking]) is CELLS
    assert np.isnan(COVERAGE.values(lacking.runs[0], [10])).all()


def test_quartiles_of_nothing_are_not_numbers() -> None:
    found = quartiles(np.array([[1.0, np.nan], [3.0, np.nan]]))
    assert found[:, 0] == pytest.approx([1.5, 2, 2.5])
    assert np.isnan(found[:, 1]).all()


RUNS = [
    made(method, climb(3, 5), seed=seed) for method in ("contact_rand", "contact_me_scs") for seed in (0, 1)
]
LONE = made("me_scs", climb(1), evaluations=40)


@pytest.mark.parametrize(
    ("more", "room", "words"),
    [
        ([], 3, "2 seeds \u00d7 100 evaluations"),
        ([LONE], 4, "2 seeds \u00d7 100 evaluations; me_scs: 1 \u00d7 40, 1 unfinished"),
        ([LONE], 2, "1\u20132 seeds \u00d7 40\u2013100 evaluations, 1 unfinished"),
    ],
)
def test_the_heading_of_a_panel_says_how_many_seeds_and_evaluations_are_behind_its_curves(more, room, words):
    assert run_words(group_runs([*RUNS, *more]), room) == words


def test_a_scene_without_a_set_says_what_is_measured_and_why() -> None:
    (panel,) = curve_panels(group_runs(RUNS))
    assert panel.measure_words == "success cells of 1 cm: no S_G"
    assert (panel.end, panel.greatest_value) == (100, 5)


def test_how_complete_a_set_of_ones_own_is_stands_in_the_heading() -> None:
    cells, best = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[1, 1, 1], [0, 1, 1]], np.uint8)
    origin = ReferenceOrigin("jaw", "block", "x", ("paper",), ("a", "b"))
    known = ReferenceSet("block", cells, np.zeros(3, np.uint8), origin, best)
    for by_run, words in ((best, ", about 96% complete"), (best[:1], "")):
        target = CoverageTarget(replace(known, by_run=by_run))
        run = made("contact_rand", climb(1), target=target, found=climb(1))
        (panel,) = curve_panels(group_runs([run]))
        assert panel.measure_words == f"coverage of S_G{words}"
