"""The collision shapes of a robot as convex parts, as the simulator takes them; never more than it takes.

The simulator wraps an STL in one hull, and each group of an OBJ in one of its own. Round shapes are given by
corners on them, so that their hull lies within. What is not known here has no corners.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import PurePosixPath

import numpy as np

from qdgrasp_assets.mesh import Floats
from qdgrasp_assets.obj import read_obj
from qdgrasp_assets.objects.solids import geodesic
from qdgrasp_assets.shapes import numbers
from qdgrasp_assets.stl import triangles
from qdgrasp_assets.urdf import Urdf, origin

SIDES = 16
"""Of the prism within a cylinder; the simulator's has 32, with these among its edges."""
CONCAVE = "concave"
"""The attribute of a collision shape that the simulator takes as bare triangles, which have no inside."""


@dataclass(frozen=True)
class Part:
    """One convex part of a link."""

    link: str
    corners: Floats
    """(v, 3) [m], link frame: it is their hull."""


def convex_parts(robot: Urdf, files: Mapping[str, bytes]) -> Iterator[Part]:
    """The convex parts of a robot's links; `files` holds its meshes by the names that it uses."""
    for link in robot.element.findall("link"):
        for collision in link.findall("collision"):
            for corners in _corners(robot, collision, files):
                yield Part(link.get("name", ""), corners)


def is_all_convex(robot: Urdf, files: Mapping[str, bytes]) -> bool:
    """Whether every collision shape of a robot has parts among `convex_parts`."""
    shapes = robot.element.iterfind("link/collision")
    return all(any(True for _ in _corners(robot, shape, files)) for shape in shapes)


def _corners(robot: Urdf, collision: ET.Element, files: Mapping[str, bytes]) -> Iterator[Floats]:
    """The corners (v, 3) of each part of a collision shape [m], link frame."""
    geometry = collision.find("geometry")
    if geometry is None or not len(geometry) or geometry[0].tag not in FORMS:
        return
    if collision.get(CONCAVE) is not None:
        return
    frame = origin(robot.path, collision.find("origin"))
    for corners in FORMS[geometry[0].tag](geometry[0], files):
        yield corners @ frame[:3, :3].T + frame[:3, 3]


def groups(obj: str) -> Iterator[Floats]:
    """The corners (v, 3) of each group of an OBJ file that has triangles."""
    read = read_obj(obj)
    for group in read.groups:
        yield read.vertices[np.unique(group)]


def _stl(content: bytes) -> Iterator[Floats]:
    """The corners of all triangles of an STL file, as one part."""
    corners = triangles(content)
    if corners is not None:
        yield np.unique(corners.reshape(-1, 3), axis=0)


def _obj(content: bytes) -> Iterator[Floats]:
    yield from groups(content.decode("utf-8", "replace"))


READERS = {".stl": _stl, ".obj": _obj}


def _mesh(element: ET.Element, files: Mapping[str, bytes]) -> Iterator[Floats]:
    name = element.get("filename", "")
    reader = READERS.get(PurePosixPath(name).suffix.lower())
    for corners in reader(files[name]) if reader else ():
        yield corners * numbers(element, "scale", "1 1 1")


def _box(element: ET.Element, _: Mapping[str, bytes]) -> Iterator[Floats]:
    yield np.array(list(product((-0.5, 0.5), repeat=3))) * numbers(element, "size", "0 0 0")


def _cylinder(element: ET.Element, _: Mapping[str, bytes]) -> Iterator[Floats]:
    radius, length = float(element.get("radius", 0)), float(element.get("length", 0))
    angles = np.arange(SIDES) * (2 * np.pi / SIDES)
    ring = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(SIDES, length / 2)], axis=1)
    yield np.concatenate([ring, ring * (1.0, 1.0, -1.0)])


def _sphere(element: ET.Element, _: Mapping[str, bytes]) -> Iterator[Floats]:
    yield geodesic(float(element.get("radius", 0)), 3).vertices


FORMS = {"mesh": _mesh, "box": _box, "cylinder": _cylinder, "sphere": _sphere}
"""The geometries of URDF."""
