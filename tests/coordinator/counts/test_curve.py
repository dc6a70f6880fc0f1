"""How the counts of a run grew, in few points."""

from dataclasses import dataclass

import numpy as np
import pytest
from tests.coordinator.runs.plans import Plan, evaluate

from qdgrasp_coordinator.counts.curve import POINTS, Trail


@dataclass(frozen=True)
class Counts:
    evaluations: int
    proposals: int = 0
    successes: int = 0
    cells: int = 0
    robust: int = 0


def noted(generations: int) -> list[int]:
    trail = Trail()
    for generation in range(1, generations + 1):
        trail.note(Counts(generation))
    return [point.evaluations for point in trail.curve("run").points]


@pytest.mark.parametrize("generations", [0, 1, POINTS, POINTS + 1, POINTS + 2, 3 * POINTS, 10_000])
def test_a_curve_has_evenly_spaced_points_from_the_first_to_the_last_or_nearly(generations: int) -> None:
    points = noted(generations)
    steps = {after - before for before, after in zip([0, *points], points, strict=False)}
    assert len(steps) <= 1
    assert len(points) == min(generations, len(points)) <= POINTS
    assert generations - (points or [0])[-1] < max(steps, default=1)


def test_thinning_keeps_at_least_half_of_the_points() -> None:
    assert all(len(noted(generations)) >= POINTS // 2 for generations in range(POINTS, 3 * POINTS, 7))


def test_a_run_that_is_replayed_has_the_same_curve_whatever_pieces_it_comes_in() -> None:
    plan = Plan(population=8, evaluations=100)
    pipeline = plan.pipeline()
    journal = []
    while (asked := pipeline.ask()) is not None:
        rows = plan.task.shape.empty(len(asked.indices))
        rows["generation"], rows["index"], rows["genome"] = asked.number, asked.indices, asked.genomes
        journal += [pipeline.settle(part).rows for part in np.array_split(evaluate(rows), 3)]
    again = plan.pipeline()
    for part in np.array_split(np.concatenate(journal), 7):
        again.replay(part)
    curve = pipeline.trail.curve("run")
    assert again.trail.curve("run") == curve
    assert curve.points[-1].evaluations == 100
