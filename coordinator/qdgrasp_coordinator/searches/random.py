"""Random search: fresh uniform genomes in every generation.

The released code of the paper re-evaluates the individuals of its first generation when it does not count
overlaps, and evaluates that generation twice in any case; here every genome is a new draw.
"""

import numpy as np

from qdgrasp_coordinator.searches.draws import draws
from qdgrasp_protocol.genome import Genomes
from qdgrasp_protocol.rows import Rows


def uniform(seed: int, generation: int, n: int, genes: int) -> Genomes:
    """Genomes (n, genes) drawn from U(-1, 1)."""
    return draws(seed, "uniform", generation).uniform(-1.0, 1.0, (n, genes)).astype(np.float32)


class RandomSearch:
    """Asks `population` uniform genomes per generation; what it is told changes nothing."""

    def __init__(self, seed: int, population: int, genes: int) -> None:
        self._seed = seed
        self._size = (population, genes)

    def ask(self, generation: int) -> Genomes:
        """The next uniform genomes: (population, genes)."""
        return uniform(self._seed, generation, *self._size)

    def tell(self, generation: int, rows: Rows) -> None:
        """Nothing is learned."""
