"""Reachability: the way of the open hand to its pose, clear of object and table.

The hand comes in a straight line along its approach axis, open, its free joints in place. Two
questions are answered:

- Does it touch the object on its way? Points on and in its convex parts are looked up, at steps along the
  way, in voxels that are wholly inside the object. A point of both bodies proves a contact; a hand that only
  grazes the object, by less than the points and voxels are apart, is not found.
- Does it stay above the table? The lowest corner of its convex parts is nowhere lower than at the two ends of
  the way, so that this answer is exact.
"""

from collections.abc import Sequence
from math import ceil
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import parse_parts
from qdgrasp_assets.geometry.resting_poses import chosen_resting_poses
from qdgrasp_assets.geometry.rotation import Floats, conjugate, dot, rotate, unit
from qdgrasp_assets.geometry.voxels import (
    Singles,
    VoxelGrid,
    box_around,
    convex_hulls,
    rotation_matrices,
    solid_voxels,
    transform_points,
)
from qdgrasp_assets.grippers.hand_geometry import POINTS_AT_ONCE, STAGES, hand_geometry
from qdgrasp_assets.scene import RestingPose, Scene, SceneGripper
from qdgrasp_protocol.spec import APPROACH_DISTANCE, RunSpec

APPROACH_STEP = 2e-3  # Distance between two looks at a hand on its way [m]
HEIGHT_DECIMALS = 9  # Decimals of heights [m] when they are compared


Hands = tuple[Singles, Singles, Singles]
"""Positions (n, 3) [m] and unit quaternions (n, 4) of root links, CoM frame, and joints (n, j) [rad or m]."""


class HandApproach:
    """The ways of a scene's open hand to its poses, from `distance` [m] before them.

    Results of a pose do not depend on the others.
    """

    def __init__(self, gripper: SceneGripper, distance: float) -> None:
        self._surface = hand_geometry(gripper).samples
        self._axis = np.array(gripper.approach_axis)
        self._distance = distance
        steps = ceil(distance / APPROACH_STEP)
        self._ways = np.minimum(APPROACH_STEP * np.arange(steps + 1), distance).astype(np.float32)

    def meets(self, inside: VoxelGrid, hands: Hands) -> NDArray[np.bool_]:
        """Return which hands (n,) surely touch the object on their way, or at its end.

        `inside` has level 1 where a voxel is wholly inside the object (`voxels.solid_voxels`).
        """
        positions, quaternions, postures = hands
        found = np.zeros(len(positions), dtype=bool)
        for stage in STAGES:
            step = max(1, POINTS_AT_ONCE // (stage.stop - stage.start))
            left = np.flatnonzero(~found)
            for first in range(0, len(left), step):
                some = left[first : first + step]
                points = self._surface.points(postures[some], stage)
                found[some] = self._hit(inside, points, positions[some], quaternions[some])
        return found

    def _hit(
        self, inside: VoxelGrid, points: Singles, positions: Singles, quaternions: NDArray[np.float32]
    ) -> NDArray[np.bool_]:
        rotations = rotation_matrices(quaternions)
        x, y, z = transform_points(points, rotations, positions)
        ahead = self._axis.astype(np.float32)[None, None]
        dx, dy, dz = transform_points(ahead, rotations, np.zeros_like(positions))
        hit = np.zeros(len(positions), dtype=bool)
        for way in self._ways:
            hit |= inside.at(x - way * dx, y - way * dy, z - way * dz).any(axis=1)
        return hit

    def clear_of(self, poses: Sequence[RestingPose], hands: Hands) -> NDArray[np.bool_]:
        """Return which hands (n, r) stay above the table in each of the object's resting poses."""
        positions, quaternions, postures = hands
        turns, is_above = unit(quaternions.astype(np.float64)), np.zeros((len(positions), len(poses)), bool)
        for number, pose in enumerate(poses):
            up = np.array(pose.up)
            above = rotate(conjugate(turns), np.broadcast_to(up, (len(turns), 3)))
            ends = self._surface.lowest(above, postures) + dot(positions.astype(np.float64), up)
            heights = ends - self._distance * np.maximum(dot(above, self._axis), 0.0) - pose.height
            is_above[:, number] = heights.round(HEIGHT_DECIMALS) >= 0.0
        return is_above


class Reach(NamedTuple):
    """Answers whether n hands come to their poses."""

    is_clear: NDArray[np.bool_]
    """(n,): True where the hand touches nothing on its way, as far as its points tell."""
    is_above: NDArray[np.bool_]
    """(n, r): True where it stays above the table in each resting pose that was asked for."""
    probability: Floats
    """(n,): probability of the resting poses in which it comes to its pose; 0 where it touches the object."""

    @property
    def is_reachable(self) -> NDArray[np.bool_]:
        """(n,): True where it comes clear of the object, and of the table if there is one."""
        return np.asarray(self.is_clear & (self.is_above.any(axis=1) | (not self.is_above.shape[1])))


class ReachabilityCheck:
    """Checks whether hands come to the grasps of a scene.

    `resting_pose` is the number of a resting pose, or "any"; None: there is no table. Raises ImpossibleValue
    for one that the object does not have.
    """

    def __init__(self, scene: Scene, distance: float, resting_pose: int | str | None) -> None:
        self.distance = distance
        """Distance along its approach axis from which the hand comes [m]."""
        self.poses = chosen_resting_poses(scene.object.collision, resting_pose, scene.object.name)
        """The object's resting poses that are checked, by number."""
        self._approach = HandApproach(scene.gripper, distance)
        hulls = convex_hulls(part.vertices for part in parse_parts(scene.object.collision.decode()))
        self._inside = solid_voxels(hulls, *box_around(hulls))

    @classmethod
    def asked(
        cls, scene: Scene, spec: RunSpec, distance: float | None = None, resting_pose: int | str | None = None
    ) -> Self | None:
        """Make the check that is asked for of a run's grasps, else that of its spec; None: neither."""
        pose = spec.table_pose if resting_pose is None else resting_pose
        way = distance if distance is not None else spec.approach
        if distance is None and not spec.approach and pose is not None:
            way = APPROACH_DISTANCE
        return cls(scene, way, pose) if way or pose is not None else None

    def __call__(self, hands: Hands) -> Reach:
        """Return which hands reach their poses."""
        poses = list(self.poses.values())
        is_clear = ~self._approach.meets(self._inside, hands)
        is_above = self._approach.clear_of(poses, hands)
        shares = np.array([pose.probability for pose in poses])
        return Reach(is_clear, is_above, (is_clear[:, None] & is_above).astype(np.float64) @ shares)
