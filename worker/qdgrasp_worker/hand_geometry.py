"""Geometry of the hand: frames and convex parts of its links, and the mounts of its fingers.

Fingers are mounted on links that stand still while they close: the root, and the links of free joints.
All of it is the hand's alone: scenes with the same hand share it, and what is measured of its closing.
"""

import hashlib
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Self

import msgspec
import numpy as np

from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.grippers.collision_shapes import is_all_convex, link_convex_parts
from qdgrasp_assets.grippers.urdf import Urdf, UrdfJoint, parse_robot
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_worker.filters.voxels import Hull, convex_hulls

Closing = Callable[[Sequence[float], int], list[list[float]]]
"""Courses of a closing hand's joints, by its initial posture and its synergy."""


HANDS_KEPT = 8  # Hands whose geometry a process keeps, the last ones used


@dataclass(frozen=True)
class SharedHand:
    """A hand that equals those of other scenes with the same content: a key of what it does."""

    digest: bytes
    gripper: SceneGripper = field(compare=False, repr=False)

    @classmethod
    def of(cls, gripper: SceneGripper) -> Self:
        """The key of a scene's hand."""
        content = msgspec.msgpack.encode(gripper, order="deterministic")
        return cls(hashlib.sha256(content).digest(), gripper)

    @property
    def kinematics(self) -> "HandKinematics":
        """Its kinematics, one object for all scenes."""
        return _kinematics(self)

    def postures(self, course: bytes) -> Floats:
        """The postures (n, j) [rad or m] that a course is, whose bytes can be a part of a key."""
        return np.frombuffer(course).reshape(-1, len(self.gripper.joints))


@lru_cache(HANDS_KEPT)
def _kinematics(hand: SharedHand) -> "HandKinematics":
    return HandKinematics(hand.gripper)


class HandKinematics:
    """The links of a scene's hand from its root link outward, without the carrier."""

    def __init__(self, gripper: SceneGripper) -> None:
        robot = parse_robot(Path(), ET.fromstring(gripper.urdf))  # noqa: S314  # the scene's own
        self.robot = robot.subtree(gripper.base_link)
        """The hand, without meshes and without the carrier."""
        self._joints = [joint.name for joint in gripper.joints]
        parts = list(link_convex_parts(self.robot, gripper.meshes))
        self.hulls: dict[str, list[Hull]] = {
            link: convex_hulls(part.corners for part in parts if part.link == link)
            for link in self.robot.links
        }
        """The convex parts of each link, link frame."""
        self.is_understood = is_all_convex(robot, gripper.meshes) and (
            sum(map(len, self.hulls.values())) == len(list(link_convex_parts(robot, gripper.meshes)))
        )
        """True if these are all collision shapes: all are convex, none flat, none the carrier's."""

    def frames(self, postures: Floats) -> dict[str, Floats]:
        """The frame (n, 4, 4) of each link in the hand's, joints at `postures` (n, j) [rad or m]."""
        frames = self.robot.forward(dict(zip(self._joints, postures.T, strict=True)))
        shape = (len(postures), 4, 4)
        return {link: np.broadcast_to(frame, shape) for link, frame in frames.items()}

    def box(self, links: Iterable[str], frames: dict[str, Floats]) -> tuple[Floats, Floats]:
        """The corners (3,) of the box around `links` in all of the `frames` [m]."""
        corners = [
            np.einsum("nij,kj->nki", frames[link][:, :3, :3], hull.triangles.reshape(-1, 3))
            + frames[link][:, None, :3, 3]
            for link in links
            for hull in self.hulls[link]
        ]
        points = np.concatenate([each.reshape(-1, 3) for each in [*corners, np.zeros((1, 3))]])
        return points.min(axis=0), points.max(axis=0)


def free_posture(gripper: SceneGripper, share: float) -> list[float]:
    """The open posture with the free joints at this share of their ranges, all at once."""
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
    """The mount before it."""
    frame: Floats
    """(4, 4): of the joint, in that one's."""
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
    """Pairs of links between which there is no joint that moves, or one."""
    heads = {robot.root: robot.root}  # of each link the first one that is fixed to it
    carriers = {robot.root: robot.root}  # of each of these the one that carries it
    for joint in robot.joints_beyond(robot.root):
        heads[joint.child] = joint.child if joint.moves else heads[joint.parent]
        carriers.setdefault(heads[joint.child], heads[joint.parent])
    return {
        (one, other)
        for one, head in heads.items()
        for other, with_head in heads.items()
        if one < other and (head == with_head or carriers[head] == with_head or carriers[with_head] == head)
    }
