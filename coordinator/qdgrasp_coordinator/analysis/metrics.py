"""Metrics: what a run's successes are worth, beside their coverage of a reference set.

Counted are nominal rows; randomised trials of a genome are left out.
"""

import math
from collections.abc import Iterable, Iterator

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_coordinator.cells import cells, keys
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows

BINS = 18
"""Bins of the nu histogram from 0 to pi: 10 degrees each."""
NEAR = math.pi / 4
"""The approach prior's nu_a (Huber et al. 2024, section III-A) [rad]."""


class Lean(Struct, frozen=True, kw_only=True):
    """How successes lean from the surface normal: their nu (Huber et al. 2024, eq. 1)."""

    bins: tuple[int, ...]
    """Successes in each of 18 equal bins from 0 to pi; the last one includes pi."""
    below_quarter_pi: float | None
    """The share of successes with nu below pi / 4, 0 to 1; None without a success that has a nu."""

    @property
    def words(self) -> str:
        """The share for a person."""
        return "none" if self.below_quarter_pi is None else f"{self.below_quarter_pi:.1%} below pi/4"


class Metrics:
    """Sums over the successes of a journal, in any order."""

    successes: int = 0

    def __init__(self) -> None:
        self._fitness = 0.0
        self._best: dict[int, float] = {}  # by cell
        self._bins = np.zeros(BINS, dtype=np.int64)
        self._near = 0

    def count(self, rows: Rows) -> None:
        """Count the next rows."""
        found = rows[(rows["trial"] == 0) & (rows["outcome"] >= Outcome.DROPPED)]
        self.successes += len(found)
        self._fitness += float(found["fitness"].sum(dtype=np.float64))
        if len(found):
            self._count_cells(found)
            self._count_nu(found["nu"][found["surface_point"].any(axis=1)])

    def counting(self, blocks: Iterable[Rows]) -> Iterator[Rows]:
        """The same blocks, each counted as it passes."""
        for block in blocks:
            self.count(block)
            yield block

    @property
    def qd_score(self) -> float:
        """QD score: over all cells with a success, the sum of the best fitness found in each."""
        return math.fsum(self._best.values())

    @property
    def mean_fitness(self) -> float | None:
        """Mean fitness of all successes; None without one."""
        return self._fitness / self.successes if self.successes else None

    @property
    def nu(self) -> Lean:
        """How the successes that aim at a surface point lean."""
        aimed = int(self._bins.sum())
        return Lean(bins=tuple(self._bins.tolist()), below_quarter_pi=self._near / aimed if aimed else None)

    def _count_cells(self, found: Rows) -> None:
        reached = keys(cells(found["descriptor"][:, :3]))
        for cell, fitness in zip(reached.tolist(), found["fitness"].tolist(), strict=True):
            self._best[cell] = max(fitness, self._best.get(cell, 0.0))

    def _count_nu(self, nu: NDArray[np.float32]) -> None:
        angles = np.clip(nu.astype(np.float64), 0.0, math.pi)  # pi in float32 is more than pi
        self._bins += np.histogram(angles, bins=BINS, range=(0.0, math.pi))[0]
        self._near += int(np.count_nonzero(angles < NEAR))
