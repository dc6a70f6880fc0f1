"""A hand as a picture shows it: the links that collide, where its joints put them."""

import io
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from qdgrasp_assets.scene import SceneGripper
from qdgrasp_assets.urdf import Urdf, tree

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Shape:
    """One collision shape of a link."""

    link: str
    finger: bool
    vertices: Floats
    """(v, 3) [m], link frame."""
    faces: NDArray[np.int64]
    """(f, 3)."""


@dataclass(frozen=True)
class Hand:
    """A gripper's shapes on its joints."""

    gripper: SceneGripper
    robot: Urdf
    shapes: tuple[Shape, ...]

    def posed(self, base_to_object: Floats, joints: Floats) -> Iterator[tuple[Shape, Floats]]:
        """Each shape with its vertices (v, 3) [m] in the object's CoM frame.

        Parameters
        ----------
        base_to_object
            (7,): position [m] and quaternion xyzw of the hand's root link.
        joints
            (j,): finger joint positions [rad or m], in the gripper's order.
        """
        names = [joint.name for joint in self.gripper.joints]
        frames = self.robot.forward(dict(zip(names, joints.tolist(), strict=True)), _frame(base_to_object))
        for shape in self.shapes:
            frame = frames[shape.link]
            yield shape, shape.vertices @ frame[:3, :3].T + frame[:3, 3]


def hand(gripper: SceneGripper) -> Hand:
    """The hand of a scene, its carrier left out."""
    element = ET.fromstring(gripper.urdf)  # noqa: S314  # a scene that was read and checked
    robot = tree(Path(gripper.name), element).subtree(gripper.base_link)
    return Hand(gripper, robot, tuple(_shapes(gripper, robot)))


def _shapes(gripper: SceneGripper, robot: Urdf) -> Iterator[Shape]:
    for link in robot.element.findall("link"):
        name = link.get("name", "")
        for collision in link.findall("collision"):
            geometry = collision.find("geometry")
            if geometry is None or not len(geometry):
                continue
            mesh = FORMS[geometry[0].tag](geometry[0], gripper.meshes)
            mesh.merge_vertices(merge_tex=True, merge_norm=True)
            mesh.apply_transform(_origin(collision.find("origin")))
            yield Shape(name, name in gripper.finger_links, np.array(mesh.vertices), np.array(mesh.faces))


def _mesh(element: ET.Element, files: dict[str, bytes]) -> Any:
    name = element.get("filename", "")
    kind = PurePosixPath(name).suffix.removeprefix(".").lower()
    mesh = trimesh.load_mesh(io.BytesIO(files[name]), file_type=kind)
    mesh.vertices *= _numbers(element, "scale", "1 1 1")
    return mesh


def _box(element: ET.Element, _: dict[str, bytes]) -> Any:
    return trimesh.creation.box(_numbers(element, "size", "0 0 0"))


def _cylinder(element: ET.Element, _: dict[str, bytes]) -> Any:
    return trimesh.creation.cylinder(float(element.get("radius", 0)), float(element.get("length", 0)))


def _sphere(element: ET.Element, _: dict[str, bytes]) -> Any:
    return trimesh.creation.icosphere(subdivisions=3, radius=float(element.get("radius", 0)))


FORMS = {"mesh": _mesh, "box": _box, "cylinder": _cylinder, "sphere": _sphere}
"""The geometries of URDF."""


def _origin(element: ET.Element | None) -> Floats:
    frame = np.eye(4)
    if element is not None:
        frame[:3, :3] = Rotation.from_euler("xyz", _numbers(element, "rpy", "0 0 0")).as_matrix()
        frame[:3, 3] = _numbers(element, "xyz", "0 0 0")
    return frame


def _frame(pose: Floats) -> Floats:
    frame = np.eye(4)
    frame[:3, :3] = Rotation.from_quat(pose[3:]).as_matrix()
    frame[:3, 3] = pose[:3]
    return frame


def _numbers(element: ET.Element, name: str, default: str) -> list[float]:
    return [float(word) for word in element.get(name, default).split()]
