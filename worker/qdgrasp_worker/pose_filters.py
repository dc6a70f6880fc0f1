"""Filters: which poses of a batch geometry refuses before any of them is simulated.

Overlap: points on and in the collision shapes of the open hand, the first of them wide apart, are looked up
in voxels that are wholly inside the object. A point of both bodies proves an overlap, so that no pose is
rejected that the simulator accepts. Few points are looked up for all poses, more for the remaining ones.

Table: it is a plane. A hand stays above it if the lowest corner of its open fingers and palm does, at its
pose and where its approach begins.

Neighbours: the same points are looked up in voxels around them, at places along the approach. So a hand is
refused that comes nearer than `CLEARANCE`, within the size of a voxel.
"""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import parse_parts
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.geometry.voxels import (
    MOST_SOLID_VOXELS,
    SOLID_PITCH,
    VoxelGrid,
    box_around,
    convex_hulls,
    solid_voxels,
)
from qdgrasp_assets.grippers.reachability import HandApproach
from qdgrasp_assets.scene import Scene, SceneGripper
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.contact_margin import slim_scene
from qdgrasp_worker.decoder import DecodedGrasps

CLEARANCE = 3e-3  # Distance that the open hand keeps from neighbours [m]


class ObjectSolid:
    """The convex parts of a scene's object, CoM frame, and those of its neighbours if asked for."""

    def __init__(self, scene: Scene, *, with_neighbours: bool = False) -> None:
        files = (scene.object.collision, scene.neighbours)[: 1 + with_neighbours]
        parts = [part.vertices for file in files for part in parse_parts(file.decode())]
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
        return places[self._hand.meets(self._inside, (positions, quaternions, postures))]


class ApproachFilter:
    """Finds poses to which the hand cannot come, for the table or a neighbour.

    It comes below the table in each of a scene's resting poses, or near a neighbour.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def __call__(self, grasps: DecodedGrasps, places: NDArray[np.intp]) -> NDArray[np.intp]:
        """Those of `places` in a batch of grasps that are refused."""
        hands, refused = grasps.hands(places), np.zeros(len(places), dtype=bool)
        if poses := self._scene.resting_poses:
            refused |= ~self._approach.clear_of(poses, hands).any(axis=1)
        if self._scene.neighbours:
            refused |= self._approach.meets(self._near, hands)
        return places[refused]

    @cached_property
    def _approach(self) -> HandApproach:
        return HandApproach(self._scene.gripper, self._scene.approach_distance)

    @cached_property
    def _near(self) -> VoxelGrid:
        """Level 1: near a neighbour, in the box that a hand at the object may be in."""
        scene, gripper = self._scene, self._scene.gripper
        parts = parse_parts(scene.neighbours.decode())
        hulls = [hull.grown(CLEARANCE) for hull in convex_hulls(part.vertices for part in parts)]
        reach = gripper.reach + gripper.extent + scene.approach_distance
        low = np.maximum(box_around(hulls)[0], np.array(scene.object_low) - reach)
        high = np.minimum(box_around(hulls)[1], np.array(scene.object_high) + reach)
        near = VoxelGrid(
            low, high, max(SOLID_PITCH, float(np.prod(high - low) / MOST_SOLID_VOXELS) ** (1 / 3))
        )
        for hull in hulls:
            near.mark(hull, 1)
        return near


class PoseFilters:
    """Says which poses of a scene need no simulation, and their outcomes.

    In the test for overlap the free joints are as in the grasp (`follows_free_joints`), or open. `shortcuts`
    says whether poses that surely overlap are refused here, or by the simulator, with the same results. Hands
    that cannot come to their poses are refused in any case.
    """

    def __init__(
        self, scene: Scene, solid: ObjectSolid, *, follows_free_joints: bool, shortcuts: bool = True
    ) -> None:
        self._scene, self._solid = scene, solid
        self._follows, self._shortcuts = follows_free_joints, shortcuts
        self._unreachable = ApproachFilter(scene)

    def __call__(
        self, grasps: DecodedGrasps, trials: NDArray[np.uint16], wanted: NDArray[np.bool_]
    ) -> dict[int, Outcome]:
        """The outcomes of refused grasps, by their places, among those that are `wanted` (n,).

        Beyond trial 0 the pose is disturbed, so that only dead ends are refused.
        """
        (dead_ends,) = np.nonzero(wanted & grasps.dead_ends)
        (nominal,) = np.nonzero(wanted & ~grasps.dead_ends & (trials == 0))
        overlaps = self._overlap(grasps, nominal) if self._shortcuts else nominal[:0]
        refused = self._unreachable(grasps, np.setdiff1d(nominal, overlaps))
        return dict.fromkeys(dead_ends.tolist(), Outcome.DEAD_END) | dict.fromkeys(
            [*overlaps.tolist(), *refused.tolist()], Outcome.OVERLAP
        )

    @cached_property
    def _overlap(self) -> OverlapFilter:
        return OverlapFilter(slim_scene(self._scene).gripper, self._solid, follows_free_joints=self._follows)
