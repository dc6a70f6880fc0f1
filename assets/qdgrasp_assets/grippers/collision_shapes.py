"""Collision shapes of a robot, as triangles and as the simulator's convex parts.

The simulator wraps an STL in one hull, and each group of an OBJ in one of its own; the parts are never more
than it takes. Round shapes are given by corners on them, so that their hull lies within. What is not known
here has no corners.
"""

import io
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import Floats, Mesh, read_obj, stl_triangles
from qdgrasp_assets.geometry.primitives import geodesic
from qdgrasp_assets.grippers.urdf import Urdf, parse_origin
from qdgrasp_protocol.errors import AssetError


@dataclass(frozen=True)
class CollisionShape:
    """One collision shape of a link."""

    link: str
    vertices: Floats
    """(v, 3) [m], link frame."""
    faces: NDArray[np.int64]
    """(f, 3)."""


def shapes(robot: Urdf, files: Mapping[str, bytes]) -> Iterator[CollisionShape]:
    """Yield the collision shapes of a robot's links; `files` holds its meshes by name.

    Raises `AssetError` if a mesh has no triangles.
    """
    for link in robot.element.findall("link"):
        for collision in link.findall("collision"):
            geometry = collision.find("geometry")
            if geometry is None or not len(geometry):
                continue
            mesh, name = TRIANGLE_FORMS[geometry[0].tag](geometry[0], files), link.get("name", "")
            if not len(mesh.faces):
                raise AssetError(
                    f"The URDF '{robot.path}' has an empty collision shape: the mesh of link '{name}' has no "
                    "triangles; give it one with a surface, or leave the shape out."
                )
            frame = parse_origin(robot.path, collision.find("origin"))
            placed = mesh.vertices @ frame[:3, :3].T + frame[:3, 3]
            yield CollisionShape(name, placed, mesh.faces)


def largest_side(robot: Urdf, files: Mapping[str, bytes]) -> float:
    """Return the largest side of the box around all shapes, joints at zero, root frame [m]."""
    frames = robot.forward({})
    corners = [
        shape.vertices @ frames[shape.link][:3, :3].T + frames[shape.link][:3, 3]
        for shape in shapes(robot, files)
    ]
    return float(np.ptp(np.concatenate(corners), axis=0).max()) if corners else 0.0


def _mesh_triangles(element: ET.Element, files: Mapping[str, bytes]) -> Mesh:
    name = element.get("filename", "")
    mesh = _read_mesh(files[name], PurePosixPath(name).suffix.removeprefix(".").lower())
    return Mesh(mesh.vertices * attribute_numbers(element, "scale", "1 1 1"), mesh.faces)


def _read_mesh(content: bytes, kind: str) -> Mesh:
    """Read a mesh file, coincident vertices merged.

    Collada and others are read by trimesh, which takes long to import.
    """
    corners = TRIANGLE_READERS[kind](content) if kind in TRIANGLE_READERS else None
    if corners is not None:
        vertices, faces = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
        return Mesh(vertices, faces.reshape(-1, 3).astype(np.int64))
    import trimesh

    return _mesh_of_trimesh(trimesh.load_mesh(io.BytesIO(content), file_type=kind))


def _obj_triangles(content: bytes) -> Floats:
    """Return the corners (f, 3, 3) of the triangles of an OBJ file."""
    read = read_obj(content.decode("utf-8", "replace"))
    return np.concatenate([np.zeros((0, 3, 3)), *(read.vertices[group] for group in read.groups)])


TRIANGLE_READERS: dict[str, Callable[[bytes], Floats | None]] = {"stl": stl_triangles, "obj": _obj_triangles}
"""Own readers by file type."""


def _box_triangles(element: ET.Element, _: Mapping[str, bytes]) -> Mesh:
    import trimesh

    return _mesh_of_trimesh(trimesh.creation.box(attribute_numbers(element, "size", "0 0 0")))


def _cylinder_triangles(element: ET.Element, _: Mapping[str, bytes]) -> Mesh:
    import trimesh

    return _mesh_of_trimesh(
        trimesh.creation.cylinder(float(element.get("radius", 0)), float(element.get("length", 0)))
    )


def _sphere_triangles(element: ET.Element, _: Mapping[str, bytes]) -> Mesh:
    import trimesh

    return _mesh_of_trimesh(
        trimesh.creation.icosphere(subdivisions=3, radius=float(element.get("radius", 0)))
    )


def _mesh_of_trimesh(mesh: Any) -> Mesh:
    """Convert a trimesh mesh to a `Mesh`."""
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    return Mesh(np.array(mesh.vertices), np.array(mesh.faces))


TRIANGLE_FORMS = {
    "mesh": _mesh_triangles,
    "box": _box_triangles,
    "cylinder": _cylinder_triangles,
    "sphere": _sphere_triangles,
}
"""The geometries of URDF."""


def attribute_numbers(element: ET.Element, name: str, default: str) -> list[float]:
    """Return the numbers of an attribute."""
    return [float(word) for word in element.get(name, default).split()]


CYLINDER_SIDES = 16
"""Sides of the prism within a cylinder; the simulator's has 32, with these among its edges."""
CONCAVE = "concave"  # Attribute of a collision shape that Bullet takes as bare triangles, without an inside


@dataclass(frozen=True)
class ConvexPart:
    """One convex part of a link."""

    link: str
    corners: Floats
    """(v, 3) [m], link frame: the part is their hull."""


def link_convex_parts(robot: Urdf, files: Mapping[str, bytes]) -> Iterator[ConvexPart]:
    """Yield the convex parts of a robot's links; `files` holds its meshes by their names in it."""
    for link in robot.element.findall("link"):
        for collision in link.findall("collision"):
            for corners in _collision_corners(robot, collision, files):
                yield ConvexPart(link.get("name", ""), corners)


def is_all_convex(robot: Urdf, files: Mapping[str, bytes]) -> bool:
    """Return whether every collision shape of a robot has parts among `convex_parts`."""
    shapes = robot.element.iterfind("link/collision")
    return all(any(True for _ in _collision_corners(robot, shape, files)) for shape in shapes)


def _collision_corners(robot: Urdf, collision: ET.Element, files: Mapping[str, bytes]) -> Iterator[Floats]:
    """Yield the corners (v, 3) of each part of a collision shape [m], link frame."""
    geometry = collision.find("geometry")
    if geometry is None or not len(geometry) or geometry[0].tag not in CORNER_FORMS:
        return
    if collision.get(CONCAVE) is not None:
        return
    frame = parse_origin(robot.path, collision.find("origin"))
    for corners in CORNER_FORMS[geometry[0].tag](geometry[0], files):
        yield corners @ frame[:3, :3].T + frame[:3, 3]


def obj_group_corners(obj: str) -> Iterator[Floats]:
    """Yield the corners (v, 3) of each group of an OBJ file that has triangles."""
    read = read_obj(obj)
    for group in read.groups:
        yield read.vertices[np.unique(group)]


def _stl_corners(content: bytes) -> Iterator[Floats]:
    """Yield the corners of all triangles of an STL file, as one part."""
    corners = stl_triangles(content)
    if corners is not None:
        yield np.unique(corners.reshape(-1, 3), axis=0)


def _obj_corners(content: bytes) -> Iterator[Floats]:
    yield from obj_group_corners(content.decode("utf-8", "replace"))


CORNER_READERS = {".stl": _stl_corners, ".obj": _obj_corners}


def _mesh_corners(element: ET.Element, files: Mapping[str, bytes]) -> Iterator[Floats]:
    name = element.get("filename", "")
    reader = CORNER_READERS.get(PurePosixPath(name).suffix.lower())
    for corners in reader(files[name]) if reader else ():
        yield corners * attribute_numbers(element, "scale", "1 1 1")


def _box_corners(element: ET.Element, _: Mapping[str, bytes]) -> Iterator[Floats]:
    yield np.array(list(product((-0.5, 0.5), repeat=3))) * attribute_numbers(element, "size", "0 0 0")


def _cylinder_corners(element: ET.Element, _: Mapping[str, bytes]) -> Iterator[Floats]:
    radius, length = float(element.get("radius", 0)), float(element.get("length", 0))
    angles = np.arange(CYLINDER_SIDES) * (2 * np.pi / CYLINDER_SIDES)
    ring = np.stack(
        [radius * np.cos(angles), radius * np.sin(angles), np.full(CYLINDER_SIDES, length / 2)], axis=1
    )
    yield np.concatenate([ring, ring * (1.0, 1.0, -1.0)])


def _sphere_corners(element: ET.Element, _: Mapping[str, bytes]) -> Iterator[Floats]:
    yield geodesic(float(element.get("radius", 0)), 3).vertices


CORNER_FORMS = {
    "mesh": _mesh_corners,
    "box": _box_corners,
    "cylinder": _cylinder_corners,
    "sphere": _sphere_corners,
}
"""The geometries of URDF."""
