from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.tools.report.made_runs import climb, made

from qdgrasp_tools.report.figures import draw_comparison, draw_nu, draw_variants, nu_distributions
from qdgrasp_tools.report.run_groups import curve_panels, group_runs, pool_objects
from qdgrasp_tools.report.run_history import NU_BINS, RunHistory

HANDS = ("panda", "barrett", "allegro", "shadow")


def leaning(method: str, bins: dict[int, int], **settings: Any) -> RunHistory:
    """A run with so many successes in some bins of nu."""
    nu: NDArray[np.int64] = np.zeros(NU_BINS, np.int64)
    nu[list(bins)] = list(bins.values())
    return made(method, climb(1), nu=nu, near=int(nu[: NU_BINS // 4].sum()), **settings)


def test_nu_is_told_hand_by_hand_of_contact_based_methods_alone() -> None:
    runs = [
        leaning(method, {0: 3, 20: 1}, gripper=hand)
        for hand in HANDS
        for method in ("contact_rand", "approach_rand", "me_scs")
    ]
    found = nu_distributions(group_runs(runs))
    assert [(one.hand, one.method) for one in found] == [
        (f"{hand} on block", "contact_rand") for hand in HANDS
    ]
    assert {(one.share[0], one.share[20], one.near.value) for one in found} == {(0.75, 0.25, 0.75)}


def test_each_scene_of_a_hand_counts_alike_in_its_nu() -> None:
    mug = [leaning("contact_rand", {0: 50}, seed=seed, object="mug") for seed in (0, 1, 2)]
    (one,) = nu_distributions(group_runs([*mug, leaning("contact_rand", {20: 2}, object="bowl")]))
    assert (one.hand, one.share[0], one.share[20], one.scenes, one.runs) == ("jaw", 0.5, 0.5, 2, 4)


def test_nu_has_a_row_for_each_hand_and_variant_and_a_column_for_each_method() -> None:
    runs = [leaning("contact_rand", {0: 1}, gripper=hand) for hand in HANDS]
    runs += [leaning("contact_me_scs", {0: 1}, gripper="panda", mutation_sigma=sigma) for sigma in (0.1, 0.2)]
    grid = draw_nu(nu_distributions(group_runs(runs)))
    assert (grid.rows, grid.columns, len(grid.figure.axes)) == (6, 2, 6)


@pytest.mark.parametrize("objects", [("mug",), ("mug", "bowl")])
def test_the_comparison_has_one_panel_for_each_hand(objects: tuple[str, ...]) -> None:
    runs = [made("contact_rand", climb(1), gripper=hand, object=thing) for hand in HANDS for thing in objects]
    grid = draw_comparison(curve_panels(pool_objects(group_runs(runs))))
    assert (grid.rows, grid.columns, len(grid.figure.axes)) == (2, 2, 4)


def test_the_figure_has_room_for_the_names_of_all_variants() -> None:
    methods = [f"{prior}me_scs" for prior in ("contact_", "approach_", "antipodal_", "")]
    runs = [made(method, climb(1), mutation_sigma=sigma) for method in methods for sigma in (0.025, 0.1)]
    grid = draw_variants(curve_panels(group_runs(runs)))
    grid.figure.draw_without_rendering()
    (legend,) = grid.figure.legends
    assert legend.get_window_extent().x1 <= grid.figure.bbox.x1
