"""The outcome archive of the authors' released code, and how many elites of it a run would have left.

That code measures coverage on one elite per cell of its own archive. Positions count once per elite and not
once per rounded position, and the archive's box is displaced, so that its figure is neither the coverage of
the paper's text nor bounded by 1. It is computed here only to compare with figures made by that code.

What is the same: the cube's side and place, the bins, their flattened key that lets positions outside the
cube fall into foreign cells, the order of insertion and its rule (a failure never displaces a success, a
success displaces another only with a greater fitness), rounding and look-up. What is not: that code measures
after whole generations, positions are float32 here, and the successes come from this package's simulation.
Which failures stand in its archive is drawn at random and has no influence on the successes in it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.scene import Scene
from qdgrasp_assets.surface import BULLET_MARGIN

BIN = 0.01
"""The bins are this wide or a little wider [m]."""
HAND_EXTENT = {"panda_2f": 0.2084, "robotiq_2f": 0.1681, "bh280": 0.3393, "allegro": 0.2498, "shadow": 0.5415}
"""The largest extent of each reference hand's bounding box, which that code adds to the object's [m]."""
SAME_HAND = {"panda": "panda_2f", "barrett": "bh280"}
"""Models of our own, by the reference hand that they stand for."""


@dataclass(frozen=True)
class ReleasedArchive:
    """The cube of the released code's archive, in the frame of the positions."""

    low: NDArray[np.float64]
    """(3,) [m]: the corner with the smallest coordinates."""
    side: float
    """Length of its edges [m]."""

    @property
    def bins(self) -> int:
        """How many bins each axis has."""
        return int(self.side / BIN)

    def keys(self, positions: NDArray[np.floating]) -> NDArray[np.int64]:
        """The flattened bin of each position (n, 3) [m]; (n,), not clipped below, as released."""
        place = np.floor((positions.astype(np.float64) - self.low) / (self.side / self.bins)).astype(np.int64)
        place = np.where(place > self.bins, self.bins - 1, place)
        keys: NDArray[np.int64] = place @ np.array([1, self.bins, self.bins**2])
        return keys

    def elites(self, positions: NDArray[np.floating], fitness: NDArray[np.number]) -> NDArray[np.intp]:
        """Which successes hold a cell in the end: in each the first of those with the greatest fitness.

        Parameters
        ----------
        positions
            (n, 3) [m], CoM frame, in journal order.
        fitness
            (n,), theirs.

        Returns
        -------
        (m,) places in `positions`.
        """
        keys = self.keys(positions)
        order = np.lexsort((np.arange(len(keys)), -fitness.astype(np.float64), keys))
        _, first = np.unique(keys[order], return_index=True)
        return order[first]


def released_archive(scene: Scene) -> ReleasedArchive | None:
    """The archive that the released code would use for a scene; None for a hand that it does not have.

    The cube stands around the object's bounding box as it was while the mesh frame lay at the origin. The
    object is moved to its centre of mass afterwards, the cube is not.
    """
    extent = HAND_EXTENT.get(reference_hand(scene.gripper.name))
    if extent is None:
        return None
    hulls = _hull_vertices(scene.object.collision) + np.array(scene.object.com_in_mesh)
    low, high = hulls.min(axis=0) - BULLET_MARGIN, hulls.max(axis=0) + BULLET_MARGIN
    side = extent + float((high - low).max())
    return ReleasedArchive((low + high) / 2 - side / 2, side)


def reference_hand(gripper: str) -> str:
    """The reference hand that a gripper is or stands for; its own name where it is none of them."""
    hand = gripper.removeprefix("ref_")
    return SAME_HAND.get(hand, hand)


def _hull_vertices(obj: bytes) -> NDArray[np.float64]:
    lines = (line.split() for line in obj.splitlines() if line.startswith(b"v "))
    return np.array([[float(number) for number in line[1:4]] for line in lines])
