"""Triangle meshes: what they measure, and files of convex parts."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.obj import read_obj
from qdgrasp_protocol.errors import AssetError

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh; outward normals follow from counter-clockwise winding."""

    vertices: Floats
    """(v, 3) [m]."""
    faces: NDArray[np.int64]
    """(f, 3), indices of vertices."""

    @property
    def corners(self) -> Floats:
        """(f, 3, 3) [m]: the corners of each triangle."""
        corners: Floats = self.vertices[self.faces]
        return corners

    @property
    def crosses(self) -> Floats:
        """(f, 3) [m2]: twice the area of each triangle, along its normal."""
        a, b, c = np.moveaxis(self.corners, 1, 0)
        crosses: Floats = np.cross(b - a, c - a)
        return crosses

    @property
    def areas(self) -> Floats:
        """(f,) [m2]."""
        areas: Floats = np.linalg.norm(self.crosses, axis=1) / 2
        return areas

    @property
    def normals(self) -> Floats:
        """(f, 3), unit; zeros for triangles without area."""
        crosses = self.crosses
        lengths = np.linalg.norm(crosses, axis=1, keepdims=True)
        normals: Floats = np.divide(crosses, lengths, out=np.zeros_like(crosses), where=lengths > 0)
        return normals

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Low and high corner of the axis-aligned bounding box [m]."""
        used = self.vertices[np.unique(self.faces)]
        return used.min(axis=0), used.max(axis=0)

    @property
    def extents(self) -> Floats:
        """(3,) [m]: sides of the bounding box."""
        low, high = self.bounds
        return high - low

    @property
    def cone_volumes(self) -> Floats:
        """(f,) [m3]: signed volumes of the tetrahedra between the triangles and the origin."""
        a, b, c = np.moveaxis(self.corners, 1, 0)
        volumes: Floats = np.einsum("ij,ij->i", np.cross(a, b), c) / 6
        return volumes

    @property
    def volume(self) -> float:
        """Enclosed volume [m3]; negative for a mesh that is inside out."""
        return float(self.cone_volumes.sum())

    @property
    def centre_of_mass(self) -> Floats:
        """(3,) [m]: of the enclosed volume, at uniform density."""
        moments = self.cone_volumes[:, None] * self.corners.sum(axis=1) / 4
        centre: Floats = moments.sum(axis=0) / self.volume
        return centre

    @property
    def inertia(self) -> Floats:
        """(3, 3) [m2]: of the enclosed volume at uniform density, for 1 kg, about its centre of mass."""
        low, high = self.bounds
        near = self.moved(-(low + high) / 2)  # far from the origin, it would be a difference of large numbers
        corners, volumes = near.corners, near.cone_volumes
        sums = corners.sum(axis=1)
        moments = np.einsum("f,fi,fj->ij", volumes, sums, sums)
        moments += np.einsum("f,fki,fkj->ij", volumes, corners, corners)
        centre = near.centre_of_mass
        spread = moments / 20 / near.volume - np.outer(centre, centre)
        inertia: Floats = np.trace(spread) * np.eye(3) - (spread + spread.T) / 2
        return inertia

    def scaled(self, scale: float) -> "Mesh":
        """The mesh with its coordinates multiplied by `scale`."""
        return Mesh(self.vertices * scale, self.faces)

    def moved(self, shift: Iterable[float]) -> "Mesh":
        """The mesh shifted by (3,) [m]."""
        return Mesh(self.vertices + np.array(tuple(shift)), self.faces)

    def flipped(self) -> "Mesh":
        """The mesh with every triangle wound the other way."""
        return Mesh(self.vertices, self.faces[:, ::-1])


def join(meshes: Iterable[Mesh]) -> Mesh:
    """All triangles of several meshes as one."""
    meshes = tuple(meshes)
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]),
    )


def read_parts(path: Path) -> tuple[Mesh, ...]:
    """The convex parts in an OBJ file, one for each group, vertices and triangles in the file's order.

    Raises
    ------
    AssetError
        It is not there or not such a file.
    """
    try:
        return _parts(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise AssetError(f"No convex parts can be read at '{path}': {error.strerror or error}.") from None
    except (ValueError, IndexError) as error:
        raise AssetError(f"'{path}' is not an OBJ file of convex parts: {error}.") from None


def _parts(text: str) -> tuple[Mesh, ...]:
    read = read_obj(text)
    return tuple(_part(read.vertices, group) for group in read.groups)


def _part(vertices: Floats, faces: NDArray[np.int64]) -> Mesh:
    """A part with its own vertices only."""
    used, local = np.unique(faces, return_inverse=True)
    return Mesh(vertices[used], local.reshape(-1, 3))


def parts_to_obj(parts: Iterable[Mesh]) -> bytes:
    """An OBJ file of convex parts, one `o` group each, coordinates to the nanometre."""
    lines: list[str] = []
    first = 1
    for number, part in enumerate(parts):
        lines.append(f"o part_{number}")
        lines += [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in part.vertices]
        lines += [f"f {a} {b} {c}" for a, b, c in part.faces + first]
        first += len(part.vertices)
    return ("\n".join(lines) + "\n").encode()
