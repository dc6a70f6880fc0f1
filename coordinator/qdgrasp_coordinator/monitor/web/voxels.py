"""Voxels: the best find of each 1 cm cell, and pages of them for the browser.

A page is little-endian: the header `HEADER`, then `n` journal numbers (uint32), `n` cells (3 x int16) and
`n` outcomes (uint8).
"""

import struct

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.counts.cells import cells, keys
from qdgrasp_coordinator.counts.finds import Found

HEADER = struct.Struct("<4s5I")
"""The mark, n, the number to ask from next, the journal's rows, all voxels so far, the origin."""
MARK = b"QDG1"
MOST = 1 << 16
"""The most voxels on a page: about 0.7 MiB."""
LARGEST = 1 << 18
"""The most voxels that are kept: 4 MiB. Finds in still more cells are left out."""
FARTHEST = np.iinfo(np.int16).max
"""Cells: what lies farther out than 300 m is no find."""
VOXEL = np.dtype(
    [("key", "<i8"), ("number", "<u4"), ("cell", "<i2", 3), ("fitness", "<f4"), ("outcome", "u1")]
)


class Voxels:
    """The best find of each cell: of the greatest fitness, and of equals the earliest.

    Parameters
    ----------
    origin
        A number that tells these finds from those of another run or journal, uint32.
    """

    def __init__(self, origin: int = 0) -> None:
        self.origin = origin
        self.next = 0
        """The journal number up to which finds were inserted."""
        self.rows = 0
        """The rows of the journal, as was last heard."""
        self._kept = np.zeros(0, VOXEL)  # by number

    def __len__(self) -> int:
        """How many cells there are."""
        return len(self._kept)

    def insert(self, found: Found, upto: int, rows: int) -> None:
        """Add finds (n,), which are all up to journal number `upto` of `rows`."""
        self.next, self.rows = upto, rows
        if len(found):
            self._kept = _best(np.concatenate([self._kept, _voxels(found)]))[:LARGEST]

    def page(self, first: int) -> bytes:
        """The voxels whose find has the journal number `first` or a later one, as many as a page holds.

        Whoever asks on from `next`, and lets what comes replace what was in its cell, has them all.
        """
        start = int(np.searchsorted(self._kept["number"], first))
        shown = self._kept[start : start + MOST]
        more = start + MOST < len(self._kept)
        upto = int(shown["number"][-1]) + 1 if more else max(first, self.next)
        header = HEADER.pack(MARK, len(shown), upto, self.rows, len(self._kept), self.origin)
        return header + b"".join(shown[name].tobytes() for name in ("number", "cell", "outcome"))


def _voxels(found: Found) -> NDArray[np.void]:
    places = cells(found["descriptor"])
    near = (np.abs(places) <= FARTHEST).all(axis=1)
    voxels = np.zeros(int(near.sum()), VOXEL)
    voxels["key"], voxels["cell"] = keys(places[near]), places[near]
    for name in ("number", "fitness", "outcome"):
        voxels[name] = found[name][near]
    return voxels


def _best(voxels: NDArray[np.void]) -> NDArray[np.void]:
    """The best in each cell, by number."""
    ordered = voxels[np.lexsort((voxels["number"], -voxels["fitness"]))]
    _, first = np.unique(ordered["key"], return_index=True)
    kept: NDArray[np.void] = ordered[first]
    return kept[np.argsort(kept["number"])]
