"""Geometry of the object: surface points as decoding uses them, and the solid of Bullet.

The surface S_c is its points with their normals, the nearest, and the opposite ones. Opposite points are
where rays leave the mesh, tested for every ray and triangle in float64 (Möller and Trumbore 1997) by
products, sums and quotients of columns alone, whose bits are the same on every processor: rays of a library
in float32 could take another triangle elsewhere. The test runs once for each surface point of a scene.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from qdgrasp_assets.geometry.mesh import parse_parts
from qdgrasp_assets.geometry.rotation import Floats, dot, unit
from qdgrasp_assets.geometry.voxels import VoxelGrid, box_around, convex_hulls, solid_voxels
from qdgrasp_assets.scene import Scene

MIN_EXIT_DISTANCE = 1e-4  # m: an exit nearer than this is the surface that the ray starts on
EDGE_TOLERANCE = 1e-9  # distance beyond an edge that still counts, so that no ray passes between triangles
PAIRS_AT_ONCE = 1 << 17  # pairs of ray and triangle that are tested at once: they fit in the cache


def last_exits(
    origins: Floats, directions: Floats, corners: Floats, length: float
) -> tuple[Floats, NDArray[np.intp]]:
    """Distances (n,) [m] and triangles (n,) of the last exits along rays from a mesh.

    The rays go from `origins` (n, 3) [m] in unit `directions` (n, 3); `corners` (t, 3, 3) [m] are the
    triangles of a closed mesh, wound outward. NaN, and any triangle, where there is no exit within `length`.
    """
    rows, distances, triangles = max(1, PAIRS_AT_ONCE // len(corners)), [], []
    for i in range(0, len(origins), rows):
        found = _exit_distances(origins[i : i + rows, None], directions[i : i + rows, None], corners)
        found[~((found > MIN_EXIT_DISTANCE) & (found <= length))] = -np.inf
        triangles.append(found.argmax(axis=1))
        distances.append(found[np.arange(len(found)), triangles[-1]])
    farthest = np.concatenate(distances)
    return np.where(np.isfinite(farthest), farthest, np.nan), np.concatenate(triangles)


def _exit_distances(origins: Floats, directions: Floats, corners: Floats) -> Floats:
    """(n, t): distance along each ray (n, 1, 3) to its exit by each triangle; NaN without one."""
    first, second, third = np.moveaxis(corners, 1, 0)
    one, other = second - first, third - first
    across = cross(directions, other)
    volume = dot(across, one)  # negative where the ray goes with the normal: outward
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = origins - first
        u = dot(offset, across) / volume
        around = cross(offset, one)
        v = dot(directions, around) / volume
        distances = dot(other, around) / volume
        through = (
            (volume < 0) & (u >= -EDGE_TOLERANCE) & (v >= -EDGE_TOLERANCE) & (u + v <= 1 + EDGE_TOLERANCE)
        )
    return np.where(through, distances, np.nan)


def cross(a: Floats, b: Floats) -> Floats:
    """The vector products of vectors (..., 3)."""
    (ax, ay, az), (bx, by, bz) = (np.moveaxis(vectors, -1, 0) for vectors in (a, b))
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


@dataclass(frozen=True)
class OppositePoints:
    """The last surface point straight behind each surface point, within the hand's opening."""

    distances: Floats
    """(n,) [m]; NaN where there is no such point."""
    normals: Floats
    """(n, 3): the outward unit normals there; any where there is no such point."""


class ObjectSurface:
    """The surface points of a scene, CoM frame."""

    def __init__(self, scene: Scene) -> None:
        self.points: Floats = scene.surface_points.astype(np.float64)
        self.normals: Floats = unit(scene.surface_normals.astype(np.float64))
        self._tree = KDTree(self.points)
        self._scene = scene

    def nearest(self, finders: Floats) -> NDArray[np.intp]:
        """The index (n,) of the surface point nearest to each of `finders` (n, 3) [m]."""
        _, indices = self._tree.query(np.nan_to_num(finders))
        return np.asarray(indices, dtype=np.intp)

    @cached_property
    def opposites(self) -> OppositePoints:
        """The points that the hand's jaw would close on with each surface point; none without a jaw."""
        jaw, corners = self._scene.gripper.jaw, self._scene.object.triangles.astype(np.float64)
        opening = 0.0 if jaw is None else jaw.opening
        distances, triangles = last_exits(self.points, -self.normals, corners, opening)
        first, second, third = np.moveaxis(corners[triangles], 1, 0)
        return OppositePoints(distances, unit(cross(second - first, third - first)))


SAMPLE_POINTS = 512  # Surface points of a sample, at most
SAMPLE_UNIT = 1 << 12
"""Steps of a sample's coordinates: whole numbers, whose sums in float32 do not depend on their order."""


class SurfaceSample:
    """Some of an object's surface points, for sums over few of them; CoM frame."""

    def __init__(self, scene: Scene) -> None:
        chosen = np.linspace(0, len(scene.surface_points) - 1, SAMPLE_POINTS).astype(np.intp)
        self.points: NDArray[np.float32] = scene.surface_points[np.unique(chosen)].astype(np.float32)
        normals = unit(scene.surface_normals[np.unique(chosen)].astype(np.float64))
        self._scale = float(np.abs(self.points).max()) or 1.0
        numbers = np.concatenate([self.points / self._scale, normals], axis=1)
        self.encoded: NDArray[np.float32] = np.rint(SAMPLE_UNIT * numbers).astype(np.float32)
        """(p, 6): point and normal of each in whole numbers, at most `SAMPLE_UNIT`."""

    def decoded(self, means: Floats) -> tuple[Floats, Floats]:
        """Points (..., 3) [m] and normals (..., 3) that means (..., 6) of `encoded` stand for."""
        return means[..., :3] * (self._scale / SAMPLE_UNIT), means[..., 3:] / SAMPLE_UNIT


INSIDE_POINTS = 512
DRAWS = 8192
ROUNDS = 64


class ObjectSolid:
    """The convex parts of a scene's object, CoM frame."""

    def __init__(self, scene: Scene) -> None:
        parts = [part.vertices for part in parse_parts(scene.object.collision.decode())]
        self.hulls = convex_hulls(parts)
        self.is_whole = 0 < len(self.hulls) == len(parts)
        """True if all of the object is in them; flat parts are left out."""
        self._surface = scene.surface_points.astype(np.float64)
        self.radius = float(np.sqrt((self._surface**2).sum(axis=1).max()))
        """Largest distance of the surface from the centre of mass [m]."""
        self.sample = SurfaceSample(scene)

    @cached_property
    def inside(self) -> VoxelGrid:
        """Level 1: the whole voxel is surely inside one of the parts."""
        return solid_voxels(self.hulls, *self.box)

    @cached_property
    def points(self) -> Floats:
        """(512, 3) [m]: points drawn uniformly from the inside, or of the surface of a thin object."""
        random = np.random.default_rng(0)
        low, high = self.box
        found = [self._surface[:0]]
        for _ in range(ROUNDS):
            drawn = random.uniform(low, high, (DRAWS, 3))
            found.append(drawn[np.any([hull.contains(drawn) for hull in self.hulls], axis=0)])
            if sum(map(len, found)) >= INSIDE_POINTS:
                break
        some = self._surface[random.integers(len(self._surface), size=INSIDE_POINTS)]
        return np.concatenate([*found, some])[:INSIDE_POINTS]

    @cached_property
    def box(self) -> tuple[Floats, Floats]:
        """The corners (3,) of the box around it and its centre of mass [m]."""
        return box_around(self.hulls)
