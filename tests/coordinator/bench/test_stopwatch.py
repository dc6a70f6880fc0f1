"""What workers did in a time."""

import pytest

from qdgrasp_coordinator.bench.figures import pace, run_seconds, scaling
from qdgrasp_coordinator.bench.regimes import Regime
from qdgrasp_coordinator.bench.stopwatch import Lap, Stopwatch, Tick, tick
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.messages import Result
from qdgrasp_protocol.outcome import Outcome


def stopwatch(*ticks: Tick) -> Stopwatch:
    noted = Stopwatch()
    noted._ticks.extend(ticks)
    return noted


def regular(wid: str, every: float, rows: int, start: float = 0.0, generation: int = 5) -> list[Tick]:
    """A worker that gives `rows` rows `every` so many seconds, for which it needs half of the time."""
    return [Tick(start + every * i, wid, generation, rows, every / 2, 1, 2) for i in range(1, 9)]


def test_a_lap_counts_no_part_of_a_batch() -> None:
    lap = stopwatch(*regular("a", 1.0, 10)).lap(5, 2.5)
    assert (lap.workers, lap.rows) == (1, 60)
    assert lap.per_second == pytest.approx(10.0)
    assert lap.cpu_seconds == pytest.approx(3.0)
    assert (lap.overlaps, lap.successes) == (6, 12)


def test_workers_add_up_whenever_their_batches_come() -> None:
    noted = stopwatch(*regular("a", 1.0, 10), *regular("b", 0.7, 14, start=0.3))
    assert noted.lap(5, 2.2).per_second == pytest.approx(10.0 + 20.0)


def test_a_worker_that_went_is_left_out_and_one_that_came_counts_from_its_first_result() -> None:
    went, came = Tick(1.0, "b", 5, 99, 1.0, 0, 0), Tick(6.0, "c", 5, 99, 1.0, 0, 0)
    noted = stopwatch(*regular("a", 1.0, 10), went, came)
    assert noted.lap(5, 2.5) == stopwatch(*regular("a", 1.0, 10)).lap(5, 2.5)
    later = stopwatch(*regular("a", 1.0, 10), *regular("c", 0.5, 10, start=4.0))
    assert later.lap(5, 2.5).per_second == pytest.approx(10.0 + 20.0)
    assert stopwatch(went).lap(5, 0.0).workers == 0


def test_results_of_earlier_generations_are_of_another_turn() -> None:
    noted = stopwatch(*regular("a", 1.0, 10, generation=4), *regular("a", 1.0, 7, start=8.0))
    assert (noted.workers(5), noted.workers(6)) == (1, 0)
    assert noted.rows(5) == 8 * 7
    assert noted.lap(5, 0.0).rows == 7 * 7


def test_what_is_no_result_is_passed_over() -> None:
    noted = Stopwatch()
    noted.take(Sample("key", b"nonsense", "application/json"))
    assert not noted.has_begun


def test_a_result_tells_how_its_rows_ended() -> None:
    outcomes = [Outcome.OVERLAP, Outcome.OVERLAP, Outcome.BRUSHED, Outcome.DROPPED, Outcome.HELD]
    result = Result(
        epoch=1,
        run="run",
        generation=3,
        batch=bytes(16),
        attempt=1,
        wid="0" * 32,
        n=5,
        joints=2,
        descriptors=3,
        columns={"outcome": bytes(outcomes)},
        cpu_seconds=0.5,
    )
    assert tick(result, 9.0) == Tick(9.0, "0" * 32, 3, 5, 0.5, 2, 2)


def test_scaling_and_the_time_of_a_run_are_those_of_all_workers() -> None:
    paces = [
        pace(Regime.NEAR, workers, Lap(workers, 100, rate, 100 / 30, 10, 60))
        for workers, rate in ((1, 30.0), (4, 90.0))
    ]
    assert scaling(paces) == {"near grasps": pytest.approx(3.0)}
    assert run_seconds(paces) == {"near grasps": pytest.approx(10_000 / 90)}
    assert [pace.core_share for pace in paces] == [pytest.approx(1.0), pytest.approx(0.75)]
    assert paces[0].success_share == pytest.approx(0.6)
    assert scaling(paces[:1]) == {}
