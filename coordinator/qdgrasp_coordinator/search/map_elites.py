"""MAP-Elites with uniform or success-based selection, and uniform random search.

Huber et al. 2024, section III-B and appendix A, on Mouret and Clune 2015. As the paper states it: Gaussian
mutation of each gene with probability 0.3 and sigma 0.1, clipped to [-1, 1]. The released code mutates every
gene with sigma 0.05, and ignores successes until 500 cells hold one; see `select_successes`.

In random search every genome is a new draw. The released code of the paper re-evaluates the individuals of
its first generation when it does not count overlaps, and evaluates that generation twice in any case.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.search.archive import ArchiveElites, EliteArchive, PositionBox
from qdgrasp_coordinator.search.base import keyed_generator
from qdgrasp_protocol.rows import Genomes, Rows
from qdgrasp_protocol.spec import RunSpec


def uniform_genomes(seed: int, generation: int, n: int, genes: int) -> Genomes:
    """Genomes (n, genes) drawn from U(-1, 1)."""
    return keyed_generator(seed, "uniform", generation).uniform(-1.0, 1.0, (n, genes)).astype(np.float32)


class RandomSearch:
    """Asks `population` uniform genomes per generation; results change nothing."""

    def __init__(self, seed: int, population: int, genes: int) -> None:
        self._seed = seed
        self._size = (population, genes)

    def ask(self, generation: int) -> Genomes:
        """The next uniform genomes: (population, genes)."""
        return uniform_genomes(self._seed, generation, *self._size)

    def tell(self, generation: int, rows: Rows) -> None:
        """Learn nothing."""


Picks = NDArray[np.intp]
Select = Callable[[ArchiveElites, int, np.random.Generator], Picks]
"""Picks n parents, as places among the elites (at least one of them)."""


class MapElites:
    """Mutates parents from the archive; uniform genomes at first and while it is empty."""

    def __init__(self, spec: RunSpec, genes: int, box: PositionBox, select: Select) -> None:
        self.archive = EliteArchive(genes, box)
        self._spec = spec
        self._genes = genes
        self._select = select

    def ask(self, generation: int) -> Genomes:
        """Offspring of the elites: (population, genes)."""
        spec = self._spec
        elites = self.archive.elites
        if not len(elites):
            return uniform_genomes(spec.seed, generation, spec.population, self._genes)
        picks = self._select(elites, spec.population, keyed_generator(spec.seed, "parents", generation))
        return mutate(
            elites.genomes[picks],
            spec.mutation_sigma,
            spec.mutation_probability,
            keyed_generator(spec.seed, "mutation", generation),
        )

    def tell(self, generation: int, rows: Rows) -> None:
        """Offer the generation to the archive."""
        self.archive.insert(rows)


def mutate(parents: Genomes, sigma: float, probability: float, generator: np.random.Generator) -> Genomes:
    """Add N(0, sigma) to each gene with a probability, clipped to [-1, 1].

    As in the paper each gene is drawn on its own, so that with 7 genes at 0.3 about 8 % of the offspring are
    copies of their parents; to force a gene in them would be another operator.
    """
    mutated = generator.random(parents.shape) < probability
    steps = generator.normal(0.0, sigma, parents.shape)
    return np.clip(parents + mutated * steps, -1.0, 1.0).astype(np.float32)


def select_uniform(elites: ArchiveElites, n: int, generator: np.random.Generator) -> Picks:
    """ME_rand: uniform over the occupied cells, without replacement where there are n of them."""
    return generator.choice(len(elites), n, replace=len(elites) < n)


def select_successes(elites: ArchiveElites, n: int, generator: np.random.Generator) -> Picks:
    """ME_scs by its original definition: all successful elites, the rest drawn at random.

    n or more successes: n of them without replacement. Fewer: each once, then other elites without
    replacement; with fewer than n elites in all, each once, then any with replacement.

    The released code differs: below n successful cells it draws from the whole archive without regard to
    success, so that selection has no pressure while successes are few.
    """
    successes, others = np.flatnonzero(elites.successful), np.flatnonzero(~elites.successful)
    if len(successes) >= n:
        return generator.choice(successes, n, replace=False)
    if len(elites) >= n:
        rest = generator.choice(others, n - len(successes), replace=False)
        return np.concatenate([successes, rest])
    repeats = generator.choice(len(elites), n - len(elites), replace=True)
    return np.concatenate([successes, others, repeats])
