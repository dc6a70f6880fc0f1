"""The optimisation archive: one elite per 1 cm cell of hand positions, on a pyribs grid.

Its cells are those of `cells`, aligned with S_G: edges at k + 0.5 cm in the object's CoM frame. What the
released code of the paper does otherwise, and what is not repeated here: a cube displaced by the object's
inertial offset with bins of 1.00-1.02 cm, positions outside it aliased into other cells, and a failure that
replaces a failure with probability 0.5. Here positions outside the box are counted and left out, and ties
keep the elder.
"""

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_coordinator.cells import cells
from qdgrasp_coordinator.whole import taken
from qdgrasp_protocol.genome import Genomes
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows

if TYPE_CHECKING:
    from ribs.archives import GridArchive

FAILED = -1.0
"""The objective of a valid pose that is no success: below every success, whose objective is its fitness."""

Box: TypeAlias = tuple[ArrayLike, ArrayLike]
"""Low and high corner (3,) [m], CoM frame: `genes.archive_box`."""


@dataclass(frozen=True)
class Elites:
    """What an archive holds, in the order of its cells."""

    cells: NDArray[np.int64]
    """(n, 3): where they are."""
    successful: NDArray[np.bool_]
    """(n,): which of them are successes."""

    def __len__(self) -> int:
        return len(self.cells)


class Archive:
    """The best genome found in each cell.

    Parameters
    ----------
    genes
        How many genes a genome has.
    box
        The box of positions that are kept, enlarged to whole cells.
    """

    outside: int = 0
    """Valid positions that lay outside the box, so far."""

    def __init__(self, genes: int, box: Box) -> None:
        _compile_insertion()
        self._low, self._high = cells(np.stack([np.asarray(corner) for corner in box]))
        self._grid = _grid(genes, self._low, self._high)
        self._order = np.zeros(0, dtype=np.intp)  # of what the grid holds, by the index of its cells
        self._indices = np.zeros(0, dtype=np.int64)  # of these cells, sorted
        self._cells = np.zeros((0, 3), dtype=np.int64)  # and where they are

    def __len__(self) -> int:
        return len(self._grid)

    @property
    def success_cells(self) -> int:
        """How many cells hold a success."""
        return int(np.count_nonzero(self._grid.data("objective") > FAILED))

    @property
    def elites(self) -> Elites:
        """All elites, by the index of their cells: the same archive gives the same order."""
        self._sort()
        return Elites(self._cells, self._grid.data("objective")[self._order] > FAILED)

    def genomes(self, cells: NDArray[np.int64]) -> Genomes:
        """The genomes of the elites in some cells (n, 3), each of which holds one: (n, d)."""
        _, data = self._grid.retrieve(cells)
        found: Genomes = data["solution"]
        return found

    def _sort(self) -> None:
        """Sort cells in that hold their first elite; the grid has them behind those before."""
        known = len(self._order)
        if len(self._grid) > known:
            indices = self._grid.data("index")[known:]
            new = np.argsort(indices)
            places = np.searchsorted(self._indices, indices[new])
            where = np.stack(np.unravel_index(indices[new], self._grid.dims), axis=1) + self._low
            self._order = np.insert(self._order, places, known + new)
            self._indices = np.insert(self._indices, places, indices[new])
            self._cells = np.insert(self._cells, places, where, axis=0)

    def insert(self, rows: Rows) -> None:
        """Offer rows, elder ones first; overlaps, dead ends and errors are passed over."""
        valid = taken(rows, rows["outcome"] >= Outcome.MISSED)
        places = cells(valid["descriptor"][:, :3])
        inside = ((places >= self._low) & (places <= self._high)).all(axis=1)
        self.outside += int(np.count_nonzero(~inside))
        if inside.any():
            kept = taken(valid, inside)
            self._grid.add(kept["genome"], _objectives(kept), places[inside])


def _objectives(valid: Rows) -> NDArray[np.float32]:
    success = valid["outcome"] >= Outcome.DROPPED
    return np.where(success, valid["fitness"], np.float32(FAILED))


def _grid(genes: int, low: NDArray[np.int64], high: NDArray[np.int64]) -> "GridArchive":
    """A pyribs archive whose measures are cells, so that its bins are exactly ours."""
    from ribs.archives import GridArchive  # takes 1-2 s, which only a process that searches should pay

    return GridArchive(
        solution_dim=genes,
        dims=high - low + 1,
        ranges=list(zip(low - 0.5, high + 0.5, strict=True)),
        solution_dtype=np.float32,
        objective_dtype=np.float32,
        measures_dtype=np.float64,
    )


@cache
def _compile_insertion() -> None:
    """Have pyribs compile its insertion of batches (1-2 s, once a process) before anything waits for it."""
    _grid(1, np.zeros(3, np.int64), np.ones(3, np.int64)).add(np.zeros((1, 1)), np.zeros(1), np.zeros((1, 3)))
