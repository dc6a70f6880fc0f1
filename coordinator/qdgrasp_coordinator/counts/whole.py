"""Whole rows: moved as bytes, in a tenth of the time that numpy takes to move them field by field."""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qdgrasp_protocol.rows import Rows


def whole(rows: Rows) -> NDArray[np.void]:
    """The same rows, of any number of axes, as items without fields."""
    return rows.view(_bytes(rows.dtype.itemsize))


def taken(rows: Rows, places: Any) -> Rows:
    """A copy of the rows at some places: whatever an array is indexed by."""
    chosen: Rows = whole(rows)[places].copy().view(rows.dtype)
    return chosen


def joined(parts: Sequence[Rows]) -> Rows:
    """Rows one behind the other, of one part at least; a single part is given back as it is."""
    if len(parts) == 1:
        return parts[0]
    return np.concatenate([whole(part) for part in parts]).view(parts[0].dtype)


@cache
def _bytes(n: int) -> "np.dtype[np.void]":
    return np.dtype((np.void, n))
