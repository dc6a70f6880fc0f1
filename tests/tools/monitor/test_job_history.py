"""Series: growth of figures, in few points."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.tools.monitor.sample_jobs import figures

from qdgrasp_tools.monitor.job_model import MAX_POINTS, WINDOW, SeriesBuilder, ThinnedSamples


@given(st.lists(st.integers(0, 50), min_size=1, max_size=2000), st.integers(4, 40))
def test_thinned_points_are_few_in_order_and_hold_the_first_and_the_newest(steps, most) -> None:
    thinned: ThinnedSamples[int] = ThinnedSamples(float, most)
    places = [sum(steps[: number + 1]) for number in range(len(steps))]
    for place in places:
        thinned.add(place)
    assert len(thinned.points) <= most
    assert thinned.points == sorted(set(thinned.points))
    assert (thinned.points[0], thinned.points[-1]) == (places[0], places[-1])


def test_points_stay_evenly_spread_however_long_it_takes() -> None:
    thinned: ThinnedSamples[int] = ThinnedSamples(float, 100)
    for place in range(100_000):
        thinned.add(place)
    gaps = [after - before for before, after in zip(thinned.points, thinned.points[1:], strict=False)]
    assert len(thinned.points) >= 40
    assert max(gaps) <= 4 * 100_000 / 100


def test_the_columns_of_a_history_are_of_one_length_and_bounded() -> None:
    history = SeriesBuilder()
    for second in range(3 * MAX_POINTS):
        history.add(figures(evaluations=second, seconds=float(second)), float(second))
    series = history.series
    assert {len(getattr(series, name)) for name in series.__struct_fields__} == {len(series.at)}
    assert len(series.at) <= MAX_POINTS
    assert series.evaluations[-1] == 3 * MAX_POINTS - 1


def rates(*fresh_by_second: float) -> list[float]:
    """The rates of a coordinator that has evaluated so much by each second."""
    history = SeriesBuilder()
    for second, fresh in enumerate(fresh_by_second):
        rate = fresh / second if second else 0.0
        history.add(figures(seconds=float(second), rate=rate), 1000.0 + second)
    return history.series.rate


def test_a_rate_is_of_the_window_before_it() -> None:
    fast = [990.0 + 50.0 * second for second in range(1, 101)]
    found = rates(*(10.0 * second for second in range(100)), *fast)
    assert found[50] == pytest.approx(10.0)
    assert found[99 + round(WINDOW)] == pytest.approx(50.0)
    assert 10.0 < found[110] < 50.0


def test_a_coordinator_that_begins_to_count_anew_makes_no_rate_negative_or_huge() -> None:
    history = SeriesBuilder()
    for second in range(120):
        history.add(figures(seconds=float(second % 60), rate=10.0), 1000.0 + second)
    assert max(history.series.rate) == pytest.approx(10.0)
    assert min(history.series.rate) >= 0.0
