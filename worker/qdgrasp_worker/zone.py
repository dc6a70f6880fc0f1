"""A zone: voxels that know how far they are, at least, from everything that convex shapes pass through."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product
from math import sqrt
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from qdgrasp_assets.objects.solids import geodesic
from qdgrasp_assets.rotation import Floats
from qdgrasp_worker.convex import Hull
from qdgrasp_worker.voxels import Singles, Voxels

PITCH = 3e-3
"""The side of a voxel [m]; larger for a hand that passes through more than `MOST` voxels."""
MOST = 1 << 22
AROUND = 0.03
"""How far about the shapes distances are known [m]."""
UNIT = 2e-4
"""Distances are kept in whole numbers of it [m]; what is farther than 255 of it is as far."""
STRIDE = 2e-3
"""What a shape moves from one look to the next [m]."""
ROUND = 0.03
"""How far a round shape reaches beyond the hull of its corners, in its radii."""
DIRECTIONS = geodesic(1.0, 3).vertices
CORNERS = np.array(list(product((0.0, 1.0), repeat=3)))


@dataclass(frozen=True)
class Zone:
    """What shapes pass through, in the frame of a link."""

    distances: Voxels
    """In units of `UNIT`, rounded down; beyond the box its rim stands for what is outside."""

    @classmethod
    def of(cls, courses: Iterable[tuple[Hull, Floats]]) -> Self:
        """The zone of hulls, each on its course of frames (n, 4, 4) that follow closely on each other."""
        paths = [(blunt(hull), course, path(hull, course)) for hull, course in courses]
        low = np.min([corners.min(axis=(0, 1)) for *_, corners in paths], axis=0)
        high = np.max([corners.max(axis=(0, 1)) for *_, corners in paths], axis=0)
        low, high = low - AROUND, high + AROUND
        pitch = max(PITCH, float(np.prod(high - low) / MOST) ** (1 / 3))
        diagonal = sqrt(3.0) * pitch
        voxels = Voxels(low, high, pitch)
        for hull, course, corners in paths:
            for look, moved in looks(corners):
                voxels.mark(hull.moved(course[look]).grown(moved + stout(hull) + diagonal / 2), 1)
        away = distance_transform_edt(voxels.levels == 0) * pitch - diagonal
        voxels.levels = np.clip(away / UNIT, 0, 255).astype(np.uint8)
        return cls(voxels)

    def at(self, points: Singles, turn: Singles, move: Singles) -> NDArray[np.uint8]:
        """How far away points (n, 3) are at least, turned by (3, 3) and moved by (3,): (n,)."""
        x, y, z = (points @ turn.T + move).T
        return self.distances.at(x, y, z).astype(np.uint8, copy=False)


def path(hull: Hull, course: Floats) -> Floats:
    """Where the corners of a hull's box are on its course: (n, 8, 3) [m]."""
    corners = hull.low + CORNERS * (hull.high - hull.low)
    places: Floats = corners @ np.moveaxis(course[:, :3, :3], 1, 2) + course[:, None, :3, 3]
    return places


def looks(corners: Floats) -> list[tuple[int, float]]:
    """Frames of a path (n, 8, 3), and how far from them points are in the frames that they stand for [m]."""
    steps = np.linalg.norm(np.diff(corners, axis=0), axis=2).max(axis=1)
    ways = np.concatenate([[0.0], np.cumsum(steps)])
    _, first = np.unique(np.floor(ways / STRIDE), return_index=True)
    last = np.append(first[1:], len(ways)) - 1
    middle = np.searchsorted(ways, (ways[first] + ways[last]) / 2).clip(first, last)
    moved = np.maximum(ways[middle] - ways[first], ways[last] - ways[middle])
    return list(zip(middle.tolist(), moved.tolist(), strict=True))


def blunt(hull: Hull) -> Hull:
    """A hull around a hull that has no more than 92 planes."""
    if len(hull.planes) <= len(DIRECTIONS):
        return hull
    corners = hull.triangles.reshape(-1, 3)
    return replace(hull, planes=np.column_stack([DIRECTIONS, -(corners @ DIRECTIONS.T).max(axis=0)]))


def stout(hull: Hull) -> float:
    """How far a round shape may reach beyond the hull of its corners [m]."""
    return float(ROUND * np.sort(hull.high - hull.low)[1] / 2)
