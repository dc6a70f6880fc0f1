"""A hand as pictures and tables know it: the links that collide, where its joints put them."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from qdgrasp_assets.scene import SceneGripper
from qdgrasp_assets.shapes import Shape, shapes
from qdgrasp_assets.urdf import Urdf, tree

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Hand:
    """A gripper's shapes on its joints."""

    gripper: SceneGripper
    robot: Urdf
    shapes: tuple[Shape, ...]

    def is_finger(self, shape: Shape) -> bool:
        """Whether the contact of a shape makes a success."""
        return shape.link in self.gripper.finger_links

    def posed(self, base_to_object: Floats, joints: Floats) -> Iterator[tuple[Shape, Floats]]:
        """Each shape with its vertices (v, 3) [m] in the object's CoM frame.

        Parameters
        ----------
        base_to_object
            (7,): position [m] and quaternion xyzw of the hand's root link.
        joints
            (j,): finger joint positions [rad or m], in the gripper's order.
        """
        frames = self.frames(base_to_object, joints)
        for shape in self.shapes:
            frame = frames[shape.link]
            yield shape, shape.vertices @ frame[:3, :3].T + frame[:3, 3]

    def lowest(self, base_to_object: Floats, joints: Floats, up: Floats) -> Floats:
        """How low hands reach: (n,) [m], the least of their points' components along `up`.

        Parameters
        ----------
        base_to_object
            (n, 7), as in `posed`.
        joints
            (n, j).
        up
            (3,), unit, the object's CoM frame.
        """
        frames = self.frames(base_to_object, joints)
        lowest = np.full(len(base_to_object), np.inf)
        for shape in self.shapes:
            frame = frames[shape.link]
            direction = up @ frame[..., :3, :3]
            height = (direction @ shape.vertices.T).min(axis=-1) + frame[..., :3, 3] @ up
            lowest = np.minimum(lowest, height)
        return lowest

    def frames(self, base_to_object: Floats, joints: Floats) -> dict[str, Floats]:
        """Each link's frame (..., 4, 4) in the object's CoM frame.

        Parameters
        ----------
        base_to_object
            (..., 7), as in `posed`.
        joints
            (..., j).
        """
        names = [joint.name for joint in self.gripper.joints]
        positions = dict(zip(names, np.moveaxis(joints, -1, 0), strict=True))
        return self.robot.forward(positions, _frame(base_to_object))


def hand(gripper: SceneGripper) -> Hand:
    """The hand of a scene, its carrier left out."""
    element = ET.fromstring(gripper.urdf)  # noqa: S314  # a scene that was read and checked
    robot = tree(Path(gripper.name), element).subtree(gripper.base_link)
    return Hand(gripper, robot, tuple(shapes(robot, gripper.meshes)))


def _frame(pose: Floats) -> Floats:
    frame = np.tile(np.eye(4), (*pose.shape[:-1], 1, 1))
    frame[..., :3, :3] = Rotation.from_quat(pose[..., 3:]).as_matrix()
    frame[..., :3, 3] = pose[..., :3]
    return frame
