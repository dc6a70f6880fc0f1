import math

import numpy as np
import pytest
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.richness import RichnessEstimate, estimate_richness

Found = NDArray[np.bool_]


def incidence(runs: int, *times: int) -> Found:
    """Cells of which each was found by so many runs, the first of them."""
    return np.arange(runs)[:, None] < np.array(times)


def estimated(found: Found) -> RichnessEstimate:
    estimate = estimate_richness(found)
    assert estimate is not None
    return estimate


def test_the_unseen_cells_follow_from_those_that_one_run_and_two_runs_found() -> None:
    found = estimated(incidence(5, *[1] * 10, *[2] * 4, *[5] * 6, 0))
    assert (found.runs, found.seen, found.once, found.twice) == (5, 20, 10, 4)
    assert found.unseen == pytest.approx(4 / 5 * 10**2 / (2 * 4)) == 10.0
    assert (found.total, found.completeness) == (30.0, 20 / 30)


def test_where_no_cell_was_found_twice_the_corrected_form_is_taken() -> None:
    assert estimated(incidence(4, *[1] * 6, *[3] * 2)).unseen == pytest.approx(3 / 4 * 6 * 5 / 2)


def spread(runs: int, once: int, twice: int) -> Found:
    """Cells that single runs and pairs of runs found, alike for all runs."""
    first = np.eye(runs, dtype=bool).repeat(once // runs, axis=1)
    pairs = np.eye(runs, dtype=bool) | np.roll(np.eye(runs, dtype=bool), 1, axis=0)
    return np.concatenate([first, pairs.repeat(twice // runs, axis=1)], axis=1)


def test_the_interval_is_that_of_the_logarithm_of_the_unseen_cells() -> None:
    """Worked out by hand: every run found alike, so that leaving one out gives the same each time."""
    found = estimated(spread(5, once=10, twice=5))
    assert found.unseen == pytest.approx(0.8 * 100 / 10)
    variance = 5 * (0.8 * 4 / 2 + 0.64 * 8 + 0.64 * 16 / 4)
    factor = math.exp(1.96 * math.sqrt(math.log(1 + variance / 8.0**2)))
    assert found.low == pytest.approx(15 + 8 / factor, rel=1e-4)
    assert found.high == pytest.approx(15 + 8 * factor, rel=1e-4)


def test_without_pairs_the_interval_follows_from_the_single_cells() -> None:
    found = estimated(spread(2, once=8, twice=0))
    variance = 0.5 * 8 * 7 / 2 + 0.25 * 8 * 15**2 / 4 - 0.25 * 8**4 / (4 * found.total)
    factor = math.exp(1.96 * math.sqrt(math.log(1 + variance / found.unseen**2)))
    assert (found.unseen, found.high) == (14.0, pytest.approx(8 + 14 * factor, rel=1e-4))


def test_runs_that_differ_widen_the_interval() -> None:
    """Both found 10 cells once and 5 twice; here one run found all of the single ones."""
    alike, unlike = spread(5, once=10, twice=5), incidence(5, *[1] * 10, *[0] * 5)
    unlike[:, 10:] = alike[:, 10:]
    assert estimated(unlike).total == estimated(alike).total
    assert estimated(unlike).high > estimated(alike).high


@pytest.mark.parametrize("times", [(2, 2, 3), (1, 2, 2), (1, 3, 3)])
def test_nearly_nothing_is_unseen_where_nearly_all_was_found_again(times: tuple[int, ...]) -> None:
    found = estimated(incidence(3, *times))
    assert found.unseen <= 1 / 6 + 1e-12
    assert found.further_runs(0.9) == 0
    if not found.unseen:
        assert (found.low, found.high, found.completeness) == (None, None, 1.0)
        assert found.total_words() == "an estimated 3 or more"


def test_a_single_run_or_no_cell_gives_no_estimate() -> None:
    assert estimate_richness(incidence(1, 1, 1)) is None
    assert estimate_richness(np.zeros((0, 5), bool)) is None
    assert estimate_richness(np.zeros((7, 5), bool)) is None
    assert estimate_richness(np.zeros((7, 0), bool)) is None


def test_runs_without_a_cell_count_as_runs() -> None:
    one_of_three = np.array([[1, 1, 1], [0, 0, 0], [0, 0, 0]], bool)
    found = estimated(one_of_three)
    assert (found.runs, found.unseen) == (3, 2 / 3 * 3)


CELLS, SETS = 4000, 60
CLUMP = 20  # Cells that a run finds together


def drawn(runs: int, chances: NDArray[np.float64], seed: int, clump: int = 1) -> Found:
    """Cells found by runs, each with its probability; `clump` cells are found together."""
    uniform = np.random.default_rng(seed).random((runs, len(chances) // clump))
    return np.repeat(uniform < chances[::clump], clump, axis=1)


def alike(seed: int) -> NDArray[np.float64]:
    return np.full(CELLS, 0.2)


def unequal(seed: int) -> NDArray[np.float64]:
    """Many cells that are hardly ever found; the mean is 0.2."""
    return np.random.default_rng(1000 + seed).beta(0.6, 2.4, CELLS // CLUMP).repeat(CLUMP)


def estimates(runs: int, clump: int = 1, chances=alike) -> list[RichnessEstimate]:
    return [estimated(drawn(runs, chances(seed), seed, clump)) for seed in range(SETS)]


@pytest.mark.parametrize("runs", [2, 3, 5, 10])
def test_of_cells_that_are_found_as_easily_the_number_is_estimated_well(runs: int) -> None:
    found = estimates(runs)
    assert np.mean([one.total for one in found]) == pytest.approx(CELLS, rel=0.02)
    assert np.mean([one.seen for one in found]) < 0.9 * CELLS
    assert np.mean([math.floor(one.low) <= CELLS <= one.high for one in found]) >= 0.9


@pytest.mark.parametrize(
    ("runs", "seen", "total"), [(3, 0.40, 0.58), (5, 0.51, 0.67), (10, 0.64, 0.77), (25, 0.78, 0.86)]
)
def test_of_cells_that_differ_the_number_is_estimated_too_low_and_nearer_than_what_is_seen(runs, seen, total):
    """The shares of docs/coverage.md; Chao's estimate is a lower bound."""
    found = estimates(runs, chances=unequal)
    assert np.mean([one.seen for one in found]) / CELLS == pytest.approx(seen, abs=0.015)
    assert np.mean([one.total for one in found]) / CELLS == pytest.approx(total, abs=0.015)
    assert np.mean([one.low for one in found]) < CELLS


@pytest.mark.parametrize("runs", [3, 5, 10])
def test_the_interval_holds_where_a_run_finds_cells_together(runs: int) -> None:
    found = estimates(runs, CLUMP)
    assert np.mean([math.floor(one.low) <= CELLS <= one.high for one in found]) >= 0.9


@pytest.mark.parametrize("runs", [3, 10])
def test_the_sample_coverage_is_the_share_of_another_run_s_cells_that_are_in_the_set(runs: int) -> None:
    shares = []
    for seed in range(SETS):
        found = drawn(runs + 1, unequal(seed), seed)
        seen, another = found[:-1].any(axis=0), found[-1]
        shares.append((estimated(found[:-1]).sample_coverage, (seen & another).sum() / another.sum()))
    expected, counted = np.mean(shares, axis=0)
    assert expected == pytest.approx(counted, abs=0.03)


def test_as_many_more_runs_as_are_said_find_the_share_that_was_asked_for() -> None:
    more = [one.further_runs(0.95) for one in estimates(5)]
    (needed,) = {round(float(np.mean(more)))}
    seen = [one.seen for one in estimates(5 + needed)]
    assert np.mean([one.seen for one in estimates(5 + needed - 2)]) < 0.95 * CELLS <= np.mean(seen)


@pytest.mark.parametrize(("each", "most"), [(2, 1.8), (5, 1.2)])
def test_cells_that_one_kind_of_runs_alone_reaches_are_overestimated_within_bounds(each, most) -> None:
    """Five methods, each with cells of its own: the bound of docs/coverage.md."""
    excess = []
    for seed in range(SETS):
        parts = [drawn(each, np.full(CELLS // 5, 0.3), 5 * seed + kind) for kind in range(5)]
        found = np.zeros((5 * each, CELLS), bool)
        for kind, part in enumerate(parts):
            found[kind * each : (kind + 1) * each, kind * CELLS // 5 : (kind + 1) * CELLS // 5] = part
        one = estimated(found)
        excess.append(one.unseen / (CELLS - one.seen))
    assert 1.0 < np.mean(excess) == pytest.approx(most, rel=0.05)
