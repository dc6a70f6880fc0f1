"""Triangle meshes, and readers of OBJ and binary STL files that need no library.

Of an OBJ file materials, normals and texture are left aside. Its parts are the groups that the simulator
makes a hull of each; a material begins none.
"""

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise, product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qdgrasp_protocol.errors import AssetError

Floats = NDArray[np.float64]
OBJ_GROUP = re.compile(r"[ \t]*[og][ \t]")
"""Start of another group, as for Bullet's reader: a blank must follow the letter."""


FAR_FROM_ORIGIN = 1.0  # Distance from its origin beyond which a mesh is moved for volumes and rays [m]
STL_HEADER, STL_TRIANGLE = 84, 50  # bytes
STL_CORNERS = slice(12, 48)  # Bytes of a triangle's corners, after its normal


def stl_triangles(content: bytes) -> Floats | None:
    """Return the corners (t, 3, 3) of the triangles of an STL file; None if it is not binary."""
    count = int.from_bytes(content[STL_HEADER - 4 : STL_HEADER], "little")
    if len(content) != STL_HEADER + STL_TRIANGLE * count:
        return None
    records = np.frombuffer(content, np.uint8, offset=STL_HEADER).reshape(-1, STL_TRIANGLE)
    corners = np.ascontiguousarray(records[:, STL_CORNERS]).view("<f4")
    return corners.astype(np.float64).reshape(-1, 3, 3)


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
        return np.asarray(self.vertices[self.faces])

    @property
    def crosses(self) -> Floats:
        """(f, 3) [m2]: twice the area of each triangle, along its normal."""
        a, b, c = np.moveaxis(self.corners, 1, 0)
        return np.asarray(np.cross(b - a, c - a))

    @property
    def areas(self) -> Floats:
        """(f,) [m2]."""
        return np.asarray(np.linalg.norm(self.crosses, axis=1) / 2)

    @property
    def normals(self) -> Floats:
        """(f, 3), unit; zeros for triangles without area."""
        crosses = self.crosses
        lengths = np.linalg.norm(crosses, axis=1, keepdims=True)
        return np.asarray(np.divide(crosses, lengths, out=np.zeros_like(crosses), where=lengths > 0))

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
    def reference_point(self) -> Floats:
        """(3,) [m]: a point near the mesh, from which volumes and rays are exact; mostly the origin."""
        near: Floats = self.corners[:, 0].sum(axis=0) / max(1, len(self.faces))
        return near if np.abs(near).max() > FAR_FROM_ORIGIN else np.zeros(3)

    @property
    def cone_volumes(self) -> Floats:
        """(f,) [m3]: signed volumes of the tetrahedra between the triangles and the reference point."""
        a, b, c = np.moveaxis(self.corners - self.reference_point, 1, 0)
        return np.asarray(np.einsum("ij,ij->i", np.cross(a, b), c) / 6)

    @property
    def volume(self) -> float:
        """Enclosed volume [m3]; negative for a mesh that is inside out."""
        return float(self.cone_volumes.sum())

    @property
    def centre_of_mass(self) -> Floats:
        """(3,) [m]: centre of mass of the enclosed volume, at uniform density."""
        moments = self.cone_volumes[:, None] * (self.corners - self.reference_point).sum(axis=1) / 4
        return np.asarray(moments.sum(axis=0) / self.volume + self.reference_point)

    @property
    def inertia(self) -> Floats:
        """(3, 3) [m2]: inertia per kg of the enclosed volume about its centre of mass."""
        low, high = self.bounds
        near = self.moved(-(low + high) / 2)  # far from the origin, it would be a difference of large numbers
        corners, volumes = near.corners, near.cone_volumes
        sums = corners.sum(axis=1)
        moments = np.einsum("f,fi,fj->ij", volumes, sums, sums)
        moments += np.einsum("f,fki,fkj->ij", volumes, corners, corners)
        centre = near.centre_of_mass
        spread = moments / 20 / near.volume - np.outer(centre, centre)
        return np.asarray(np.trace(spread) * np.eye(3) - (spread + spread.T) / 2)

    def scaled(self, scale: float) -> "Mesh":
        """Return the mesh with its coordinates multiplied by `scale`."""
        return Mesh(self.vertices * scale, self.faces)

    def moved(self, shift: Iterable[float]) -> "Mesh":
        """Return the mesh shifted by (3,) [m]."""
        return Mesh(self.vertices + np.array(tuple(shift)), self.faces)

    def flipped(self) -> "Mesh":
        """Return the mesh with every triangle wound the other way."""
        return Mesh(self.vertices, self.faces[:, ::-1])


@contextmanager
def unreadable_as(sentence: str, name: object) -> Iterator[None]:
    """Raise an AssetError of a name and an error for any error of a reader of meshes."""
    try:
        yield
    except AssetError:
        raise
    except Exception as error:  # noqa: BLE001  # readers of meshes raise errors of any kind
        raise AssetError(sentence.format(name, f"{type(error).__name__}: {error}")) from None


def join(meshes: Iterable[Mesh]) -> Mesh:
    """Return all triangles of several meshes as one."""
    meshes = tuple(meshes)
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]),
    )


def read_parts(path: Path) -> tuple[Mesh, ...]:
    """Read the convex parts in an OBJ file, one for each group; else `AssetError`."""
    with unreadable_as("No convex parts can be read at '{}': {}.", path):
        return parse_parts(path.read_text(encoding="utf-8"))


@lru_cache(maxsize=32)  # of a hand they are asked for many times
def parse_parts(text: str) -> tuple[Mesh, ...]:
    """Return the groups of an OBJ text that have triangles, polygons as fans; else `ValueError`."""
    return tuple(part for _, part in named_groups(text, OBJ_GROUP))


def named_groups(text: str, start: re.Pattern[str]) -> Iterator[tuple[dict[str, str], Mesh]]:
    """Yield the groups of an OBJ text that have triangles, with the last name of each kind.

    A group begins at each line that matches `start`: a kind, as "o", and a name. Errors of `parse_parts`.
    """
    vertices: list[list[float]] = []
    groups: list[tuple[dict[str, str], list[tuple[int, int, int]]]] = [({}, [])]
    for line in text.splitlines():
        word, *values = line.split() or [""]
        if word == "v":
            vertices.append([float(value) for value in values[:3]])
        elif word == "f":
            # a corner such as 7/1/3 begins with its vertex; negative numbers count from the end
            numbers = [int(value.split("/")[0]) for value in values]
            first, *rest = [number - 1 if number > 0 else len(vertices) + number for number in numbers]
            groups[-1][1].extend((first, a, b) for a, b in pairwise(rest))
        elif start.match(line):
            groups.append((groups[-1][0] | {word: " ".join(values)}, []))
    points = np.array(vertices).reshape(-1, 3)
    for names, group in [each for each in groups if each[1]]:
        used, local = np.unique(group, return_inverse=True)
        if used[0] < 0 or used[-1] >= len(points):
            raise ValueError("a face names a vertex that is not there")
        yield names, Mesh(points[used], local.reshape(-1, 3))


def parts_to_obj(parts: Iterable[Mesh]) -> bytes:
    """Return an OBJ file of convex parts, one `o` group each, coordinates to the nanometre."""
    lines: list[str] = []
    first = 1
    for number, part in enumerate(parts):
        lines.append(f"o part_{number}")
        lines += [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in part.vertices]
        lines += [f"f {a} {b} {c}" for a, b, c in part.faces + first]
        first += len(part.vertices)
    return ("\n".join(lines) + "\n").encode()


GOLDEN = (1 + 5**0.5) / 2


def hull(points: Floats) -> Mesh:
    """Return the convex hull of (n, 3) points, wound outward; only points on it are kept."""
    from scipy.spatial import ConvexHull

    found = ConvexHull(points)
    used, faces = np.unique(found.simplices, return_inverse=True)
    mesh = Mesh(points[used], faces.reshape(-1, 3).astype(np.int64))
    inward = np.einsum("fc,fc->f", mesh.normals, found.equations[:, :3]) < 0
    return Mesh(mesh.vertices, np.where(inward[:, None], mesh.faces[:, ::-1], mesh.faces))


def heights(solid: Mesh, points: Floats) -> Floats:
    """Return the distances (n, f) [m] of points before a convex solid's faces; negative behind."""
    normals = solid.normals
    return np.asarray(points @ normals.T - np.einsum("fc,fc->f", normals, solid.corners[:, 0]))


def box(sides: tuple[float, float, float]) -> Mesh:
    """Return a box of these sides [m] around the origin."""
    return hull(np.array(list(product((-0.5, 0.5), repeat=3))) * sides)


def geodesic(radius: float, frequency: int) -> Mesh:
    """Return a sphere of 10 frequency^2 + 2 vertices; of full extents for even frequencies.

    They are the vertices of an icosahedron's edges divided `frequency` times, moved out to the sphere.
    """
    rectangle = np.array([(0.0, a, b * GOLDEN) for a in (-1, 1) for b in (-1, 1)])
    corners = np.concatenate([np.roll(rectangle, shift, axis=1) for shift in range(3)])
    steps = [(i, j, frequency - i - j) for i in range(frequency + 1) for j in range(frequency + 1 - i)]
    points = np.concatenate([np.array(steps) @ corners[face] / frequency for face in hull(corners).faces])
    units = points / np.linalg.norm(points, axis=1, keepdims=True)
    _, first = np.unique(units.round(9), axis=0, return_index=True)
    return hull(units[np.sort(first)] * radius)
