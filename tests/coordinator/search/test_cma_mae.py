"""CMA_MAE: what it refuses, and a digest of its asks."""

import numpy as np
import pytest

from qdgrasp_coordinator.search.paper_searches import CmaMae, check_cma
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.rows import Outcome, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec

SHAPE = RowShape(genes=4, joints=1)
BOX = (np.full(3, -0.2), np.full(3, 0.2))


def spec(population: int = 150, seed: int = 0, in_flight: int = 1) -> RunSpec:
    values = {"method": "cma_mae", "population": population, "seed": seed, "generations_in_flight": in_flight}
    return RunSpec(gripper="hand", object="thing", **values)


def evaluated(genomes: np.ndarray, outcome: Outcome | None = None) -> Rows:
    """Rows of genomes: a greater last gene is a better one, unless all come out the same."""
    rows = SHAPE.empty(len(genomes))
    rows["genome"] = genomes
    steps = [Outcome.OVERLAP, Outcome.MISSED, Outcome.DROPPED, Outcome.SHAKEN, Outcome.HELD]
    rows["outcome"] = [steps[place] for place in np.searchsorted([0.0, 0.5, 0.7, 0.9], genomes[:, 3])]
    if outcome is not None:
        rows["outcome"] = outcome
    rows["fitness"] = np.maximum(rows["outcome"].astype(float) - Outcome.DROPPED, 0)
    rows["descriptor"] = genomes[:, :3] * np.float32(0.2)
    return rows


def play(search: CmaMae, generations: int, outcome: Outcome | None = None) -> list[np.ndarray]:
    all_asked = []
    for generation in range(generations):
        all_asked.append(search.ask(generation))
        search.tell(generation, evaluated(all_asked[-1], outcome))
    return all_asked


@pytest.mark.parametrize("population", [1, 15, 40])
def test_a_population_that_cannot_be_shared_is_refused(population: int) -> None:
    with pytest.raises(
        ImpossibleValue, match=r"^population must be a multiple of 15, at least 30, for cma_mae"
    ):
        check_cma(spec(population))


def test_a_second_generation_in_flight_is_refused() -> None:
    with pytest.raises(ImpossibleValue, match=r"^generations_in_flight must be 1 for cma_mae.*got 2"):
        CmaMae(spec(in_flight=2), SHAPE.genes, BOX)
