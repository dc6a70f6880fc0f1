"""Metrics: what a run's successes are worth, beside their coverage of a reference set.

Counted are nominal rows. The fitness of a success is what its search hears: the shakes it survived or, under
a protocol with trials, those it survived in all of them; such a success counts once its trials are recorded.
"""

import math
from collections.abc import Iterable, Iterator

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_coordinator.counts.cells import cells, keys
from qdgrasp_coordinator.counts.scores import SHAKES, Scores, eta
from qdgrasp_coordinator.counts.tally import successes
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


class Eta(Struct, frozen=True, kw_only=True):
    """How likely successes are to transfer: their eta (Huber et al. 2024, section IV), 0 to 1 each."""

    successes: int
    """Those whose trials are all recorded; the other figures are of these, and None without one."""
    mean: float | None
    best: float | None
    at_least_half: float | None
    """The share of them with an eta of at least 0.5, 0 to 1."""

    @property
    def words(self) -> str:
        """The figures for a person."""
        if self.mean is None or self.best is None or self.at_least_half is None:
            return "none"
        return f"mean {self.mean:.3f}, best {self.best:.3f}, {self.at_least_half:.1%} at least 0.5"


class Metrics:
    """Sums over the successes of a journal, in any order; with trials in the journal's.

    Parameters
    ----------
    trials
        How many trials a success has.
    """

    successes: int = 0

    def __init__(self, trials: int = 0) -> None:
        self._trials = trials
        self._scores = Scores(trials)
        self._scored = np.zeros(1 + SHAKES * max(1, trials), dtype=np.int64)  # successes by fitness
        self._best: dict[int, float] = {}  # by cell
        self._bins = np.zeros(BINS, dtype=np.int64)
        self._near = 0

    def count(self, rows: Rows) -> None:
        """Count the next rows."""
        found = successes(rows)
        self.successes += len(found)
        self._count_nu(found["nu"][found["surface_point"].any(axis=1)])
        scored = self._scores.take(rows)
        self._scored += np.bincount(scored["fitness"].astype(np.int64), minlength=len(self._scored))
        self._count_cells(scored)

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
        """Mean fitness of all successes that count; None without one."""
        return self._mean(np.arange(len(self._scored), dtype=np.float64))

    @property
    def eta(self) -> Eta | None:
        """How likely the successes are to transfer; None where the protocol has no trials."""
        if not self._trials:
            return None
        etas = eta(np.arange(len(self._scored)), self._trials)
        return Eta(
            successes=int(self._scored.sum()),
            mean=self._mean(etas),
            best=float(etas[self._scored > 0].max()) if self._scored.any() else None,
            at_least_half=self._mean((etas >= 0.5).astype(np.float64)),
        )

    @property
    def nu(self) -> Lean:
        """How the successes that aim at a surface point lean."""
        aimed = int(self._bins.sum())
        return Lean(bins=tuple(self._bins.tolist()), below_quarter_pi=self._near / aimed if aimed else None)

    def _mean(self, values: NDArray[np.float64]) -> float | None:
        """The mean over all scored successes of a value that depends on their fitness."""
        total = int(self._scored.sum())
        return float(self._scored @ values) / total if total else None

    def _count_cells(self, found: Rows) -> None:
        reached = keys(cells(found["descriptor"][:, :3]))
        for cell, fitness in zip(reached.tolist(), found["fitness"].tolist(), strict=True):
            self._best[cell] = max(fitness, self._best.get(cell, 0.0))

    def _count_nu(self, nu: NDArray[np.float32]) -> None:
        angles = np.clip(nu.astype(np.float64), 0.0, math.pi)  # pi in float32 is more than pi
        self._bins += np.histogram(angles, bins=BINS, range=(0.0, math.pi))[0]
        self._near += int(np.count_nonzero(angles < NEAR))
