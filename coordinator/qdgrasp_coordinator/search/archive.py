"""The optimisation archive: one elite per 1 cm cell of hand positions, on a pyribs grid.

Its cells are those of `cells`, aligned with S_G: edges at k + 0.5 cm in the object's CoM frame. What the
released code of the paper does otherwise, and what is not repeated here: a cube displaced by the object's
inertial offset with bins of 1.00-1.02 cm, positions outside it aliased into other cells, and a failure that
replaces a failure with probability 0.5. Here positions outside the box are counted and left out, and ties
keep the elder.
"""

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_coordinator.metrics.arrays import take_rows
from qdgrasp_coordinator.metrics.cells import cells
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
    """(n,): which of them are successes."""

    def __len__(self) -> int:
        return len(self.places)


class EliteArchive:
    """The best genome found in each cell of a box of positions, enlarged to whole cells."""

    outside: int = 0
    """Valid positions that lay outside the box, so far."""

    def __init__(self, genes: int, box: PositionBox) -> None:
        _compile_insertion()
        self._low, self._high = cells(np.stack([np.asarray(corner) for corner in box]))
        self._grid = _elite_grid(genes, self._low, self._high)
        self._places = np.zeros(0, dtype=np.int64)
        self._successful = np.zeros(0, dtype=bool)

    def __len__(self) -> int:
        return len(self._grid)

    @property
    def elites(self) -> ArchiveElites:
        """All elites, by the number of their cells: the same archive gives the same order."""
        return ArchiveElites(self._places, self._successful.copy())

    def genomes(self, places: NDArray[np.int64]) -> Genomes:
        """Return the genomes (n, d) of the elites in the cells of these numbers (n,), all occupied."""
        _, data = self._grid.retrieve(self._low + np.stack(np.unravel_index(places, self._grid.dims), axis=1))
        return data["solution"]

    def insert(self, rows: Rows) -> None:
        """Offer rows, elder ones first; overlaps, dead ends and errors are passed over."""
        valid = take_rows(rows, rows["outcome"] >= Outcome.MISSED)
        where = cells(valid["descriptor"][:, :3])
        inside = ((where >= self._low) & (where <= self._high)).all(axis=1)
        self.outside += int(np.count_nonzero(~inside))
        if inside.any():
            kept = take_rows(valid, inside)
            is_success = kept["outcome"] >= Outcome.DROPPED
            self._grid.add(
                kept["genome"],
                np.where(is_success, kept["fitness"], np.float32(FAILED)),
                where[inside],
            )
            places = np.ravel_multi_index(tuple((where[inside] - self._low).T), tuple(self._grid.dims))
            self._mark(places, is_success)

    def _mark(self, places: NDArray[np.int64], successful: NDArray[np.bool_]) -> None:
        """Add newly occupied cells to the list, and mark cells that were offered a success."""
        offered = np.unique(places)
        at = np.searchsorted(self._places, offered)
        new = np.append(self._places, -1)[at] != offered
        self._places = np.insert(self._places, at[new], offered[new])
        self._successful = np.insert(self._successful, at[new], False)
        self._successful[np.searchsorted(self._places, places[successful])] = True


def cell_grid(genes: int, low: NDArray[np.int64], high: NDArray[np.int64], **options: Any) -> "GridArchive":
    """Make a pyribs archive whose measures are cells, so that its bins are those of `cells`."""
    from ribs.archives import GridArchive  # takes 1-2 s, which only a process that searches should pay

    ranges = list(zip(low - 0.5, high + 0.5, strict=True))
    return GridArchive(solution_dim=genes, dims=high - low + 1, ranges=ranges, **options)


def _elite_grid(genes: int, low: NDArray[np.int64], high: NDArray[np.int64]) -> "GridArchive":
    dtypes = {"solution_dtype": np.float32, "objective_dtype": np.float32, "measures_dtype": np.float64}
    return cell_grid(genes, low, high, **dtypes)


@cache
def _compile_insertion() -> None:
    """Have pyribs compile its batch insertion (1-2 s, once a process) before anything waits."""
    _elite_grid(1, np.zeros(3, np.int64), np.ones(3, np.int64)).add(
        np.zeros((1, 1)), np.zeros(1), np.zeros((1, 3))
    )
