"""Convex hulls as half-spaces, and voxel grids that they are marked in.

A voxel grid is a box of small cubes, each with a level, looked up for many points at once.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import Floats, Mesh

PLANE_DECIMALS = 9  # Decimals in which two half-spaces agree that are one: triangles of the same face


@dataclass(frozen=True)
class Hull:
    """The points x with normal . x + offset <= 0 for every plane."""

    surface: Mesh
    """Its triangles; the vertices are all points that it is the hull of."""
    planes: Floats
    """(p, 4): outward unit normal, and offset [m]."""
    low: Floats
    """(3,) [m]: the low corner of its box."""
    high: Floats

    @property
    def normals(self) -> Floats:
        """(p, 3): the outward unit normals of its planes."""
        return self.planes[:, :3]

    @cached_property
    def ends(self) -> Floats:
        """(e, 3) [m]: the corners of its triangles; the other points lie within it."""
        return np.asarray(self.surface.vertices[np.unique(self.surface.faces)])

    def grown(self, by: float) -> Self:
        """The hull with its planes moved outward by `by` [m]."""
        planes = self.planes - np.array([0.0, 0.0, 0.0, by])
        return replace(self, planes=planes, low=self.low - by, high=self.high + by)

    def moved(self, frame: Floats) -> "Hull":
        """The hull in the frame that `frame` (4, 4) comes from."""
        rotation, shift = frame[:3, :3], frame[:3, 3]
        normals = self.normals @ rotation.T
        surface = replace(self.surface, vertices=self.surface.vertices @ rotation.T + shift)
        return Hull(surface, np.column_stack([normals, self.planes[:, 3] - normals @ shift]), *surface.bounds)


def convex_hulls(parts: Iterable[Floats]) -> list[Hull]:
    """The hulls of the corners (v, 3) [m] of each part; flat ones hold nothing and are left out."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import, and few commands need it

    found = []
    for corners in parts:
        try:
            hull = ConvexHull(corners)
        except (QhullError, ValueError):
            continue
        _, first = np.unique(hull.equations.round(PLANE_DECIMALS), axis=0, return_index=True)
        planes = hull.equations[np.sort(first)]
        surface = Mesh(corners, hull.simplices.astype(np.int64))
        found.append(Hull(surface, planes, *surface.bounds))
    return found


Singles = NDArray[np.float32]
Kind = np.uint8 | np.uint16

RIM = 1  # Cubes around the box that nothing is marked in: points outside are looked up in them
UPRIGHT_NORMAL = 1e-9  # The z of a normal below which a plane is taken for upright


class VoxelGrid:
    """Levels from 0, of cubes of side `pitch` [m] in a box from `low` (3,) to `high` (3,) [m]."""

    def __init__(self, low: Floats, high: Floats, pitch: float, kind: type[Kind] = np.uint8) -> None:
        self.pitch = pitch
        self._low = low - RIM * pitch
        counts = np.ceil((high - low) / pitch).astype(np.int64) + 2 * RIM
        self.levels: NDArray[Kind] = np.zeros(counts, dtype=kind)
        self._origin = self._low.astype(np.float32)
        self._last = (counts - 1).astype(np.float32)

    def mark(self, hull: Hull, level: int) -> None:
        """Raise all cubes whose centre is in `hull` to `level` at least.

        A convex body meets a column of cubes in one interval, so that planes are compared by columns.
        """
        first = np.floor((hull.low - self._low) / self.pitch).astype(np.int64).clip(RIM)
        last = np.ceil((hull.high - self._low) / self.pitch).astype(np.int64)
        last = np.minimum(last, np.array(self.levels.shape) - RIM)
        if (last <= first).any():
            return
        x, y, z = (self._low[i] + (np.arange(first[i], last[i]) + 0.5) * self.pitch for i in range(3))
        bottom, top = column_interval(hull.planes, x[:, None], y[None, :])
        inside = (z >= bottom[..., None]) & (z <= top[..., None])
        region = self.levels[first[0] : last[0], first[1] : last[1], first[2] : last[2]]
        np.maximum(region, inside * self.levels.dtype.type(level), out=region)

    def at(self, x: Singles, y: Singles, z: Singles) -> NDArray[Kind]:
        """The levels at points (...) [m]; outside the box that of the rim, 0 unless it was raised."""
        flat = np.zeros(x.shape, dtype=np.int32)
        for axis, values in enumerate((x, y, z)):
            place = (values - self._origin[axis]) * np.float32(1.0 / self.pitch)
            flat *= np.int32(self.levels.shape[axis])
            flat += np.clip(place, np.float32(0.0), self._last[axis]).astype(np.int32)
        return np.asarray(self.levels.ravel()[flat])


SOLID_PITCH = 1e-3  # The side of a voxel of a solid [m]; larger for one of more than `MOST_SOLID_VOXELS`
MOST_SOLID_VOXELS = 1 << 24
SAFE_DEPTH = 1e-4  # Least depth of a voxel within a part [m]. Bullet's hulls are larger than ours by 1 mm.


def box_around(hulls: Sequence[Hull]) -> tuple[Floats, Floats]:
    """The corners (3,) of the box around hulls and the origin [m]."""
    origin = np.zeros((1, 3))
    lows, highs = [hull.low for hull in hulls], [hull.high for hull in hulls]
    return np.min([*lows, *origin], axis=0), np.max([*highs, *origin], axis=0)


def solid_voxels(hulls: Sequence[Hull], low: Floats, high: Floats) -> VoxelGrid:
    """Voxels of a box, of level 1 where the whole voxel is surely inside one of the hulls."""
    pitch = max(SOLID_PITCH, float(np.prod(high - low) / MOST_SOLID_VOXELS) ** (1 / 3))
    voxels = VoxelGrid(low, high, pitch)
    for hull in hulls:
        reach = np.abs(hull.normals).sum(axis=1) * (pitch / 2)
        planes = np.column_stack([hull.normals, hull.planes[:, 3] + (reach + SAFE_DEPTH)])
        voxels.mark(replace(hull, planes=planes), 1)  # each plane moved inward
    return voxels


def column_interval(planes: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Heights (a, b) [m] at which columns at `x` (a, 1) and `y` (1, b) enter and leave a hull.

    For a column that misses it, the leaving height is below the entering one.
    """
    slopes = planes[:, 2]
    a, b, c, offsets = (column[:, None, None] for column in planes.T)
    heights = a * x + b * y + offsets
    up, down = slopes > UPRIGHT_NORMAL, slopes < -UPRIGHT_NORMAL
    top: Floats = np.min(heights[up] / -c[up], axis=0, initial=np.inf)
    bottom: Floats = np.max(heights[down] / -c[down], axis=0, initial=-np.inf)
    bottom[(heights[~(up | down)] > 0.0).any(axis=0)] = np.inf
    return bottom, top


def rotation_matrices(quaternions: NDArray[np.float32]) -> Singles:
    """The rotation matrices (n, 3, 3) of unit quaternions (n, 4)."""
    x, y, z, w = quaternions.astype(np.float64).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows, dtype=np.float32), -1, 0)


def transform_points(
    points: Singles, rotations: Singles, positions: Singles
) -> tuple[Singles, Singles, Singles]:
    """x, y and z (n, p) of points (n or 1, p, 3), turned by (n, 3, 3) and moved by (n, 3).

    Computed in products and sums of single numbers, whose bits do not depend on how many poses there are.
    """
    x, y, z = (points[:, :, axis] for axis in range(3))
    rows = [
        rotations[:, i, 0, None] * x + rotations[:, i, 1, None] * y + rotations[:, i, 2, None] * z
        for i in range(3)
    ]
    return rows[0] + positions[:, 0, None], rows[1] + positions[:, 1, None], rows[2] + positions[:, 2, None]
