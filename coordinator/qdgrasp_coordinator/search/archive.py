"""The optimisation archive: one elite per 1 cm cell of hand positions.

Its cells are those of `cells`, aligned with S_G: edges at k + 0.5 cm in the object's CoM frame. Not repeated
here are differences of the paper's released code: a cube displaced by the object's inertial offset with bins
of 1.00-1.02 cm, positions outside it aliased into other cells, and a failure that replaces a failure with
probability 0.5. Here positions outside the box are left out, and ties keep the elder.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_coordinator.metrics.arrays import take_rows
from qdgrasp_coordinator.metrics.cells import PER_METRE, cells
from qdgrasp_protocol.rows import Genomes, Outcome, Rows

if TYPE_CHECKING:
    from ribs.archives import GridArchive

FAILED = -1.0  # Objective of a valid pose that is no success: below any success's, which is its fitness

PositionBox: TypeAlias = tuple[ArrayLike, ArrayLike]
"""Low and high corner (3,) [m], CoM frame: `genes.archive_box`."""


@dataclass(frozen=True)
class ArchiveElites:
    """Contents of an archive, in the order of its cells."""

    places: NDArray[np.int64]
    """(n,): the numbers of their cells, sorted."""
    successful: NDArray[np.bool_]
    """(n,): True for successes."""

    def __len__(self) -> int:
        return len(self.places)


class EliteArchive:
    """The best genome found in each cell of a box of positions, enlarged to whole cells."""

    def __init__(self, genes: int, box: PositionBox) -> None:
        self._low, self._high = cells(np.stack([np.asarray(corner) for corner in box]))
        self._dims = tuple(self._high - self._low + 1)
        self._objectives = np.full(np.prod(self._dims), -np.inf, np.float32)  # of every cell of the box
        self._genomes = np.zeros((len(self._objectives), genes), np.float32)
        self._places = np.zeros(0, np.int64)  # of the occupied cells, sorted

    def __len__(self) -> int:
        return len(self._places)

    @property
    def elites(self) -> ArchiveElites:
        """All elites, by the number of their cells: the same archive gives the same order."""
        return ArchiveElites(self._places, self._objectives[self._places] > FAILED)

    def genomes(self, places: NDArray[np.int64]) -> Genomes:
        """Return the genomes (n, d) of the elites in the cells of these numbers (n,), all occupied."""
        return self._genomes[places]

    def insert(self, rows: Rows) -> None:
        """Offer rows, elder ones first; overlaps, dead ends and errors are ignored."""
        valid = take_rows(rows, rows["outcome"] >= Outcome.MISSED)
        where = cells(valid["descriptor"][:, :3])
        inside = ((where >= self._low) & (where <= self._high)).all(axis=1)
        offered = take_rows(valid, inside)
        places = np.ravel_multi_index(tuple((where[inside] - self._low).T), self._dims)
        objectives = np.where(offered["outcome"] >= Outcome.DROPPED, offered["fitness"], np.float32(FAILED))
        order = np.lexsort((-objectives, places))  # by cell, then the best, then the eldest
        best = order[np.unique(places[order], return_index=True)[1]]
        better = best[objectives[best] > self._objectives[places[best]]]
        self._objectives[places[better]] = objectives[better]
        self._genomes[places[better]] = offered["genome"][better]
        self._places = np.union1d(self._places, places[better])


def ribs_archive(box: PositionBox, rows: Rows, objectives: NDArray[np.float64]) -> "GridArchive":
    """Return successes (n,) in a pyribs archive of the cells of a box, the best of each cell.

    Solutions are genomes, measures hand positions [m], CoM frame; bins are the 1 cm cells. Successes outside
    the box are left out: pyribs would clip them into border cells.
    """
    from ribs.archives import GridArchive  # takes 1-2 s

    low, high = cells(np.stack([np.asarray(corner) for corner in box]))
    # pyribs cuts a range into equal bins: from half a cell below the first middle to half above the last.
    ranges = list(zip((low - 0.5) / PER_METRE, (high + 0.5) / PER_METRE, strict=True))
    archive = GridArchive(solution_dim=rows["genome"].shape[1], dims=high - low + 1, ranges=ranges)
    where = cells(rows["descriptor"][:, :3])
    inside = ((where >= low) & (where <= high)).all(axis=1)
    if inside.any():
        archive.add(rows["genome"][inside], objectives[inside], where[inside] / PER_METRE)
    return archive
