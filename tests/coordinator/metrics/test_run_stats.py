import numpy as np
import pytest
from msgspec import structs

from qdgrasp_coordinator.metrics import run_stats
from qdgrasp_coordinator.metrics.run_stats import BARREN, BARREN_GENOMES, CURVE_POINTS, RunCounter, count_rows
from qdgrasp_protocol.rows import Outcome, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec

SHAPE = RowShape(genes=2, joints=1)


def rows(*outcomes: Outcome, generation: int = 0) -> Rows:
    made = SHAPE.empty(len(outcomes))
    made["generation"], made["index"] = generation, np.arange(len(outcomes))
    made["outcome"] = outcomes
    made["steps"] = 3
    return made


def test_every_outcome_is_counted_where_it_belongs() -> None:
    total = RunCounter(redrawn(100))
    total.count(rows(*Outcome))
    total.count(rows(*Outcome, generation=1))
    found = total.totals
    figures = (found.errors, found.dead_ends, found.overlaps, found.simulated, found.successes)
    assert figures == (2, 2, 2, 10, 6)
    assert (found.grasps, found.robust, total.rows, found.evaluations) == (4, 2, 16, 10)
    assert found.steps == 48


def blocks(*generations: Rows, size: int) -> list[Rows]:
    journal = np.concatenate(generations)
    return [journal[first : first + size] for first in range(0, len(journal), size)]


def redrawn(population: int) -> RunSpec:
    return RunSpec(gripper="hand", object="thing", population=population, overlaps="redraw")


def barren(population: int, generations: int, first: int = 0) -> list[Rows]:
    """Generations of which nothing was simulated."""
    return [rows(*[Outcome.OVERLAP] * population, generation=first + number) for number in range(generations)]


@pytest.mark.parametrize("size", [7, 50, 10_000])
@pytest.mark.parametrize(
    ("population", "generations"), [(500, BARREN), (50, BARREN), (40, BARREN_GENOMES // 40)]
)
def test_a_journal_tells_that_the_last_generations_counted_nothing(size, population, generations) -> None:
    good = rows(Outcome.MISSED, *[Outcome.OVERLAP] * (population - 1))
    bad = barren(population, generations, first=1)
    words = f"the last {population * generations} genomes, {generations} generations, counted no evaluation"
    assert count_rows(redrawn(population), blocks(good, *bad, size=size)).finished == words
    assert count_rows(redrawn(population), blocks(good, *bad[:-1], size=size)).finished is None


@pytest.mark.parametrize("size", [1, 3, 100])
def test_generations_of_a_programs_own_search_end_where_the_next_begins(size: int) -> None:
    spec = RunSpec(gripper="hand", object="thing", method="custom_contact", evaluations=9)
    counter = RunCounter(spec)
    for block in blocks(*(rows(*[Outcome.HELD] * 2, generation=number) for number in range(3)), size=size):
        counter.count_block(block)
    assert [point.evaluations for point in counter.curve("run").points] == [2, 4]
    whole = structs.replace(spec, evaluations=6)
    counter = RunCounter(whole)
    for block in blocks(*(rows(*[Outcome.HELD] * 2, generation=number) for number in range(3)), size=size):
        counter.count_block(block)
    assert [point.evaluations for point in counter.curve("run").points] == [2, 4, 6]


def robust_journal() -> Rows:
    """Two generations of two rows, a success with a hundred trials in each."""
    parts = []
    for number in range(2):
        nominal = rows(Outcome.HELD, Outcome.MISSED, generation=number)
        trials = rows(*[Outcome.SHAKEN] * 100, generation=number)
        trials["index"], trials["trial"] = 0, np.arange(1, 101)
        parts += [nominal, trials]
    return np.concatenate(parts)


@pytest.mark.parametrize("size", [1, 3, 101, 1000])
def test_a_journal_with_trials_is_complete_when_the_last_trial_is_recorded(size: int) -> None:
    spec = RunSpec(gripper="hand", object="thing", population=2, evaluations=4, protocol="robust")
    journal = robust_journal()
    total = count_rows(spec, blocks(journal[:-1], size=size))
    assert (total.evaluations, total.totals.successes, total.trials, total.finished) == (4, 2, 199, None)
    total = count_rows(spec, blocks(journal, size=size))
    assert total.finished == "the budget of 4 evaluations is spent"


def recorded(generations: int) -> list[int]:
    recorder = run_stats.CurveRecorder()
    for generation in range(1, generations + 1):
        recorder.record(run_stats.CurvePoint(generation, 0, 0, 0, 0, 0))
    return [point.evaluations for point in recorder.points]


@pytest.mark.parametrize(
    "generations", [0, 1, CURVE_POINTS, CURVE_POINTS + 1, CURVE_POINTS + 2, 3 * CURVE_POINTS, 10_000]
)
def test_a_curve_has_evenly_spaced_points_from_the_first_to_the_last_or_nearly(generations: int) -> None:
    points = recorded(generations)
    steps = {after - before for before, after in zip([0, *points], points, strict=False)}
    assert len(steps) <= 1
    assert len(points) == min(generations, len(points)) <= CURVE_POINTS
    assert generations - (points or [0])[-1] < max(steps, default=1)
