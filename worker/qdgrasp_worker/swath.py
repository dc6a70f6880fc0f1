"""The swath: what the closing fingers of a hand pass through, and how much of an object is in it.

It is a measure for ranking poses, and decides nothing else: an object of which much is between the closing
fingers is likely to be touched.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.objects.solids import geodesic
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_worker.convex import Hull, hulls
from qdgrasp_worker.grasp import Grasps
from qdgrasp_worker.overlap import matrices, placed
from qdgrasp_worker.skeleton import Skeleton
from qdgrasp_worker.voxels import Singles, Voxels

PITCH = 3e-3
"""The side of a voxel [m]."""
BESIDE = 4e-3
"""How far from the fingers' way points are counted as near it [m]."""
NEAR, IN = 1, 2
"""Levels of the voxels."""
EVERY = 5
"""Steps of the closing hand between two looks where its fingers are."""
PLACES = 5
"""At how many places of each free joint a swath is measured; the nearest one stands for a posture."""
AT_ONCE = 64
"""Poses that are looked up at once: their points fit in the cache."""
Closing = Callable[[Sequence[float], int], list[list[float]]]
"""The courses of a closing hand's joints, by its initial posture and its synergy."""


class Swaths:
    """The swaths of a scene's hand, each measured when it is first asked for."""

    def __init__(self, gripper: SceneGripper, closing: Closing) -> None:
        self._skeleton = Skeleton(gripper)
        self._fingers = gripper.finger_links
        self._plain = {link: plain(self._skeleton.hulls[link]) for link in self._fingers}
        self._closing = closing
        self._opened = [joint.opened for joint in gripper.joints]
        names = [joint.name for joint in gripper.joints]
        self._free = [names.index(joint.name) for joint in gripper.free_joints]
        self._low = np.array([joint.low for joint in gripper.free_joints])
        self._high = np.array([joint.high for joint in gripper.free_joints])
        self._found: dict[tuple[int, ...], Voxels] = {}

    def shares(self, points: Singles, grasps: Grasps, places: NDArray[np.intp]) -> NDArray[np.float32]:
        """How much of an object's `points` (p, 3) is in the swath, and in it or near it: (places, 2)."""
        shares = np.zeros((len(places), 2), dtype=np.float32)
        keys, which = np.unique(self._keys(grasps, places), axis=0, return_inverse=True)
        for i, key in enumerate(keys.tolist()):
            voxels = self._swath(tuple(key))
            (mine,) = np.nonzero(which.reshape(-1) == i)
            for start in range(0, len(mine), AT_ONCE):
                some = mine[start : start + AT_ONCE]
                shares[some] = share(voxels, points, grasps, places[some])
        return shares

    def _keys(self, grasps: Grasps, places: NDArray[np.intp]) -> NDArray[np.int64]:
        """What names the swath of each grasp: its synergy, and the place of each of its free joints."""
        free = grasps.joints[places][:, self._free].astype(np.float64)
        portions = (free - self._low) / np.where(self._high == self._low, 1.0, self._high - self._low)
        stops = np.rint(np.clip(portions, 0.0, 1.0) * (PLACES - 1)).astype(np.int64)
        return np.column_stack([grasps.synergies[places], stops])

    def _swath(self, key: tuple[int, ...]) -> Voxels:
        if key not in self._found:
            self._found[key] = self._measure(key[0], np.array(key[1:]))
        return self._found[key]

    def _measure(self, synergy: int, stops: NDArray[np.int64]) -> Voxels:
        """Close the hand on nothing and mark the way of its fingers."""
        posture = np.array(self._opened)
        posture[self._free] = self._low + stops / (PLACES - 1) * (self._high - self._low)
        course = np.array(self._closing(posture.tolist(), synergy))[::EVERY]
        frames = self._skeleton.frames(course)
        low, high = self._skeleton.box(self._fingers, frames)
        voxels = Voxels(low - BESIDE, high + BESIDE, PITCH)
        for link in self._fingers:
            for hull in self._plain[link]:
                for frame in np.unique(frames[link], axis=0):
                    there = hull.moved(frame)
                    voxels.mark(there.grown(BESIDE), NEAR)
                    voxels.mark(there, IN)
        return voxels


def plain(parts: Sequence[Hull]) -> list[Hull]:
    """Hulls of the points that `parts` reach farthest with in 92 directions."""
    directions = geodesic(1.0, 3).vertices
    corners = [hull.triangles.reshape(-1, 3) for hull in parts]
    return hulls(points[np.unique((points @ directions.T).argmax(axis=0))] for points in corners)


def share(voxels: Voxels, points: Singles, grasps: Grasps, places: NDArray[np.intp]) -> NDArray[np.float32]:
    """How much of `points` (p, 3), CoM frame, is at each level for the hands at `places`: (places, 2)."""
    rotations = np.moveaxis(matrices(grasps.quaternions[places]), 1, 2)
    back = -turned(rotations, grasps.positions[places])
    levels = voxels.at(*placed(points[None], rotations, back))
    within, near = (levels >= IN).sum(axis=1), (levels >= NEAR).sum(axis=1)
    return (np.stack([within, near], axis=1) / len(points)).astype(np.float32)


def turned(rotations: Singles, vectors: Singles) -> Singles:
    """The vectors (n, 3) turned by rotations (n, 3, 3), bits independent of n."""
    x, y, z = (rotations[:, :, axis] * vectors[:, axis, None] for axis in range(3))
    total: Singles = x + y + z
    return total
