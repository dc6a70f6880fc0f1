"""Cells: the cubes of 1 cm that positions are counted in.

S_G, the paper's reference set, holds positions rounded to 1 cm. Everything that counts or keeps positions
by cell (archive, coverage, progress, `info`) makes its cells here, so that all of them agree.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Number = TypeVar("Number", bound=np.number)
PER_METRE = 100
"""Cells in a metre: an edge is 1 cm, cell k reaches from k - 0.5 to k + 0.5 cm."""
_REACH = 1 << 20
"""`keys` tells cells apart whose components are smaller than this: positions within 10 km."""


def cells(positions: ArrayLike) -> NDArray[np.int64]:
    """The cell of each position.

    Parameters
    ----------
    positions
        (n, 3) [m].

    Returns
    -------
    cells
        (n, 3): `round(100 x)`, halves to even, computed in float64 as S_G was rounded.
    """
    return np.rint(np.asarray(positions, dtype=np.float64) * PER_METRE).astype(np.int64)


def keys(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """One number per cell (n, 3), equal for equal cells only: (n,), for sets and for counting."""
    shifted = cells + _REACH
    packed: NDArray[np.int64] = (shifted[:, 0] << 42) | (shifted[:, 1] << 21) | shifted[:, 2]
    return packed


def best(cells: NDArray[np.int64], values: NDArray[Number]) -> tuple[NDArray[np.int64], NDArray[Number]]:
    """The greatest of `values` (n,) in each distinct one of `cells` (n, 3), cells in lexicographic order."""
    _, first, place = np.unique(keys(cells), return_index=True, return_inverse=True)
    order = np.argsort(values, kind="stable")
    greatest = np.zeros(len(first), dtype=values.dtype)
    greatest[place[order]] = values[order]  # of several, the last stays
    return cells[first], greatest
