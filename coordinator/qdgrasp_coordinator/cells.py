"""Cells: the 1 cm voxels that hand positions are told apart by."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def cells(positions: ArrayLike) -> NDArray[np.int64]:
    """Round positions (n, 3) [m] to whole centimetres (n, 3), half to even as S_G was rounded.

    A cell's edges are at k + 0.5 cm; float32 positions are widened first, so that every reader of a
    journal finds the same cell.
    """
    return np.rint(np.asarray(positions, dtype=np.float64) * 100.0).astype(np.int64)
