"""How deep convex parts are in each other."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
ALIKE = 6
"""Decimals in which two half-spaces agree that are one: triangles of the same face."""


class Solid:
    """The hull of corners (v, 3) [m], as half-spaces normal . x + offset <= 0."""

    def __init__(self, corners: Floats) -> None:
        self.low, self.high = corners.min(axis=0), corners.max(axis=0)
        self.corners = corners
        self.planes = _planes(corners)
        """(p, 4); none for what is flat, which overlaps nothing."""

    def placed(self, frame: Floats) -> "Solid":
        """The same hull where `frame` (4, 4) puts it."""
        moved = object.__new__(Solid)
        moved.corners = self.corners @ frame[:3, :3].T + frame[:3, 3]
        moved.low, moved.high = moved.corners.min(axis=0), moved.corners.max(axis=0)
        normals = self.planes[:, :3] @ frame[:3, :3].T
        moved.planes = np.column_stack([normals, self.planes[:, 3] - normals @ frame[:3, 3]])
        return moved

    def depth(self, other: "Solid") -> float:
        """The diameter of the largest ball that is in both [m]; 0 where they are apart."""
        if (self.low > other.high).any() or (other.low > self.high).any():
            return 0.0
        if not len(self.planes) or not len(other.planes):
            return 0.0
        from scipy.optimize import linprog  # takes a tenth of a second, and most commands look at no hand

        planes = np.concatenate([self.planes, other.planes])
        found = linprog(
            [0.0, 0.0, 0.0, -1.0],
            A_ub=np.column_stack([planes[:, :3], np.ones(len(planes))]),
            b_ub=-planes[:, 3],
            bounds=[(None, None)] * 3 + [(0.0, None)],
            method="highs",
        )
        return float(2 * found.x[3]) if found.x is not None else 0.0


def depth(ours: Iterable[Solid], theirs: Iterable[Solid]) -> float:
    """How deep some parts are in others, at most [m]."""
    theirs = tuple(theirs)
    return max((one.depth(other) for one in ours for other in theirs), default=0.0)


def ray(parts: Iterable[Solid], direction: Floats) -> float | None:
    """How far a ray from the origin along `direction` (3,) goes until it leaves the last of the parts [m].

    None where it meets none.
    """
    exits = [found for part in parts if (found := _exit(part, direction)) is not None]
    return max(exits, default=None)


def _exit(part: Solid, direction: Floats) -> float | None:
    if not len(part.planes):
        return None
    slopes, heights = part.planes[:, :3] @ direction, part.planes[:, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        ways = -heights / slopes
    enters = max(ways[slopes < 0], default=-np.inf)
    leaves = min(ways[slopes > 0], default=np.inf)
    is_beside = bool((heights[slopes == 0] > 0).any())
    return None if is_beside or enters > leaves or leaves < 0 else float(leaves)


def _planes(corners: Floats) -> Floats:
    from scipy.spatial import ConvexHull, QhullError

    try:
        found = ConvexHull(corners).equations
    except (QhullError, ValueError):
        return np.zeros((0, 4))
    _, first = np.unique(found.round(ALIKE), axis=0, return_index=True)
    planes: Floats = found[np.sort(first)]
    return planes
