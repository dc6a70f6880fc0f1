"""Genomes anywhere and near grasps."""

import numpy as np
import pytest
from tests.fakes.messages import result_message

from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.rows import Gene, Layout, Outcome, Rows, RowShape
from qdgrasp_tools.local.benchmark_figures import (
    BENCH_PRIOR,
    GENE_SIGMA,
    MOST_LOOKED_AT,
    PARENTS,
    PoseRegime,
    RegimeSearch,
    ReturnedBatch,
    Throughput,
    ThroughputMeter,
    regime_rate,
    returned_batch,
    run_seconds,
    scaling,
)

LAYOUT = Layout(BENCH_PRIOR, (Gene("x", -1.0, 1.0), Gene("nu", 0.0, np.pi), Gene("d", 0.0, 0.1)))


def rows(genomes: np.ndarray, *outcomes: Outcome) -> Rows:
    found = RowShape(len(LAYOUT), 1).empty(len(genomes))
    found["genome"], found["outcome"] = genomes, np.resize(outcomes, len(genomes))
    return found


def look(search: RegimeSearch, *outcomes: Outcome) -> int:
    """Look for enough grasps; returns the number of generations."""
    generation = 0
    while not search.has_parents:
        search.tell(generation, rows(search.ask(generation), *outcomes))
        generation += 1
    return generation


def test_grasps_are_looked_for_where_the_hand_faces_the_surface() -> None:
    nu = LAYOUT.values(RegimeSearch(LAYOUT).ask(0))[:, 1]
    assert nu.min() >= 0
    assert np.pi / 4 > nu.max() > np.pi / 5


def test_the_first_grasps_are_the_parents_and_successes_that_dropped_the_object_are_not() -> None:
    search = RegimeSearch(LAYOUT)
    first = search.ask(0)
    search.tell(0, rows(first, Outcome.DROPPED, Outcome.SHAKEN, Outcome.MISSED, Outcome.HELD))
    assert search.has_parents
    np.testing.assert_array_equal(search.parents, first[1::2][:PARENTS])


def test_parents_do_not_depend_on_what_is_asked_in_between() -> None:
    plain, other = RegimeSearch(LAYOUT), RegimeSearch(LAYOUT)
    look(plain, Outcome.MISSED, *[Outcome.OVERLAP] * 60, Outcome.HELD)
    other.ask(0)
    look(other, Outcome.MISSED, *[Outcome.OVERLAP] * 60, Outcome.HELD)
    np.testing.assert_array_equal(plain.parents, other.parents)


def test_a_scene_without_grasps_is_given_up() -> None:
    search = RegimeSearch(LAYOUT)
    assert look(search, Outcome.DROPPED) * search.population == MOST_LOOKED_AT
    assert search.parents.shape == (0, len(LAYOUT))


def test_near_grasps_each_gene_is_moved_a_little() -> None:
    search = RegimeSearch(LAYOUT)
    look(search, Outcome.HELD)
    search.start_regime(PoseRegime.NEAR, 500)
    genomes = search.ask(7)
    away = np.linalg.norm(genomes[:, None] - search.parents, axis=2).min(axis=1)
    assert genomes.shape == (500, len(LAYOUT))
    assert np.abs(genomes).max() <= 1
    assert 0 < away.max() < 5 * GENE_SIGMA


@pytest.mark.parametrize("generation", [3, 40])
def test_a_turn_begins_with_the_next_generation(generation: int) -> None:
    search = RegimeSearch(LAYOUT)
    search.ask(generation)
    search.start_regime(PoseRegime.ANYWHERE, 12)
    assert search.since == generation + 1
    assert LAYOUT.values(search.ask(generation + 1))[:, 1].max() > np.pi / 4


def stopwatch(*ticks: ReturnedBatch) -> ThroughputMeter:
    noted = ThroughputMeter()
    noted._batches.extend(ticks)
    return noted


def regular(
    wid: str, every: float, rows: int, start: float = 0.0, generation: int = 5
) -> list[ReturnedBatch]:
    """A worker that gives `rows` rows `every` so many seconds, and needs half of the time."""
    return [ReturnedBatch(start + every * i, wid, generation, rows, every / 2, 1, 2) for i in range(1, 9)]


def test_a_throughput_counts_no_part_of_a_batch() -> None:
    work = stopwatch(*regular("a", 1.0, 10)).throughput(5, 2.5)
    assert (work.workers, work.rows) == (1, 60)
    assert work.per_second == pytest.approx(10.0)
    assert work.cpu_seconds == pytest.approx(3.0)
    assert (work.overlaps, work.successes) == (6, 12)


def test_workers_add_up_whenever_their_batches_come() -> None:
    noted = stopwatch(*regular("a", 1.0, 10), *regular("b", 0.7, 14, start=0.3))
    assert noted.throughput(5, 2.2).per_second == pytest.approx(10.0 + 20.0)


def test_a_worker_that_went_is_left_out_and_one_that_came_counts_from_its_first_result() -> None:
    went, came = ReturnedBatch(1.0, "b", 5, 99, 1.0, 0, 0), ReturnedBatch(6.0, "c", 5, 99, 1.0, 0, 0)
    noted = stopwatch(*regular("a", 1.0, 10), went, came)
    assert noted.throughput(5, 2.5) == stopwatch(*regular("a", 1.0, 10)).throughput(5, 2.5)
    later = stopwatch(*regular("a", 1.0, 10), *regular("c", 0.5, 10, start=4.0))
    assert later.throughput(5, 2.5).per_second == pytest.approx(10.0 + 20.0)
    assert stopwatch(went).throughput(5, 0.0).workers == 0


def test_results_of_earlier_generations_are_of_another_turn() -> None:
    noted = stopwatch(*regular("a", 1.0, 10, generation=4), *regular("a", 1.0, 7, start=8.0))
    assert (noted.workers(5), noted.workers(6)) == (1, 0)
    assert noted.rows(5) == 8 * 7
    assert noted.throughput(5, 0.0).rows == 7 * 7


def test_what_is_no_result_is_passed_over() -> None:
    noted = ThroughputMeter()
    noted.add(Sample("key", b"nonsense", "application/json"))
    assert not noted.has_begun


def test_a_result_tells_how_its_rows_ended() -> None:
    outcomes = [Outcome.OVERLAP, Outcome.OVERLAP, Outcome.BRUSHED, Outcome.DROPPED, Outcome.HELD]
    result = result_message(generation=3, n=5, columns={"outcome": bytes(outcomes)}, cpu_seconds=0.5)
    assert returned_batch(result, 9.0) == ReturnedBatch(9.0, "0" * 32, 3, 5, 0.5, 2, 2)


def test_scaling_and_the_time_of_a_run_are_those_of_all_workers() -> None:
    rates = [
        regime_rate(PoseRegime.NEAR, workers, Throughput(workers, 100, rate, 100 / 30, 10, 60))
        for workers, rate in ((1, 30.0), (4, 90.0))
    ]
    assert scaling(rates) == {"near grasps": pytest.approx(3.0)}
    assert run_seconds(rates) == {"near grasps": pytest.approx(10_000 / 90)}
    assert [rate.core_share for rate in rates] == [pytest.approx(1.0), pytest.approx(0.75)]
    assert rates[0].success_share == pytest.approx(0.6)
    assert scaling(rates[:1]) == {}
