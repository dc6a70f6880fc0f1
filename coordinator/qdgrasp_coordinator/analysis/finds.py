"""Finds: the nominal successes of a run, and after how many evaluations each was found.

Where every genome counts, the place of a success says that.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.analysis.growth import first_times
from qdgrasp_coordinator.analysis.reference import ReferenceSet
from qdgrasp_coordinator.analysis.released import ReleasedArchive
from qdgrasp_coordinator.analysis.steps import Steps, steps
from qdgrasp_coordinator.counts.cells import cells, keys
from qdgrasp_coordinator.counts.tally import counted, successes, successful
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import Overlaps

ROUNDING = 1e-6
"""Taken from every nu [rad]: where a prior ends at pi / 4, float32 goes beyond."""


@dataclass(frozen=True)
class Finds:
    """The nominal successes of a run in journal order."""

    rows: Rows
    """(n,)."""
    evaluations: NDArray[np.int64]
    """(n,): counted evaluations so far, itself included."""

    @classmethod
    def among(cls, rows: Rows, overlaps: Overlaps, before: int = 0) -> Self:
        """Those among rows in journal order, before which their run counted so many evaluations."""
        evaluations = before + np.cumsum(counted(rows, overlaps))
        success = successful(rows)
        return cls(rows[success], evaluations[success])

    @classmethod
    def placed(cls, rows: Rows, population: int) -> Self:
        """Those among kept rows, where every genome counts and there are so many in a generation."""
        found = successes(rows)
        generation, index = (found[name].astype(np.int64) for name in ("generation", "index"))
        return cls(found, generation * population + index + 1)

    @property
    def nu(self) -> NDArray[np.float64]:
        """(m,) [rad], 0 to pi: of those that aim at a surface point."""
        aimed = self.rows["nu"][self.rows["surface_point"].any(axis=1)].astype(np.float64)
        return np.clip(aimed - ROUNDING, 0.0, math.pi)

    def cells(self, fitness: int = 0) -> Steps:
        """Distinct 1 cm cells with a success of at least this fitness."""
        chosen = self.rows["fitness"] >= fitness
        descriptors = self.rows["descriptor"][chosen][:, :3]
        return steps(self.evaluations[chosen], first_times(keys(cells(descriptors))))

    def found(self, reference: ReferenceSet, fitness: int = 0) -> Steps:
        """Distinct entries of a set that were found with at least this fitness."""
        chosen = self.rows["fitness"] >= fitness
        reached = keys(cells(self.rows["base_to_object"][chosen][:, :3]))
        new = first_times(reached) & np.isin(reached, keys(reference.cells))
        return steps(self.evaluations[chosen], new)

    def published(self, reference: ReferenceSet, archive: ReleasedArchive) -> Steps:
        """Elites of the released code's archive that are in a set: each counts, and may be displaced."""
        positions = self.rows["base_to_object"][:, :3]
        shared = np.isin(keys(cells(positions)), keys(reference.cells))
        gains = _gains(archive.keys(positions), self.rows["fitness"], shared.astype(np.int64))
        return steps(self.evaluations, gains)


def joined(found: Iterable[Finds], none: Rows) -> Finds:
    """The finds of several blocks in one."""
    parts = [Finds(none, np.zeros(0, np.int64)), *found]
    return Finds(
        np.concatenate([part.rows for part in parts]), np.concatenate([part.evaluations for part in parts])
    )


def _gains(
    cell: NDArray[np.int64], fitness: NDArray[np.number], worth: NDArray[np.int64]
) -> NDArray[np.int64]:
    """What each comer (n,) adds to the worth of all elites: its own, less that of the elite it displaces."""
    order = np.argsort(cell, kind="stable")
    place = np.unique(cell[order], return_inverse=True)[1]
    above = np.float64(1.0 + np.max(fitness, initial=0))
    best = np.maximum.accumulate(place * above + fitness[order])  # within a cell: earlier cells are smaller
    elite = order[np.diff(best, prepend=-1.0) > 0]
    before = np.append(0, worth[elite][:-1])
    foreign = np.append(True, cell[elite][1:] != cell[elite][:-1])[: len(elite)]
    gains = np.zeros(len(cell), dtype=np.int64)
    gains[elite] = worth[elite] - np.where(foreign, 0, before[: len(elite)])
    return gains
