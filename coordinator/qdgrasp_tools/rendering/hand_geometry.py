"""Links of a hand placed by its joints, and a table under the object that cuts hands off."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from qdgrasp_assets.geometry.mesh import Mesh, join
from qdgrasp_assets.grippers.collision_shapes import CollisionShape, shapes
from qdgrasp_assets.grippers.urdf import Urdf, parse_robot
from qdgrasp_assets.scene import Scene, SceneGripper
from qdgrasp_coordinator.search.fixed_poses import postures
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.text import parse_numbers

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class HandGeometry:
    """Collision shapes of a gripper on its joints."""

    gripper: SceneGripper
    robot: Urdf
    shapes: tuple[CollisionShape, ...]

    def is_finger(self, shape: CollisionShape) -> bool:
        """Return whether the contact of a shape makes a success."""
        return shape.link in self.gripper.finger_links

    def link_meshes(self) -> dict[str, Mesh]:
        """Return the shapes of each link that has any, joined, in the link's frame [m]."""
        found: dict[str, list[Mesh]] = {}
        for shape in self.shapes:
            found.setdefault(shape.link, []).append(Mesh(shape.vertices, shape.faces))
        return {name: join(parts) for name, parts in found.items()}

    def place_meshes(self, base_to_object: Floats, joints: Floats) -> Iterator[tuple[CollisionShape, Floats]]:
        """Yield each shape with its vertices (v, 3) [m] in the object's CoM frame.

        `base_to_object` (7,) is position [m] and quaternion xyzw of the hand's root link, `joints` (j,) are
        finger joint positions [rad or m] in the gripper's order.
        """
        frames = self.link_frames(base_to_object, joints)
        for shape in self.shapes:
            frame = frames[shape.link]
            yield shape, shape.vertices @ frame[:3, :3].T + frame[:3, 3]

    def lowest_points(self, base_to_object: Floats, joints: Floats, up: Floats) -> Floats:
        """Return the least component of each hand's points along `up`: (n,) [m].

        `base_to_object` (n, 7) and `joints` (n, j) as in `place_meshes`; `up` (3,) is a unit vector, CoM
        frame.
        """
        frames = self.link_frames(base_to_object, joints)
        lowest = np.full(len(base_to_object), np.inf)
        for shape in self.shapes:
            frame = frames[shape.link]
            direction = up @ frame[..., :3, :3]
            height = (direction @ shape.vertices.T).min(axis=-1) + frame[..., :3, 3] @ up
            lowest = np.minimum(lowest, height)
        return lowest

    def link_frames(self, base_to_object: Floats, joints: Floats) -> dict[str, Floats]:
        """Return each link's frame (..., 4, 4) in the object's CoM frame.

        `base_to_object` (..., 7) and `joints` (..., j) as in `place_meshes`.
        """
        names = [joint.name for joint in self.gripper.joints]
        positions = dict(zip(names, np.moveaxis(joints, -1, 0), strict=True))
        base = np.tile(np.eye(4), (*base_to_object.shape[:-1], 1, 1))
        base[..., :3, :3] = Rotation.from_quat(base_to_object[..., 3:]).as_matrix()
        base[..., :3, 3] = base_to_object[..., :3]
        return self.robot.forward(positions, base)


def hand_geometry(gripper: SceneGripper) -> HandGeometry:
    """Return the hand of a scene, its carrier left out."""
    element = ET.fromstring(gripper.urdf)  # noqa: S314  # a scene that was read and checked
    robot = parse_robot(Path(gripper.name), element).subtree(gripper.base_link)
    return HandGeometry(gripper, robot, tuple(shapes(robot, gripper.meshes)))


ROWS_AT_ONCE = 2048  # Hands that are placed at once
AS_MODELLED = Rotation.identity()  # The object stands as its mesh does, z up


@dataclass(frozen=True)
class TablePlane:
    """A plane that an object stands on, in the object's centre-of-mass frame."""

    up: Floats
    """(3,), unit: away from the table, at right angles to it."""
    height: float
    """Component of the plane's points along `up` [m]."""

    def is_clear_of(self, scene: Scene, prior: str, rows: Rows) -> NDArray[np.bool_]:
        """Flag the hands whose collision shapes are all above the table: (n,).

        `rows` are nominal rows of the scene whose hands have closed, `prior` that of their genomes. A hand is
        looked at in its commanded pose, both in the open posture and with the joints at the grasp.
        """
        hand = hand_geometry(scene.gripper)
        clear = np.zeros(len(rows), dtype=bool)
        for first in range(0, len(rows), ROWS_AT_ONCE):
            part = rows[first : first + ROWS_AT_ONCE]
            poses = part["base_to_object"].astype(np.float64)
            lows = [
                hand.lowest_points(poses, joints.astype(np.float64), self.up)
                for joints in (postures(scene, prior, part), part["joints"])
            ]
            clear[first : first + ROWS_AT_ONCE] = np.min(lows, axis=0) >= self.height
        return clear


def table_under(scene: Scene, object_to_world: Rotation = AS_MODELLED) -> TablePlane:
    """Return the table that an object stands on in this orientation; z of the world is up."""
    up = object_to_world.inv().apply([0.0, 0.0, 1.0])
    vertices = scene.object.vertices.astype(np.float64)
    return TablePlane(up, float((vertices @ up).min()))


def orientation(words: str) -> Rotation:
    """Read a quaternion "x,y,z,w", or angles "x,y,z" about the fixed axes in turn [deg].

    Raises `ImpossibleValue` for other words.
    """
    found = parse_numbers(words)
    if len(found) == 3 and np.isfinite(found).all():
        return Rotation.from_euler("xyz", found, degrees=True)
    if len(found) == 4 and np.isfinite(found).all() and np.linalg.norm(found) > 1e-6:
        return Rotation.from_quat(found)
    expected = "a quaternion x,y,z,w or angles x,y,z in degrees, such as 90,0,0"
    raise ImpossibleValue("--object-pose", words, expected)
