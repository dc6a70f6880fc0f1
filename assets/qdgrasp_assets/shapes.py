"""The collision shapes of a robot as triangles, and how large they make it."""

import io
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.mesh import Floats, Mesh
from qdgrasp_assets.obj import read_obj
from qdgrasp_assets.stl import triangles
from qdgrasp_assets.urdf import Urdf, origin
from qdgrasp_protocol.errors import AssetError


@dataclass(frozen=True)
class Shape:
    """One collision shape of a link."""

    link: str
    vertices: Floats
    """(v, 3) [m], link frame."""
    faces: NDArray[np.int64]
    """(f, 3)."""


def shapes(robot: Urdf, files: Mapping[str, bytes]) -> Iterator[Shape]:
    """The collision shapes of a robot's links; `files` holds its meshes by the names that it uses.

    Raises
    ------
    AssetError
        A mesh has no triangles.
    """
    for link in robot.element.findall("link"):
        for collision in link.findall("collision"):
            geometry = collision.find("geometry")
            if geometry is None or not len(geometry):
                continue
            mesh, name = FORMS[geometry[0].tag](geometry[0], files), link.get("name", "")
            if not len(mesh.faces):
                raise AssetError(
                    f"The URDF '{robot.path}' has an empty collision shape: the mesh of link '{name}' has no "
                    "triangles; give it one with a surface, or leave the shape out."
                )
            frame = origin(robot.path, collision.find("origin"))
            placed = mesh.vertices @ frame[:3, :3].T + frame[:3, 3]
            yield Shape(name, placed, mesh.faces)


def largest_side(robot: Urdf, files: Mapping[str, bytes]) -> float:
    """The largest side of the bounding box of all shapes, joints at zero, frame of the root link [m]."""
    frames = robot.forward({})
    corners = [
        shape.vertices @ frames[shape.link][:3, :3].T + frames[shape.link][:3, 3]
        for shape in shapes(robot, files)
    ]
    return float(np.ptp(np.concatenate(corners), axis=0).max()) if corners else 0.0


def _mesh(element: ET.Element, files: Mapping[str, bytes]) -> Mesh:
    name = element.get("filename", "")
    mesh = _read(files[name], PurePosixPath(name).suffix.removeprefix(".").lower())
    return Mesh(mesh.vertices * numbers(element, "scale", "1 1 1"), mesh.faces)


def _read(content: bytes, kind: str) -> Mesh:
    """A mesh file, coincident vertices merged; Collada and others by trimesh, which takes long to import."""
    corners = READERS[kind](content) if kind in READERS else None
    if corners is not None:
        vertices, faces = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
        return Mesh(vertices, faces.reshape(-1, 3).astype(np.int64))
    import trimesh

    return _plain(trimesh.load_mesh(io.BytesIO(content), file_type=kind))


def _obj(content: bytes) -> Floats:
    """The corners (f, 3, 3) of the triangles of an OBJ file."""
    read = read_obj(content.decode("utf-8", "replace"))
    return np.concatenate([np.zeros((0, 3, 3)), *(read.vertices[group] for group in read.groups)])


READERS: dict[str, Callable[[bytes], Floats | None]] = {"stl": triangles, "obj": _obj}
"""What is read here."""


def _box(element: ET.Element, _: Mapping[str, bytes]) -> Mesh:
    import trimesh

    return _plain(trimesh.creation.box(numbers(element, "size", "0 0 0")))


def _cylinder(element: ET.Element, _: Mapping[str, bytes]) -> Mesh:
    import trimesh

    return _plain(trimesh.creation.cylinder(float(element.get("radius", 0)), float(element.get("length", 0))))


def _sphere(element: ET.Element, _: Mapping[str, bytes]) -> Mesh:
    import trimesh

    return _plain(trimesh.creation.icosphere(subdivisions=3, radius=float(element.get("radius", 0))))


def _plain(mesh: Any) -> Mesh:
    """A mesh of trimesh's as one of ours."""
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    return Mesh(np.array(mesh.vertices), np.array(mesh.faces))


FORMS = {"mesh": _mesh, "box": _box, "cylinder": _cylinder, "sphere": _sphere}
"""The geometries of URDF."""


def numbers(element: ET.Element, name: str, default: str) -> list[float]:
    """The numbers of an attribute."""
    return [float(word) for word in element.get(name, default).split()]
