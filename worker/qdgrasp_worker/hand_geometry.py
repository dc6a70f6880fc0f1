"""Geometry of a hand: postures of its free joints, and the mounts of its fingers.

Fingers are mounted on links that stand still while they close: the root, and the links of free joints.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.grippers.hand_surface import HandKinematics
from qdgrasp_assets.grippers.urdf import Urdf, UrdfJoint
from qdgrasp_assets.scene import SceneGripper

Closing = Callable[[Sequence[float], int], list[list[float]]]
"""Courses of a closing hand's joints, by its initial posture and its synergy."""


def free_posture(gripper: SceneGripper, share: float) -> list[float]:
    """The open posture with all free joints at this share of their ranges."""
    free = {joint.name: joint for joint in gripper.free_joints}
    return [
        free[joint.name].low + share * (free[joint.name].high - free[joint.name].low)
        if joint.name in free
        else joint.opened
        for joint in gripper.joints
    ]


@dataclass(frozen=True)
class FreeJointLink:
    """A link that a free joint carries."""

    link: str
    on: str
    """The mount that it is mounted on."""
    frame: Floats
    """(4, 4): frame of the joint in that mount's."""
    joint: UrdfJoint
    place: int
    """The joint's place in a posture."""


class FreeJointLinks:
    """The links of a scene's hand that its other links are mounted on."""

    def __init__(self, gripper: SceneGripper, kinematics: HandKinematics) -> None:
        self._root = gripper.base_link
        free = {joint.name for joint in gripper.free_joints}
        names = [joint.name for joint in gripper.joints]
        driven = {joint.name for joint in gripper.joints if joint.driven}
        frames = kinematics.frames(np.zeros((1, len(names))))
        self._mounts: list[FreeJointLink] = []
        self.mount_of = {self._root: self._root}
        """The mount under each link."""
        still = {self._root}
        self.all_still = not free & driven
        """True if all of them stand still: no free joint or joint below one is driven."""
        for joint in kinematics.robot.joints_beyond(self._root):
            below, is_free = self.mount_of[joint.parent], joint.name in free
            self.mount_of[joint.child] = joint.child if is_free else below
            if joint.parent in still and (is_free or joint.name not in names):
                still.add(joint.child)
            if is_free:
                self.all_still = self.all_still and joint.parent in still
                frame = np.linalg.inv(frames[below][0]) @ frames[joint.parent][0] @ joint.origin
                self._mounts.append(FreeJointLink(joint.child, below, frame, joint, names.index(joint.name)))

    def frames(self, posture: Sequence[float]) -> dict[str, Floats]:
        """Each mount's frame (4, 4) in the hand's, with the free joints as in `posture` [rad or m]."""
        frames = {self._root: np.eye(4)}
        for mount in self._mounts:
            frames[mount.link] = frames[mount.on] @ mount.frame @ mount.joint.motion(posture[mount.place])
        return frames


def neighbours(robot: Urdf) -> set[tuple[str, str]]:
    """Pairs of links with at most one moving joint between them."""
    heads = {robot.root: robot.root}  # the first link of each link's rigid piece
    carriers = {robot.root: robot.root}  # the first link of the piece that carries each
    for joint in robot.joints_beyond(robot.root):
        heads[joint.child] = joint.child if joint.moves else heads[joint.parent]
        carriers.setdefault(heads[joint.child], heads[joint.parent])
    return {
        (one, other)
        for one, head in heads.items()
        for other, with_head in heads.items()
        if one < other and (head == with_head or carriers[head] == with_head or carriers[with_head] == head)
    }
