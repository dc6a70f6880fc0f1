"""The collision shapes of a robot as triangles, and how large they make it."""

import io
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from qdgrasp_assets.mesh import Floats
from qdgrasp_assets.urdf import Urdf


@dataclass(frozen=True)
class Shape:
    """One collision shape of a link."""

    link: str
    vertices: Floats
    """(v, 3) [m], link frame."""
    faces: NDArray[np.int64]
    """(f, 3)."""


def shapes(robot: Urdf, files: Mapping[str, bytes]) -> Iterator[Shape]:
    """The collision shapes of a robot's links; `files` holds its meshes by the names that it uses."""
    for link in robot.element.findall("link"):
        for collision in link.findall("collision"):
            geometry = collision.find("geometry")
            if geometry is None or not len(geometry):
                continue
            mesh = FORMS[geometry[0].tag](geometry[0], files)
            mesh.merge_vertices(merge_tex=True, merge_norm=True)
            mesh.apply_transform(origin(collision.find("origin")))
            yield Shape(link.get("name", ""), np.array(mesh.vertices), np.array(mesh.faces))


def largest_side(robot: Urdf, files: Mapping[str, bytes]) -> float:
    """The largest side of the bounding box of all shapes, joints at zero, frame of the root link [m]."""
    frames = robot.forward({})
    corners = [
        shape.vertices @ frames[shape.link][:3, :3].T + frames[shape.link][:3, 3]
        for shape in shapes(robot, files)
    ]
    return float(np.ptp(np.concatenate(corners), axis=0).max()) if corners else 0.0


def _mesh(element: ET.Element, files: Mapping[str, bytes]) -> Any:
    import trimesh

    name = element.get("filename", "")
    kind = PurePosixPath(name).suffix.removeprefix(".").lower()
    mesh = trimesh.load_mesh(io.BytesIO(files[name]), file_type=kind)
    mesh.vertices *= numbers(element, "scale", "1 1 1")
    return mesh


def _box(element: ET.Element, _: Mapping[str, bytes]) -> Any:
    import trimesh

    return trimesh.creation.box(numbers(element, "size", "0 0 0"))


def _cylinder(element: ET.Element, _: Mapping[str, bytes]) -> Any:
    import trimesh

    return trimesh.creation.cylinder(float(element.get("radius", 0)), float(element.get("length", 0)))


def _sphere(element: ET.Element, _: Mapping[str, bytes]) -> Any:
    import trimesh

    return trimesh.creation.icosphere(subdivisions=3, radius=float(element.get("radius", 0)))


FORMS = {"mesh": _mesh, "box": _box, "cylinder": _cylinder, "sphere": _sphere}
"""The geometries of URDF."""


def origin(element: ET.Element | None) -> Floats:
    """The frame (4, 4) that an `<origin>` stands for."""
    frame = np.eye(4)
    if element is not None:
        frame[:3, :3] = Rotation.from_euler("xyz", numbers(element, "rpy", "0 0 0")).as_matrix()
        frame[:3, 3] = numbers(element, "xyz", "0 0 0")
    return frame


def numbers(element: ET.Element, name: str, default: str) -> list[float]:
    """The numbers of an attribute."""
    return [float(word) for word in element.get(name, default).split()]
