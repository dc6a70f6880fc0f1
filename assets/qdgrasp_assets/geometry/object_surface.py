"""The surface S_c of a scene's object: points with normals, the nearest, and opposite ones.

Opposite points are where rays leave the mesh, tested in float64 (Möller and Trumbore 1997) by products, sums
and quotients of columns alone, whose bits are the same on every processor: rays of a library in float32 could
take another triangle elsewhere. Only triangles whose surrounding ball a ray comes through are tested.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import Floats, dot, unit
from qdgrasp_assets.scene import Scene

MIN_EXIT_DISTANCE = 1e-4  # m: an exit nearer than this is the surface that the ray starts on
EDGE_TOLERANCE = 1e-9  # distance beyond an edge that still counts, so that no ray passes between triangles
BALL_MARGIN = 1e-6  # m: added to the balls around triangles, more than any rounding error
NEAR_ALLOWED = 4e-3  # m: an exit farther than this from all points of a part that may be touched is none
PAIRS_AT_ONCE = 1 << 20  # pairs of ray and triangle that are looked at at once


def last_exits(
    origins: Floats, directions: Floats, corners: Floats, length: float
) -> tuple[Floats, NDArray[np.intp]]:
    """Distances (n,) [m] and triangles (n,) of the last exits along rays from a mesh.

    The rays go from `origins` (n, 3) [m] in unit `directions` (n, 3); `corners` (t, 3, 3) [m] are the
    triangles of a closed mesh, wound outward. NaN, and any triangle, where there is no exit within `length`.
    """
    rays, triangles = _near_pairs(origins, directions, corners, length)
    found = _exit_distances(origins[rays], directions[rays], corners[triangles])
    is_exit = (found > MIN_EXIT_DISTANCE) & (found <= length)
    rays, triangles, found = rays[is_exit], triangles[is_exit], found[is_exit]
    order = np.lexsort((triangles, -found, rays))
    hit, first = np.unique(rays[order], return_index=True)
    farthest, chosen = np.full(len(origins), np.nan), np.zeros(len(origins), np.intp)
    farthest[hit], chosen[hit] = found[order][first], triangles[order][first]
    return farthest, chosen


def _near_pairs(
    origins: Floats, directions: Floats, corners: Floats, length: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs (p,) of a ray and a triangle through the ball around which it comes."""
    centres = corners.mean(axis=1)
    offsets = corners - centres[:, None]
    radii = np.sqrt(dot(offsets, offsets).max(axis=1)) + BALL_MARGIN
    step, rays, triangles = max(1, PAIRS_AT_ONCE // len(corners)), [], []
    for start in range(0, len(origins), step):
        points, ways = origins[start : start + step], directions[start : start + step]
        along = ways @ centres.T - dot(ways, points)[:, None]
        apart = dot(centres, centres) - 2.0 * points @ centres.T + dot(points, points)[:, None] - along**2
        is_near = (apart <= radii**2) & (along >= -radii) & (along <= length + radii)
        near = np.nonzero(is_near)
        rays.append(near[0] + start)
        triangles.append(near[1])
    return np.concatenate(rays), np.concatenate(triangles)


def _exit_distances(origins: Floats, directions: Floats, corners: Floats) -> Floats:
    """(p,): distance along each ray to its exit by a triangle (p, 3, 3); NaN without one."""
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
        from scipy.spatial import KDTree  # takes its time

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
        if self._scene.regions:
            ends = self.points - np.nan_to_num(distances)[:, None] * self.normals
            distances[self._tree.query(ends)[0] > NEAR_ALLOWED] = np.nan
        first, second, third = np.moveaxis(corners[triangles], 1, 0)
        return OppositePoints(distances, unit(cross(second - first, third - first)))
