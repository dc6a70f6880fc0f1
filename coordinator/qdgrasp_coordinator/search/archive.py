"""The optimisation archive: pyribs' grid, with one elite per 1 cm cell of positions.

Its cells are those of `cells`, aligned with S_G: edges at k + 0.5 cm in the object's CoM frame. Not repeated
here are differences of the paper's released code: a cube displaced by the object's inertial offset with bins
of 1.00-1.02 cm, positions outside it aliased into other cells, and a failure that replaces a failure with
probability 0.5. Here positions outside the box are left out, and ties keep the elder.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

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


class CellBox:
    """The cells of a box of positions, enlarged to whole ones."""

    def __init__(self, box: PositionBox) -> None:
        self.low, self.high = cells(np.stack([np.asarray(corner) for corner in box]))

    def contains(self, places: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Flag the cells (n, 3) that are in the box: (n,)."""
        inside: NDArray[np.bool_] = ((places >= self.low) & (places <= self.high)).all(axis=1)
        return inside

    def archive(self, genes: int, unit: float = 1.0, **options: Any) -> "GridArchive":
        """Make a pyribs archive with a bin for each cell; measures are cells times `unit`."""
        from ribs.archives import GridArchive  # takes 1-2 s

        # pyribs cuts a range into equal bins: from half a cell below the first middle to half above the last.
        ranges = list(zip((self.low - 0.5) * unit, (self.high + 0.5) * unit, strict=True))
        return GridArchive(solution_dim=genes, dims=self.high - self.low + 1, ranges=ranges, **options)


@dataclass(frozen=True)
class ArchiveElites:
    """Contents of an archive, in the order of its cells: the same archive gives the same order."""

    genomes: Genomes
    """(n, d)."""
    successful: NDArray[np.bool_]
    """(n,): True for successes."""

    def __len__(self) -> int:
        return len(self.genomes)


class EliteArchive:
    """The best genome found in each cell of a box of positions."""

    def __init__(self, genes: int, box: PositionBox) -> None:
        self._box = CellBox(box)
        self._grid = self._box.archive(genes, dtype=np.float32)

    def __len__(self) -> int:
        return len(self._grid)

    @property
    def elites(self) -> ArchiveElites:
        """All elites; pyribs holds them in the order in which their cells were reached first."""
        held = self._grid.data(["index", "solution", "objective"])
        order = np.argsort(held["index"])
        return ArchiveElites(held["solution"][order], held["objective"][order] > FAILED)

    def insert(self, rows: Rows) -> None:
        """Offer rows, elder ones first; overlaps, dead ends and errors are ignored."""
        valid = take_rows(rows, rows["outcome"] >= Outcome.MISSED)
        where = cells(valid["descriptor"][:, :3])
        inside = self._box.contains(where)
        offered = take_rows(valid, inside)
        if len(offered):
            is_success = offered["outcome"] >= Outcome.DROPPED
            objectives = np.where(is_success, offered["fitness"], np.float32(FAILED))
            self._grid.add(offered["genome"], objectives, where[inside])


def ribs_archive(box: PositionBox, rows: Rows, objectives: NDArray[np.float64]) -> "GridArchive":
    """Return successes (n,) in a pyribs archive of the cells of a box, the best of each cell.

    Solutions are genomes, measures hand positions [m], CoM frame; bins are the 1 cm cells. Successes outside
    the box are left out: pyribs would clip them into border cells.
    """
    own = CellBox(box)
    archive = own.archive(rows["genome"].shape[1], 1.0 / PER_METRE)
    where = cells(rows["descriptor"][:, :3])
    inside = own.contains(where)
    if inside.any():
        archive.add(rows["genome"][inside], objectives[inside], where[inside] / PER_METRE)
    return archive
