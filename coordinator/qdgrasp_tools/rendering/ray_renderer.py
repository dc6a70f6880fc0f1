"""Renders triangle meshes by casting rays: parallel camera, soft light, image layers.

The light is a sky of distant lamps, brighter over the viewer's left shoulder. Solid layers hide those
behind them, translucent ones do not.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import Mesh

Floats = NDArray[np.float32]
PixelIndices = NDArray[np.intp]

CREASE_COSINE = np.cos(np.radians(38.0))
"""Faces that meet at a sharper angle keep their edge; others are seen as one smooth surface."""
LIFT = 1e-4  # How far above a surface rays leave it, so that they do not meet it again [m]
FAR = 4.0  # The eye's distance: beyond every scene [m]


@dataclass(frozen=True)
class ParallelCamera:
    """A parallel projection."""

    axes: Floats
    """(3, 3): unit vectors to the right, up, and toward the eye."""
    low: Floats
    """(2,) [m]: the image's lower left corner, to the right and up."""
    step: float
    """Distance of neighbouring points of the image [m]."""
    rows: int
    columns: int

    def project(self, points: NDArray[np.floating]) -> Floats:
        """Return components of points (n, 3) to the right, up and toward the eye [m]."""
        return np.asarray(np.asarray(points, np.float32) @ self.axes.T)

    def window(self, points: NDArray[np.floating]) -> PixelIndices:
        """Return the image points in the rectangle around `points` (n, 3), numbered row by row."""
        flat = (self.project(points)[:, :2] - self.low) / self.step
        left, bottom = np.maximum(np.floor(flat.min(axis=0)) - 1, 0).astype(int)
        right, top = np.ceil(flat.max(axis=0)).astype(int) + 1
        rows = np.arange(max(self.rows - top, 0), max(self.rows - bottom, 0))
        columns = np.arange(left, min(right, self.columns))
        return (rows[:, None] * self.columns + columns).ravel()

    def origins(self, pixels: PixelIndices) -> Floats:
        """Return the points at which the rays of image points start: (n, 3) [m]."""
        row, column = np.divmod(pixels.astype(np.int32), np.int32(self.columns))
        eye = np.empty((len(pixels), 3), dtype=np.float32)
        eye[:, 0] = self.low[0] + (column + np.float32(0.5)) * np.float32(self.step)
        eye[:, 1] = self.low[1] + (self.rows - row - np.float32(0.5)) * np.float32(self.step)
        eye[:, 2] = FAR
        return np.asarray(eye @ self.axes)


RAYS_PER_PIXEL = 2  # Rays for each pixel of the final image, along each side
MARGIN = 0.015  # Left free on each side, as a share of the image
FIELD = 0.26  # No image is narrower than this unless it is asked for [m], so that small objects look small


def fit_camera(
    points: NDArray[np.floating],
    azimuth: float,
    elevation: float,
    size: tuple[int, int],
    field: float = FIELD,
) -> ParallelCamera:
    """Return a camera whose image holds all points (n, 3), and is at least `field` [m] wide.

    It stands at `azimuth` about z and `elevation` above it [rad]; `size` is width and height [pixels].
    """
    columns, rows = (RAYS_PER_PIXEL * side for side in size)
    (ca, sa), (ce, se) = ((np.cos(angle), np.sin(angle)) for angle in (azimuth, elevation))
    right, toward = np.array([-sa, ca, 0.0]), np.array([ca * ce, sa * ce, se])
    axes = np.array([right, np.cross(toward, right), toward], dtype=np.float32)
    flat = np.asarray(points, np.float32) @ axes[:2].T
    low, high = flat.min(axis=0), flat.max(axis=0)
    fitted = (high - low) / (np.array([columns, rows]) * (1 - 2 * MARGIN))
    step = float(max(*fitted, field / columns))
    corner = (low + high) / 2 - np.array([columns, rows]) * step / 2
    return ParallelCamera(axes, corner.astype(np.float32), step, rows, columns)


@dataclass(frozen=True)
class RayHits:
    """Points at which rays met a solid first."""

    pixels: PixelIndices
    """(m,): image points whose rays met it."""
    depth: Floats
    """(m,) [m]: distance from the eye's plane."""
    points: Floats
    """(m, 3) [m]."""
    normals: Floats
    """(m, 3), unit."""
    faces: PixelIndices
    """(m,): the triangles."""
    corners: PixelIndices
    """(m, 3): the vertices of these triangles."""
    weights: Floats
    """(m, 3): the weights of those vertices, which add up to the points."""


@dataclass(frozen=True)
class RayMesh:
    """A triangle mesh with embree's scene for casting rays."""

    mesh: Mesh
    normals: Floats = field(init=False)
    """(f, 3, 3): the normal at each corner of each triangle."""
    rays: Any = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "normals", corner_normals(self.mesh))
        scene = rtcore_scene.EmbreeScene()
        TriangleMesh(scene, np.ascontiguousarray(self.mesh.corners, dtype=np.float32))
        object.__setattr__(self, "rays", scene)

    def cast_from(self, camera: ParallelCamera) -> RayHits:
        """Return the hits of the camera's rays on it."""
        pixels = camera.window(self.mesh.vertices)
        starts = camera.origins(pixels)
        ray = -camera.axes[2]
        found = self.rays.run(starts, np.broadcast_to(ray, starts.shape).copy(), output=1)
        hit = np.flatnonzero(found["primID"] >= 0)
        faces, depth = found["primID"][hit].astype(np.intp), found["tfar"][hit]
        u, v = found["u"][hit, None], found["v"][hit, None]
        weights = np.column_stack([1 - u - v, u, v])
        normals = unit_vectors(np.einsum("mk,mkc->mc", weights, self.normals[faces]))
        points = starts[hit] + depth[:, None] * ray
        return RayHits(pixels[hit], depth, points, normals, faces, self.mesh.faces[faces], weights)


def corner_normals(mesh: Mesh) -> Floats:
    """Return the normal at each corner of each triangle: (f, 3, 3).

    It is the mean over the faces around the corner that no crease separates from the triangle.
    """
    crosses, flat = mesh.crosses, mesh.normals
    vertex, face = mesh.faces.ravel(), np.repeat(np.arange(len(mesh.faces)), 3)
    # pair each corner with every face around its vertex, then sum the crosses (normals, weighted by area) of
    # those that are no crease away
    order = np.argsort(vertex, kind="stable")
    first, around = np.searchsorted(vertex[order], vertex), np.bincount(vertex)[vertex]
    corner = np.repeat(np.arange(len(vertex)), around)
    rank = np.arange(len(corner)) - np.repeat(np.cumsum(around) - around, around)
    other = face[order[first[corner] + rank]]
    smooth = np.einsum("ij,ij->i", flat[face[corner]], flat[other]) > CREASE_COSINE
    sums = [np.bincount(corner[smooth], crosses[other[smooth], k], len(vertex)) for k in range(3)]
    return unit_vectors(np.stack(sums, axis=1)).reshape(-1, 3, 3)


def unit_vectors(vectors: NDArray[np.floating]) -> Floats:
    """Scale vectors (n, 3) to length 1; zeros stay."""
    lengths = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))[:, None]
    return np.asarray(np.divide(vectors, np.where(lengths > 0, lengths, 1)).astype(np.float32))


LAMPS = 40  # More make softer shadows; each costs a ray for every point that faces it
SUN = (-0.50, 0.72, 0.50)  # The brightest direction: right, up, toward the eye


def sky_lamps(camera: ParallelCamera) -> tuple[Floats, Floats]:
    """Return directions (n, 3) and brightness (n,) of lamps on a Fibonacci sphere.

    A surface that faces the sun, with nothing above it, receives 1.
    """
    place = np.arange(LAMPS) + 0.5
    height, angle = 1 - 2 * place / LAMPS, place * np.pi * (3 - np.sqrt(5))  # the golden angle
    ring = np.sqrt(1 - height**2)
    lamps = np.stack([ring * np.cos(angle), height, ring * np.sin(angle)], axis=1)
    sun = unit_vectors(np.array([SUN]))[0]
    brightness = 1.0 + 0.5 * height + 5.0 * np.exp(10.0 * (lamps @ sun - 1))
    brightness /= (brightness * np.clip(lamps @ sun, 0, None)).sum()
    return (lamps @ camera.axes).astype(np.float32), brightness.astype(np.float32)


def shadowed_light(hits: RayHits, solid: RayMesh, camera: ParallelCamera) -> Floats:
    """Return the light that arrives at each hit (m,), shadows of `solid` included."""
    light = np.zeros(len(hits.pixels), dtype=np.float32)
    lifted = hits.points + LIFT * hits.normals
    for lamp, brightness in zip(*sky_lamps(camera), strict=True):
        slant = hits.normals @ lamp
        facing = np.flatnonzero(slant > 0)
        rays = np.broadcast_to(lamp, (len(facing), 3)).copy()
        free = solid.rays.run(lifted[facing], rays, query="OCCLUDED") < 0
        light[facing] += brightness * slant[facing] * free
    return light


def soft_light(normals: Floats, camera: ParallelCamera) -> Floats:
    """Return the light on what is translucent, by its normals (m, 3): 0 to 1, facing the sun."""
    sun = unit_vectors(np.array([SUN]))[0] @ camera.axes
    return np.asarray(0.5 + 0.5 * (normals @ sun))


@dataclass
class LayeredImage:
    """The colours seen so far at each point of a camera's image."""

    camera: ParallelCamera
    colour: Floats = field(init=False)
    """(n, 3), white where nothing is."""
    depth: Floats = field(init=False)
    """(n,) [m]: of what is solid."""
    translucent: list[tuple[PixelIndices, Floats, Floats]] = field(default_factory=list)
    """Translucent layers: pixels (m,), depth (m,), colour and opacity (m, 4)."""

    def __post_init__(self) -> None:
        points = self.camera.rows * self.camera.columns
        self.colour = np.ones((points, 3), dtype=np.float32)
        self.depth = np.full(points, 2 * FAR, dtype=np.float32)

    def add_solid(self, hits: RayHits, colour: Floats) -> None:
        """Paint the hits (m,) that nothing solid hides in a colour (m, 3)."""
        free = hits.depth < self.depth[hits.pixels]
        seen = hits.pixels[free]
        self.colour[seen], self.depth[seen] = colour[free], hits.depth[free]

    def add_translucent(self, hits: RayHits, colour: Floats, opacity: Floats) -> None:
        """Lay a translucent layer of colour (m, 3) and opacity (m,) over what is behind it."""
        self.translucent.append(
            (hits.pixels, hits.depth, np.column_stack([colour, opacity]).astype(np.float32))
        )

    def composed(self, ground: float = 1.0) -> Floats:
        """Lay the layers from back to front: an image (rows, columns, 3) in [0, 1].

        `ground` is the brightness of what lies behind everything.
        """
        colour = np.where(self.depth[:, None] < 2 * FAR, self.colour, np.float32(ground))
        for pixels, paint in self._from_back_to_front():
            opacity = paint[:, 3:]
            colour[pixels] = colour[pixels] * (1 - opacity) + paint[:, :3] * opacity
        rows, columns = (n // RAYS_PER_PIXEL for n in (self.camera.rows, self.camera.columns))
        fine = colour.reshape(rows, RAYS_PER_PIXEL, columns, RAYS_PER_PIXEL, 3)
        return np.asarray(np.clip(fine.mean(axis=(1, 3)), 0, 1))

    def _from_back_to_front(self) -> list[tuple[PixelIndices, Floats]]:
        """Return the visible translucent hits, in steps in which no pixel occurs twice."""
        if not self.translucent:
            return []
        pixels, depth, paint = (np.concatenate(parts) for parts in zip(*self.translucent, strict=True))
        # sort by pixel, the farthest first; step k has the hit of rank k of each pixel
        seen = np.flatnonzero(depth < self.depth[pixels])
        order = seen[np.lexsort((-depth[seen], pixels[seen]))]
        pixels, paint = pixels[order], paint[order]
        start = np.flatnonzero(np.r_[True, pixels[1:] != pixels[:-1]])
        rank = np.arange(len(pixels)) - np.repeat(start, np.diff(np.r_[start, len(pixels)]))
        return [(pixels[rank == k], paint[rank == k]) for k in range(int(rank.max(initial=-1)) + 1)]
