"""Voxels: the best finds of each 1 cm cell, and pages of them for the browser.

Of each cell there is one for every outcome and synergy that succeeded in it: so whoever leaves out some of
these, or what has too low an eta, sees exactly the cells in which something else was found, and the best of
that.

A page is little-endian: the header `HEADER`, then of `n` voxels the journal numbers (uint32), etas (float32,
-1 where there is none), cells (3 x int16), synergies (int16, -1 for none) and outcomes (uint8).
"""

import struct

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.counts.cells import cells
from qdgrasp_coordinator.counts.finds import Found
from qdgrasp_protocol.genome import NO_SYNERGY

HEADER = struct.Struct("<4s5I")
"""The mark, n, the serial to ask from next, whether there is more at once, all voxels so far, the origin."""
MARK = b"QDG2"
COLUMNS = ("number", "eta", "cell", "synergy", "outcome")
"""In the order of a page."""
MOST = 1 << 16
"""The most voxels on a page: about 1 MiB."""
LARGEST = 1 << 18
"""The most voxels that are kept: 7 MiB. Finds in still more cells are left out."""
FARTHEST = np.iinfo(np.int16).max
"""Cells: what lies farther out than 300 m is no find."""
VOXEL = np.dtype(
    [
        ("key", "<i8"),
        ("serial", "<u4"),
        ("number", "<u4"),
        ("eta", "<f4"),
        ("cell", "<i2", 3),
        ("synergy", "<i2"),
        ("outcome", "u1"),
    ]
)


class Voxels:
    """The best find of each cell, outcome and synergy: of the greatest eta, and of equals the earliest.

    Parameters
    ----------
    origin
        A number that tells these finds from those of another run or journal, uint32.
    """

    def __init__(self, origin: int = 0) -> None:
        self.origin = origin
        self.next = 0
        """The journal number up to which finds were inserted."""
        self.is_whole = True
        """Whether these were all that there were."""
        self._kept = np.zeros(0, VOXEL)  # by serial
        self._serial = 0

    def __len__(self) -> int:
        """How many there are."""
        return len(self._kept)

    def insert(self, found: Found, upto: int, *, is_whole: bool = True) -> None:
        """Add finds (n,), which are all up to journal number `upto`; they may be told again."""
        self.next, self.is_whole = upto, is_whole
        if len(found):
            voxels = _voxels(found)
            voxels["serial"] = self._serial + np.arange(len(voxels))
            self._kept = _best(np.concatenate([self._kept, voxels]))[:LARGEST]
            self._serial = int(self._kept["serial"][-1]) + 1 if len(self._kept) else 0

    def page(self, first: int) -> bytes:
        """The voxels that came with the serial `first` or a later one, as many as a page holds.

        Whoever asks on from the serial in the header, and lets what comes replace what has its cell, outcome
        and synergy, has them all.
        """
        start = int(np.searchsorted(self._kept["serial"], first))
        shown = self._kept[start : start + MOST]
        upto = int(shown["serial"][-1]) + 1 if len(shown) else self._serial
        more = start + MOST < len(self._kept) or not self.is_whole
        header = HEADER.pack(MARK, len(shown), upto, more, len(self._kept), self.origin)
        return header + b"".join(shown[name].tobytes() for name in COLUMNS)


def _voxels(found: Found) -> NDArray[np.void]:
    places = cells(found["descriptor"])
    near = (np.abs(places) <= FARTHEST).all(axis=1)
    voxels = np.zeros(int(near.sum()), VOXEL)
    voxels["cell"] = places[near]
    for name in ("number", "eta", "synergy", "outcome"):
        voxels[name] = found[name][near]
    voxels["key"] = _keys(voxels)
    return voxels


def _keys(voxels: NDArray[np.void]) -> NDArray[np.int64]:
    """One number for each cell, outcome and synergy: (n,)."""
    cell = voxels["cell"].astype(np.int64) + FARTHEST
    synergy = voxels["synergy"].astype(np.int64) - NO_SYNERGY
    place = (cell[:, 0] << 32) | (cell[:, 1] << 16) | cell[:, 2]
    keys: NDArray[np.int64] = (((place << 3) | voxels["outcome"]) << 12) | synergy
    return keys


def _best(voxels: NDArray[np.void]) -> NDArray[np.void]:
    """The best one of each key, by serial; what is told again, and no better, is not new."""
    ordered = voxels[np.lexsort((voxels["serial"], voxels["number"], -voxels["eta"]))]
    _, first = np.unique(ordered["key"], return_index=True)
    kept: NDArray[np.void] = ordered[first]
    return kept[np.argsort(kept["serial"])]
