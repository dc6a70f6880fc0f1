"""The optimisation archive against a dictionary of cells."""

import numpy as np
import pytest

from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.search.archive import EliteArchive
from qdgrasp_protocol.rows import Outcome, Rows, RowShape

SHAPE = RowShape(genes=3, joints=1)
BOX = (np.array([-0.052, -0.048, -0.05]), np.array([0.052, 0.031, 0.07]))


def rows(outcomes: list[Outcome], positions: list[list[float]]) -> Rows:
    """Rows whose first gene tells them apart."""
    made = SHAPE.empty(len(outcomes))
    made["outcome"] = outcomes
    made["fitness"] = np.maximum(made["outcome"].astype(float) - Outcome.DROPPED, 0)
    made["descriptor"] = positions
    made["genome"][:, 0] = np.arange(len(outcomes)) / 100
    return made


def random_rows(seed: int, n: int) -> Rows:
    generator = np.random.default_rng(seed)
    outcomes = [Outcome(value) for value in generator.integers(0, 8, n)]
    made = rows(outcomes, generator.uniform(-0.1, 0.1, (n, 3)).astype(np.float32).tolist())
    made["genome"] = generator.uniform(-1, 1, (n, 3))
    return made


def model(batches: list[Rows]) -> dict[tuple[int, ...], np.void]:
    """The same archive as a loop over rows: better replaces, a tie keeps the elder."""
    low, high = cells(np.stack(BOX))
    found: dict[tuple[int, ...], np.void] = {}
    for row in np.concatenate(batches):
        cell = cells(row["descriptor"][None])[0]
        if row["outcome"] < Outcome.MISSED or (cell < low).any() or (cell > high).any():
            continue
        elder = found.get(tuple(cell))
        if elder is None or quality(row) > quality(elder):
            found[tuple(cell)] = row
    return dict(sorted(found.items()))


def quality(row: np.void) -> float:
    return float(row["fitness"]) if row["outcome"] >= Outcome.DROPPED else -1.0


@pytest.mark.parametrize("seed", range(2))
def test_it_holds_what_a_loop_over_rows_would_hold(seed: int) -> None:
    batches = [random_rows(10 * seed + number, 400) for number in range(4)]
    archive = EliteArchive(3, BOX)
    for batch in batches:
        archive.insert(batch)
    expected = model(batches)
    elites = archive.elites
    assert np.array_equal(elites.genomes, np.stack([row["genome"] for row in expected.values()]))
    successful = [row["outcome"] >= Outcome.DROPPED for row in expected.values()]
    assert elites.successful.tolist() == successful
    assert (len(archive), archive.elites.successful.sum()) == (len(expected), sum(successful))


def test_positions_outside_the_box_are_left_out() -> None:
    archive = EliteArchive(3, BOX)
    inside = [[-0.0549, 0.0, 0.0], [0.0, 0.0349, 0.0], [0.0, 0.0, 0.0749]]
    outside = [[-0.0551, 0.0, 0.0], [0.0, 0.0351, 0.0], [0.0, 0.0, 0.0751], [9.0, 9.0, 9.0]]
    archive.insert(rows([Outcome.HELD] * 7, inside + outside))
    assert len(archive) == 3
