"""Genomes: which genes a prior has, and the intervals that the genes in [-1, 1] stand for.

A genome is a float32 vector. The search sees only numbers in [-1, 1]; decoding maps them linearly to
the intervals (Huber et al. 2024, section III-B, "each component is projected in its own interval").
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Genomes: TypeAlias = NDArray[np.float32]
"""(n, d): n genomes of d genes each, in [-1, 1]."""

GIVEN = "given"
"""The prior of poses that are scored as they are: its genes are the pose itself, not numbers in [-1, 1]."""


NO_SYNERGY = -1
"""The label of a pose without a synergy: all driven fingers close."""


@dataclass(frozen=True)
class Gene:
    """One component of a genome."""

    name: str
    low: float
    """What -1 stands for, in the gene's own unit (m or rad)."""
    high: float
    """What +1 stands for."""


@dataclass(frozen=True)
class Layout:
    """The genes of a genome, in order."""

    prior: str
    genes: tuple[Gene, ...]

    def __len__(self) -> int:
        return len(self.genes)

    @property
    def names(self) -> tuple[str, ...]:
        """The genes' names, in order."""
        return tuple(gene.name for gene in self.genes)

    def values(self, genomes: Genomes) -> NDArray[np.float64]:
        """Map genomes (n, d) in [-1, 1] to their intervals; (n, d) in m and rad, float64."""
        low, high = self.intervals
        values: NDArray[np.float64] = low + (genomes.astype(np.float64) + 1.0) / 2.0 * (high - low)
        return values

    def genomes(self, values: NDArray[np.float64]) -> Genomes:
        """The genomes that stand for values (n, d) in m and rad, the inverse of `values`: (n, d).

        What lies outside its interval is put on the border; the gene of an interval without width is 0.
        """
        low, high = self.intervals
        width = high - low
        shares = np.divide(values - low, width, out=np.full(values.shape, 0.5), where=width > 0)
        genomes: Genomes = np.clip(2.0 * shares - 1.0, -1.0, 1.0).astype(np.float32)
        return genomes

    @property
    def intervals(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """What -1 and +1 stand for, (d,) each."""
        return np.array([gene.low for gene in self.genes]), np.array([gene.high for gene in self.genes])
