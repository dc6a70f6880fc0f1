import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.coordinator.analysis.runs import climb, made

from qdgrasp_coordinator.analysis.curves import CELLS, COVERAGE, curve, measure_of, quartiles
from qdgrasp_coordinator.analysis.entries import entries


def entry(*runs):
    (one,) = entries(runs)
    return one


def test_a_curve_is_the_median_over_its_runs() -> None:
    one = entry(*(made("me_scs", climb(*(k * step for step in range(1, 11))), seed=k) for k in (1, 2, 6)))
    found = curve(one, CELLS)
    place = found.evaluations.tolist().index(50)
    assert (found.low[place], found.median[place], found.high[place]) == (7.5, 10, 20)
    assert (found.evaluations[0], found.median[0], found.evaluations[-1], found.median[-1]) == (0, 0, 100, 20)


def test_a_shorter_run_counts_as_far_as_it_goes() -> None:
    long = made("me_scs", climb(*range(1, 11)), seed=0)
    short = made("me_scs", climb(30, 60), seed=1, evaluations=25)
    found = curve(entry(long, short), CELLS)
    at = {e: (n, m) for e, n, m in zip(found.evaluations, found.runs, found.median, strict=True)}
    assert at[25] == (2, (2 + 60) / 2)
    assert at[26] == (1, 2)
    assert found.evaluations[: found.whole][-1] == 25


def test_a_run_that_has_not_begun_does_not_count() -> None:
    found = curve(entry(made("me_scs", climb(4)), made("me_scs", climb(), seed=1, evaluations=0)), CELLS)
    assert found.runs[-1] == 1
    assert found.median[-1] == 4


@given(st.lists(st.lists(st.integers(0, 5), min_size=1, max_size=10), min_size=1, max_size=5))
def test_where_all_runs_are_in_it_a_curve_never_falls(gains: list[list[int]]) -> None:
    runs = [
        made("me_scs", climb(*np.cumsum(gain).tolist()), seed=seed, evaluations=10 * len(gain))
        for seed, gain in enumerate(gains)
    ]
    found = curve(entry(*runs), CELLS, points=20)
    for part in (found.low, found.median, found.high):
        assert (np.diff(part[: found.whole]) >= 0).all()
    assert (found.low <= found.median).all()
    assert (np.diff(found.runs) <= 0).all()


def test_scenes_compare_by_cells_where_one_entry_lacks_a_set() -> None:
    lacking = entry(made("me_scs", climb(1)))
    assert measure_of([lacking]) is CELLS
    assert np.isnan(COVERAGE.of(lacking.runs[0], [10])).all()


def test_quartiles_of_nothing_are_not_numbers() -> None:
    found = quartiles(np.array([[1.0, np.nan], [3.0, np.nan]]))
    assert found[:, 0] == pytest.approx([1.5, 2, 2.5])
    assert np.isnan(found[:, 1]).all()
