"""The swath: what the closing fingers of a hand pass through, and which way.

It is a measure for ranking poses, and decides nothing else. An object of which much is in the swath is likely
to be touched; where all of it is passed through in one direction, it is likely to be pushed away.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.objects.solids import geodesic
from qdgrasp_assets.rotation import Floats, dot
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_worker.convex import Hull, hulls
from qdgrasp_worker.grasp import Grasps
from qdgrasp_worker.overlap import matrices, placed
from qdgrasp_worker.skeleton import Skeleton
from qdgrasp_worker.voxels import Singles, Voxels

PITCH = 3e-3
"""The side of a voxel [m]."""
EVERY = 5
"""Steps of the closing hand between two looks where its fingers are."""
PLACES = 5
"""At how many places of each free joint a swath is measured; the nearest one stands for a posture."""
AT_ONCE = 64
"""Poses that are looked up at once: their points fit in the cache."""
STILL = 1e-5
"""What a finger moves at least from one look to the next to have a direction [m]."""
UNIT = 1 << 12
"""The length of a direction: in whole numbers, whose sums do not depend on their order."""
Closing = Callable[[Sequence[float], int], list[list[float]]]
"""The courses of a closing hand's joints, by its initial posture and its synergy."""


@dataclass(frozen=True)
class Swath:
    """One way of closing, hand frame."""

    voxels: Voxels
    """The level says which finger comes there first, and when: the greater, the earlier; 0: none does."""
    ways: NDArray[np.int32]
    """(levels, 3): in which direction across the approach axis it comes, see `directions`."""

    def shares(self, x: Singles, y: Singles, z: Singles) -> NDArray[np.float32]:
        """How much of points (n, p) [m] is in it, and is so from opposite sides: (n, 2); `Swaths.shares`."""
        levels = self.voxels.at(x, y, z)
        within = np.count_nonzero(levels, axis=1)
        push = self.ways[levels].sum(axis=1, dtype=np.int64).astype(np.float64)
        opposed = np.maximum(within - np.sqrt(dot(push, push)) / UNIT, 0.0)
        shares: NDArray[np.float64] = np.stack([within, opposed], axis=1) / levels.shape[1]
        return shares.astype(np.float32)


class Swaths:
    """The swaths of a scene's hand, each measured when it is first asked for."""

    def __init__(self, gripper: SceneGripper, closing: Closing) -> None:
        self._skeleton = Skeleton(gripper)
        self._fingers = gripper.finger_links
        self._plain = {link: plain(self._skeleton.hulls[link]) for link in self._fingers}
        self._closing = closing
        self._approach = np.array(gripper.approach_axis)
        self._opened = [joint.opened for joint in gripper.joints]
        names = [joint.name for joint in gripper.joints]
        self._free = [names.index(joint.name) for joint in gripper.free_joints]
        self._low = np.array([joint.low for joint in gripper.free_joints])
        self._high = np.array([joint.high for joint in gripper.free_joints])
        self._found: dict[tuple[int, ...], Swath] = {}

    def shares(self, points: Singles, grasps: Grasps, places: NDArray[np.intp]) -> NDArray[np.float32]:
        """How much of an object's points (p, 3), CoM frame, is in the swath, and is so from opposite sides.

        (places, 2), between 0 and 1; the second is the first, less the length of the mean of the directions
        in which the fingers come to the points.
        """
        shares = np.zeros((len(places), 2), dtype=np.float32)
        keys, which = np.unique(self._keys(grasps, places), axis=0, return_inverse=True)
        for i, key in enumerate(keys.tolist()):
            swath = self._swath(tuple(key))
            (mine,) = np.nonzero(which.reshape(-1) == i)
            for start in range(0, len(mine), AT_ONCE):
                some = mine[start : start + AT_ONCE]
                shares[some] = swath.shares(*seen(points, grasps, places[some]))
        return shares

    def _keys(self, grasps: Grasps, places: NDArray[np.intp]) -> NDArray[np.int64]:
        """What names the swath of each grasp: its synergy, and the place of each of its free joints."""
        free = grasps.joints[places][:, self._free].astype(np.float64)
        portions = (free - self._low) / np.where(self._high == self._low, 1.0, self._high - self._low)
        stops = np.rint(np.clip(portions, 0.0, 1.0) * (PLACES - 1)).astype(np.int64)
        return np.column_stack([grasps.synergies[places], stops])

    def _swath(self, key: tuple[int, ...]) -> Swath:
        if key not in self._found:
            self._found[key] = self._measure(key[0], np.array(key[1:]))
        return self._found[key]

    def _measure(self, synergy: int, stops: NDArray[np.int64]) -> Swath:
        """Close the hand on nothing and mark the way of its fingers."""
        posture = np.array(self._opened)
        posture[self._free] = self._low + stops / (PLACES - 1) * (self._high - self._low)
        frames = self._skeleton.frames(np.array(self._closing(posture.tolist(), synergy))[::EVERY])
        voxels = Voxels(*self._skeleton.box(self._fingers, frames), PITCH, np.uint16)
        parts = [(frames[link], hull) for link in self._fingers for hull in self._plain[link]]
        looks = len(next(iter(frames.values())))
        ways = np.zeros((1 + looks * len(parts), 3), dtype=np.int32)
        for i, (course, hull) in enumerate(parts):
            levels = 1 + i + len(parts) * np.arange(looks)[::-1]
            ways[levels] = directions(course, hull, self._approach)
            for frame, level in zip(course, levels.tolist(), strict=True):
                voxels.mark(hull.moved(frame), level)
        return Swath(voxels, ways)


def directions(course: Floats, hull: Hull, axis: Floats) -> NDArray[np.int32]:
    """In which directions across `axis` (3,) a hull is carried through frames (n, 4, 4): (n, 3).

    Their length is `UNIT`, or less where it goes along the axis: what is drawn that way, the palm stops.
    """
    centre = hull.triangles.reshape(-1, 3).mean(axis=0)
    moves = np.gradient(course[:, :3, :3] @ centre + course[:, :3, 3], axis=0)
    lengths = np.sqrt(dot(moves, moves))[:, None]
    ways = np.where(lengths > STILL, moves / np.maximum(lengths, STILL), 0.0)
    return np.rint(UNIT * (ways - dot(ways, axis)[:, None] * axis)).astype(np.int32)


def plain(parts: Sequence[Hull]) -> list[Hull]:
    """Hulls of the points that `parts` reach farthest with in 92 directions."""
    directions = geodesic(1.0, 3).vertices
    corners = [hull.triangles.reshape(-1, 3) for hull in parts]
    return hulls(points[np.unique((points @ directions.T).argmax(axis=0))] for points in corners)


def seen(points: Singles, grasps: Grasps, places: NDArray[np.intp]) -> tuple[Singles, Singles, Singles]:
    """x, y and z (n, p) of points (p, 3), CoM frame, in the frames of the hands at `places` (n,)."""
    rotations = np.moveaxis(matrices(grasps.quaternions[places]), 1, 2)
    return placed(points[None], rotations, -turned(rotations, grasps.positions[places]))


def turned(rotations: Singles, vectors: Singles) -> Singles:
    """The vectors (n, 3) turned by rotations (n, 3, 3), bits independent of n."""
    x, y, z = (rotations[:, :, axis] * vectors[:, axis, None] for axis in range(3))
    total: Singles = x + y + z
    return total
