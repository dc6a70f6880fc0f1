"""The overlap filter: hands that are surely inside the object, found without the simulator.

Points of the open hand are looked up in voxels that are wholly inside the object. A point of both bodies is
an overlap whatever else there is, so that no pose is rejected that the simulator lets pass. Few points are
looked up for all poses, more of them for those that are left.
"""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.scene import SceneGripper
from qdgrasp_worker.grasp import Grasps
from qdgrasp_worker.skin import Skin
from qdgrasp_worker.solid import Solid
from qdgrasp_worker.voxels import Singles

STAGES = (slice(0, 64), slice(64, 256), slice(256, 1024))
AT_ONCE = 1 << 15
"""Points that are looked up at once: they fit in the cache."""


class OverlapFilter:
    """What tells overlapping poses of a scene.

    Parameters
    ----------
    follows_free_joints
        Whether the hand is tested with its free joints where the grasp has them, or open.
    """

    def __init__(self, gripper: SceneGripper, solid: Solid, *, follows_free_joints: bool) -> None:
        self._skin = Skin(gripper)
        self._inside = solid.inside
        self._follows = follows_free_joints and bool(gripper.free_joints)
        self._opened = np.array([[joint.opened for joint in gripper.joints]], dtype=np.float32)

    def __call__(self, grasps: Grasps, places: NDArray[np.intp]) -> NDArray[np.intp]:
        """Those of `places` in a batch of grasps at which the hand surely overlaps, ascending."""
        rejected = []
        for stage in STAGES:
            hit = self._hits(grasps, places, stage)
            rejected.append(places[hit])
            places = places[~hit]
        return np.sort(np.concatenate(rejected))

    def _hits(self, grasps: Grasps, places: NDArray[np.intp], stage: slice) -> NDArray[np.bool_]:
        """Which poses have one of the points of a stage inside the object: (p,)."""
        step = max(1, AT_ONCE // (stage.stop - stage.start))
        starts = range(0, len(places), step)
        parts = [self._look(grasps, places[i : i + step], stage) for i in starts]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=bool)

    def _look(self, grasps: Grasps, places: NDArray[np.intp], stage: slice) -> NDArray[np.bool_]:
        postures = grasps.joints[places] if self._follows else self._opened
        points = self._skin.points(postures, stage)
        x, y, z = placed(points, matrices(grasps.quaternions[places]), grasps.positions[places])
        return np.asarray(self._inside.at(x, y, z).any(axis=1))


def matrices(quaternions: NDArray[np.float32]) -> Singles:
    """The rotation matrices (n, 3, 3) of unit quaternions (n, 4)."""
    x, y, z, w = quaternions.astype(np.float64).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows, dtype=np.float32), -1, 0)


def placed(points: Singles, rotations: Singles, positions: Singles) -> tuple[Singles, Singles, Singles]:
    """x, y and z (n, p) of points (n or 1, p, 3), turned by (n, 3, 3) and moved by (n, 3).

    In products and sums of single numbers, whose bits do not depend on how many poses there are.
    """
    x, y, z = (points[:, :, axis] for axis in range(3))
    rows = [
        rotations[:, i, 0, None] * x + rotations[:, i, 1, None] * y + rotations[:, i, 2, None] * z
        for i in range(3)
    ]
    return rows[0] + positions[:, 0, None], rows[1] + positions[:, 1, None], rows[2] + positions[:, 2, None]
