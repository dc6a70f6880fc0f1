"""Filters: which poses of a batch geometry refuses before any of them is simulated.

Overlap: points on and in the collision shapes of the open hand, the first of them wide apart, are looked up
in voxels that are wholly inside the object. A point of both bodies proves an overlap, so that no pose is
rejected that the simulator accepts. Few points are looked up for all poses, more for the remaining ones.

Table: it is a plane, and no body in the simulator. A hand stays above it if the lowest corner of its open
fingers and palm does, at its pose and where its approach begins.
"""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import parse_parts
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.geometry.voxels import VoxelGrid, box_around, convex_hulls, solid_voxels
from qdgrasp_assets.grippers.reachability import HandApproach
from qdgrasp_assets.scene import Scene, SceneGripper
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.contact_margin import slim_scene
from qdgrasp_worker.decoder import DecodedGrasps


class ObjectSolid:
    """The convex parts of a scene's object, CoM frame."""

    def __init__(self, scene: Scene) -> None:
        parts = [part.vertices for part in parse_parts(scene.object.collision.decode())]
        self.hulls = convex_hulls(parts)
        self.is_whole = 0 < len(self.hulls) == len(parts)
        """True if all of the object is in them; flat parts are left out."""

    @cached_property
    def inside(self) -> VoxelGrid:
        """Level 1: the whole voxel is surely inside one of the parts."""
        return solid_voxels(self.hulls, *self.box)

    @cached_property
    def box(self) -> tuple[Floats, Floats]:
        """The corners (3,) of the box around it and its centre of mass [m]."""
        return box_around(self.hulls)


class OverlapFilter:
    """Finds poses of a scene at which the hand surely overlaps.

    The hand is tested with its free joints where the grasp has them (`follows_free_joints`), or open.
    """

    def __init__(self, gripper: SceneGripper, solid: ObjectSolid, *, follows_free_joints: bool) -> None:
        self._hand = HandApproach(gripper, 0.0)
        self._inside = solid.inside
        self._follows = follows_free_joints and bool(gripper.free_joints)
        self._opened = np.array([joint.opened for joint in gripper.joints], dtype=np.float32)

    def __call__(self, grasps: DecodedGrasps, places: NDArray[np.intp]) -> NDArray[np.intp]:
        """Those of `places` in a batch of grasps at which the hand surely overlaps, ascending."""
        positions, quaternions, joints = grasps.hands(places)
        postures = joints if self._follows else np.broadcast_to(self._opened, joints.shape)
        return places[self._hand.meets(self._inside, positions, quaternions, postures)]


class TableFilter:
    """Finds poses at which the hand comes below the table in each of a scene's resting poses."""

    def __init__(self, scene: Scene) -> None:
        self._poses = scene.resting_poses
        self._approach = HandApproach(scene.gripper, scene.approach_distance) if self._poses else None

    def __call__(self, grasps: DecodedGrasps, places: NDArray[np.intp]) -> NDArray[np.intp]:
        """Those of `places` in a batch of grasps that are refused; none without a table."""
        if self._approach is None:
            return places[:0]
        clear = self._approach.clear_of(self._poses, *grasps.hands(places))
        return places[~clear.any(axis=1)]


class PoseFilters:
    """Says which poses of a scene need no simulation, and their outcomes.

    In the test for overlap the free joints are as in the grasp (`follows_free_joints`), or open. `shortcuts`
    says whether poses that surely overlap are refused here, or by the simulator, with the same results. Hands
    that come below the table are refused in any case.
    """

    def __init__(
        self, scene: Scene, solid: ObjectSolid, *, follows_free_joints: bool, shortcuts: bool = True
    ) -> None:
        self._scene, self._solid = scene, solid
        self._follows, self._shortcuts = follows_free_joints, shortcuts

    def __call__(
        self, grasps: DecodedGrasps, trials: NDArray[np.uint16], wanted: NDArray[np.bool_]
    ) -> dict[int, Outcome]:
        """The outcomes of refused grasps, by their places, among those that are `wanted` (n,).

        Beyond trial 0 the pose is disturbed, so that only dead ends are refused.
        """
        (dead_ends,) = np.nonzero(wanted & grasps.dead_ends)
        (nominal,) = np.nonzero(wanted & ~grasps.dead_ends & (trials == 0))
        overlaps = self._overlap(grasps, nominal) if self._shortcuts else nominal[:0]
        below = self._table(grasps, np.setdiff1d(nominal, overlaps))
        return dict.fromkeys(dead_ends.tolist(), Outcome.DEAD_END) | dict.fromkeys(
            [*overlaps.tolist(), *below.tolist()], Outcome.OVERLAP
        )

    @cached_property
    def _overlap(self) -> OverlapFilter:
        return OverlapFilter(slim_scene(self._scene).gripper, self._solid, follows_free_joints=self._follows)

    @cached_property
    def _table(self) -> TableFilter:
        return TableFilter(self._scene)
