"""Mounts: links that carry fingers and stand still while these close: the root, and those on free joints."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from qdgrasp_assets.rotation import Floats
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_assets.urdf import UrdfJoint
from qdgrasp_worker.skeleton import Skeleton


@dataclass(frozen=True)
class Mount:
    """A link that a free joint carries."""

    link: str
    on: str
    """The mount before it."""
    frame: Floats
    """(4, 4): of the joint, in that one's."""
    joint: UrdfJoint
    place: int
    """The joint's place in a posture."""


class Mounts:
    """What the links of a scene's hand stand on."""

    def __init__(self, gripper: SceneGripper, skeleton: Skeleton) -> None:
        self._root = gripper.base_link
        free = {joint.name for joint in gripper.free_joints}
        names = [joint.name for joint in gripper.joints]
        driven = {joint.name for joint in gripper.joints if joint.driven}
        frames = skeleton.frames(np.zeros((1, len(names))))
        self._mounts: list[Mount] = []
        self.under = {self._root: self._root}
        """The mount under each link."""
        still = {self._root}
        self.are_still = not free & driven
        """Whether all of them stand still: neither free joints nor joints below them are driven."""
        for joint in skeleton.robot.outward(self._root):
            below, is_free = self.under[joint.parent], joint.name in free
            self.under[joint.child] = joint.child if is_free else below
            if joint.parent in still and (is_free or joint.name not in names):
                still.add(joint.child)
            if is_free:
                self.are_still = self.are_still and joint.parent in still
                frame = np.linalg.inv(frames[below][0]) @ frames[joint.parent][0] @ joint.origin
                self._mounts.append(Mount(joint.child, below, frame, joint, names.index(joint.name)))

    def frames(self, posture: Sequence[float]) -> dict[str, Floats]:
        """Each mount's frame (4, 4) in the hand's, with the free joints as in `posture` [rad or m]."""
        frames = {self._root: np.eye(4)}
        for mount in self._mounts:
            frames[mount.link] = frames[mount.on] @ mount.frame @ mount.joint.motion(posture[mount.place])
        return frames
