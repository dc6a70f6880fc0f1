"""What a camera sees of triangle meshes, by casting one ray for each point of the image.

Hidden surfaces, shadows and translucent layers come out right at every point, which sorting triangles by
their depth does not give. Lengths are metres; everything is deterministic.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numpy.typing import NDArray

from qdgrasp_assets.mesh import Mesh

Floats = NDArray[np.float32]
Places = NDArray[np.intp]

CREASE = np.cos(np.radians(38.0))
"""Faces that meet at a sharper angle keep their edge; others are seen as one smooth surface."""
LIFT = 1e-4
"""How far above a surface rays leave it, so that they do not meet it again [m]."""
FAR = 4.0
"""The eye's distance: beyond every scene [m]."""


@dataclass(frozen=True)
class Camera:
    """A parallel projection."""

    axes: Floats
    """(3, 3): unit vectors to the right, up, and toward the eye."""
    low: Floats
    """(2,) [m]: the image's lower left corner, to the right and up."""
    step: float
    """The distance of neighbouring points of the image [m]."""
    rows: int
    columns: int

    def seen(self, points: NDArray[np.floating]) -> Floats:
        """Points (n, 3) to the right, up and toward the eye (n, 3) [m]."""
        turned: Floats = np.asarray(points, np.float32) @ self.axes.T
        return turned

    def window(self, points: NDArray[np.floating]) -> Places:
        """The points of the image, numbered row by row, in the rectangle around `points` (n, 3)."""
        flat = (self.seen(points)[:, :2] - self.low) / self.step
        left, bottom = np.maximum(np.floor(flat.min(axis=0)) - 1, 0).astype(int)
        right, top = np.ceil(flat.max(axis=0)).astype(int) + 1
        rows = np.arange(max(self.rows - top, 0), max(self.rows - bottom, 0))
        columns = np.arange(left, min(right, self.columns))
        return (rows[:, None] * self.columns + columns).ravel()

    def origins(self, pixels: Places) -> Floats:
        """Where the rays of points of the image start, (n, 3) [m]."""
        row, column = np.divmod(pixels.astype(np.int32), np.int32(self.columns))
        eye = np.empty((len(pixels), 3), dtype=np.float32)
        eye[:, 0] = self.low[0] + (column + np.float32(0.5)) * np.float32(self.step)
        eye[:, 1] = self.low[1] + (self.rows - row - np.float32(0.5)) * np.float32(self.step)
        eye[:, 2] = FAR
        start: Floats = eye @ self.axes
        return start


MARGIN = 0.015
"""Left free on each side, as a share of the image."""
FIELD = 0.26
"""No image is narrower than this unless it is asked for [m], so that small things look small."""


def camera(
    points: NDArray[np.floating],
    azimuth: float,
    elevation: float,
    rows: int,
    columns: int,
    field: float = FIELD,
) -> Camera:
    """A camera at `azimuth` about z and `elevation` above it [rad], with all points (n, 3) in its image.

    The image is not narrower than `field` [m].
    """
    (ca, sa), (ce, se) = ((np.cos(angle), np.sin(angle)) for angle in (azimuth, elevation))
    right, toward = np.array([-sa, ca, 0.0]), np.array([ca * ce, sa * ce, se])
    axes = np.array([right, np.cross(toward, right), toward], dtype=np.float32)
    flat = np.asarray(points, np.float32) @ axes[:2].T
    low, high = flat.min(axis=0), flat.max(axis=0)
    fitted = (high - low) / (np.array([columns, rows]) * (1 - 2 * MARGIN))
    step = float(max(*fitted, field / columns))
    corner = (low + high) / 2 - np.array([columns, rows]) * step / 2
    return Camera(axes, corner.astype(np.float32), step, rows, columns)


@dataclass(frozen=True)
class Hits:
    """Where rays met a solid first."""

    pixels: Places
    """(m,): the points of the image whose rays met it."""
    depth: Floats
    """(m,) [m]: how far from the eye's plane."""
    points: Floats
    """(m, 3) [m]."""
    normals: Floats
    """(m, 3), unit."""
    faces: Places
    """(m,): the triangles."""


@dataclass(frozen=True)
class Solid:
    """A triangle mesh made ready for rays."""

    mesh: Mesh
    normals: Floats = field(init=False)
    """(f, 3, 3): the normal at each corner of each triangle."""
    rays: Any = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "normals", corner_normals(self.mesh))
        scene = rtcore_scene.EmbreeScene()
        TriangleMesh(scene, np.ascontiguousarray(self.mesh.corners, dtype=np.float32))
        object.__setattr__(self, "rays", scene)

    def seen_by(self, camera: Camera) -> Hits:
        """What the camera sees of it."""
        pixels = camera.window(self.mesh.vertices)
        starts = camera.origins(pixels)
        ray = -camera.axes[2]
        found = self.rays.run(starts, np.broadcast_to(ray, starts.shape).copy(), output=1)
        hit = np.flatnonzero(found["primID"] >= 0)
        faces, depth = found["primID"][hit].astype(np.intp), found["tfar"][hit]
        u, v = found["u"][hit, None], found["v"][hit, None]
        corners = self.normals[faces]
        normals = unit((1 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2])
        return Hits(pixels[hit], depth, starts[hit] + depth[:, None] * ray, normals, faces)

    def open_toward(self, points: Floats, direction: Floats) -> NDArray[np.bool_]:
        """Whether nothing of it lies between points (n, 3) and a light far away in one direction (3,)."""
        free: NDArray[np.bool_] = (
            self.rays.run(points, np.broadcast_to(direction, points.shape).copy(), query="OCCLUDED") < 0
        )
        return free


def corner_normals(mesh: Mesh) -> Floats:
    """The normal at each corner (f, 3, 3): the mean over the faces around it that are no crease away."""
    crosses, flat = mesh.crosses, mesh.normals
    vertex, face = mesh.faces.ravel(), np.repeat(np.arange(len(mesh.faces)), 3)
    order = np.argsort(vertex, kind="stable")
    first, around = np.searchsorted(vertex[order], vertex), np.bincount(vertex)[vertex]
    corner = np.repeat(np.arange(len(vertex)), around)
    turn = np.arange(len(corner)) - np.repeat(np.cumsum(around) - around, around)
    other = face[order[first[corner] + turn]]
    smooth = np.einsum("ij,ij->i", flat[face[corner]], flat[other]) > CREASE
    sums = [np.bincount(corner[smooth], crosses[other[smooth], k], len(vertex)) for k in range(3)]
    return unit(np.stack(sums, axis=1)).reshape(-1, 3, 3)


def unit(vectors: NDArray[np.floating]) -> Floats:
    """Vectors (n, 3) at length 1; zeros stay."""
    lengths = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))[:, None]
    units: Floats = np.divide(vectors, np.where(lengths > 0, lengths, 1)).astype(np.float32)
    return units
