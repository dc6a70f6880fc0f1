"""Hollow links: meshes that the simulator fills, because it wraps each in its convex hull."""

import io
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isclose
from pathlib import Path, PurePosixPath

import numpy as np

from qdgrasp_assets.hands.body import collisions, corners_of, mesh_bytes
from qdgrasp_assets.hulls import CONCAVE
from qdgrasp_assets.mesh import Floats, Mesh
from qdgrasp_assets.objects.solids import hull
from qdgrasp_assets.room import Room
from qdgrasp_assets.shapes import numbers
from qdgrasp_assets.urdf import Urdf, origin
from qdgrasp_protocol.errors import AssetError

MUCH = 0.1
"""A link is hollow where its hull fills the room in front of this share of its surface."""
ALIKE = 0.001
"""Up to this share two volumes are taken for equal."""
SPACE = 3
"""Dimensions."""


@dataclass(frozen=True)
class Hollow:
    """A collision mesh and what its hull does to it."""

    link: str
    name: str
    """The mesh, as the URDF names it."""
    filled: float
    """The share of its surface in front of which there is room, and the hull fills it."""


def hollows(hand: Urdf) -> Iterator[Hollow]:
    """The collision meshes of a hand whose hulls are much larger than they are."""
    for link, shape in collisions(hand):
        mesh = shape.find("geometry/mesh")
        if mesh is None or shape.get(CONCAVE) is not None:
            continue
        parts = tuple(hull(corners) for corners in corners_of(hand, link, shape) if is_solid(corners))
        surface = read_shape(hand, shape, mesh)
        if not parts or are_all_of(surface, parts):
            continue
        filled = Room(surface).fit(parts).filled
        if filled > MUCH:
            yield Hollow(link, mesh.get("filename", ""), filled)


def are_all_of(mesh: Mesh, hulls: Sequence[Mesh]) -> bool:
    """Whether a mesh is nothing but these convex parts: it has no room that they could fill."""
    return isclose(sum(part.volume for part in hulls), mesh.volume, rel_tol=ALIKE)


def read_shape(hand: Urdf, shape: ET.Element, element: ET.Element) -> Mesh:
    """The triangles of a collision shape in its link's frame [m], by its `<mesh>`."""
    mesh = read_mesh_of(hand.path, element)
    frame = origin(hand.path, shape.find("origin"))
    return Mesh(mesh.vertices @ frame[:3, :3].T + frame[:3, 3], mesh.faces)


def read_mesh_of(urdf: Path, element: ET.Element) -> Mesh:
    """The triangles that a `<mesh>` names, scaled as it says; coincident vertices merged.

    Raises
    ------
    AssetError
        The mesh does not exist, or cannot be read.
    """
    import trimesh

    name = element.get("filename", "")
    content, kind = mesh_bytes(urdf, name), PurePosixPath(name).suffix.removeprefix(".").lower()
    try:
        read = trimesh.load_mesh(io.BytesIO(content), file_type=kind)
    except Exception as error:  # noqa: BLE001  # trimesh's readers raise whatever they stumble over
        raise AssetError(
            f"The mesh '{name}' cannot be read ({type(error).__name__}: {error}); save it as an STL or "
            "OBJ file."
        ) from None
    read.merge_vertices(merge_tex=True, merge_norm=True)
    scale = numbers(element, "scale", "1 1 1")
    mesh = Mesh(np.asarray(read.vertices, dtype=np.float64) * scale, np.asarray(read.faces, dtype=np.int64))
    return mesh.flipped() if np.prod(scale) < 0 else mesh


def is_solid(corners: Floats) -> bool:
    """Whether corners (v, 3) are not all in one plane."""
    return bool(len(corners) and np.linalg.matrix_rank(corners - corners[0], tol=1e-7) == SPACE)
