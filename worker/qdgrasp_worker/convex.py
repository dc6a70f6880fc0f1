"""Convex hulls as half-spaces, which tell what is inside."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from qdgrasp_assets.rotation import Floats

ALIKE = 9
"""Decimals in which two half-spaces agree that are one: triangles of the same face."""


@dataclass(frozen=True)
class Hull:
    """The points x with normal . x + offset <= 0 for every plane."""

    planes: Floats
    """(p, 4): outward unit normal, and offset [m]."""
    low: Floats
    """(3,) [m]: the low corner of its box."""
    high: Floats
    triangles: Floats
    """(t, 3, 3) [m]: its surface."""

    @property
    def normals(self) -> Floats:
        """(p, 3)."""
        return self.planes[:, :3]

    def grown(self, by: float) -> Self:
        """The hull with its planes moved outward by `by` [m]."""
        planes = self.planes - np.array([0.0, 0.0, 0.0, by])
        return replace(self, planes=planes, low=self.low - by, high=self.high + by)

    def shrunk(self, by: Floats) -> Self:
        """The hull with each of its planes moved inward by `by` (p,) [m]."""
        return replace(self, planes=np.column_stack([self.normals, self.planes[:, 3] + by]))

    def moved(self, frame: Floats) -> Self:
        """The hull in the frame that `frame` (4, 4) comes from."""
        rotation, shift = frame[:3, :3], frame[:3, 3]
        normals = self.normals @ rotation.T
        offsets = self.planes[:, 3] - normals @ shift
        triangles = self.triangles @ rotation.T + shift
        corners = triangles.reshape(-1, 3)
        planes = np.column_stack([normals, offsets])
        return replace(
            self, planes=planes, low=corners.min(axis=0), high=corners.max(axis=0), triangles=triangles
        )

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """Which of the points (n, 3) [m] are inside: (n,)."""
        inside: NDArray[np.bool_] = np.all((points >= self.low) & (points <= self.high), axis=1)
        heights = points[inside] @ self.normals.T + self.planes[:, 3]
        inside[inside] = np.all(heights <= 0.0, axis=1)
        return inside


def hulls(parts: Iterable[Floats]) -> list[Hull]:
    """The hulls of the corners (v, 3) [m] of each part; flat ones hold nothing and are left out."""
    found = []
    for corners in parts:
        try:
            hull = ConvexHull(corners)
        except (QhullError, ValueError):
            continue
        _, first = np.unique(hull.equations.round(ALIKE), axis=0, return_index=True)
        planes = hull.equations[np.sort(first)]
        found.append(Hull(planes, corners.min(axis=0), corners.max(axis=0), corners[hull.simplices]))
    return found
