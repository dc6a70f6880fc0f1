"""The cover: balls that the surface of an object is within, small ones gathered in large ones.

Of an object with more surface than hands grasp the balls are larger, so that they stay as many.
"""

from dataclasses import dataclass
from math import sqrt
from typing import Self

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats
from qdgrasp_worker.skin import areas
from qdgrasp_worker.solid import Solid

TILE = 1.5e-3
"""How far a tile of the surface reaches from its middle at most [m]."""
SMALL, LARGE = 3e-3, 15e-3
"""The sides of the cells in which tiles, and then small balls, are gathered [m]."""
SURFACE = 0.6
"""The surface that is covered so finely at most, that of a cube of 32 cm [m2]."""


@dataclass(frozen=True)
class Balls:
    """Centres and radii."""

    centres: Floats
    """(n, 3) [m]."""
    radii: Floats
    """(n,) [m]."""


@dataclass(frozen=True)
class Cover:
    """All of the surface is in the small balls, and all of each small ball in one of the large ones."""

    large: Balls
    small: Balls
    """Those of the first large ball first, and so on."""
    counts: NDArray[np.intp]
    """(large,): how many small balls each holds."""

    @classmethod
    def of(cls, solid: Solid) -> Self:
        """The cover of the surfaces of an object's convex parts, CoM frame."""
        triangles, coarse = np.concatenate([hull.triangles for hull in solid.hulls]), coarseness(solid)
        small, _, _ = gathered(tiles(triangles, coarse * TILE), coarse * SMALL)
        large, order, counts = gathered(small, coarse * LARGE)
        return cls(large, Balls(small.centres[order], small.radii[order]), counts)


def coarseness(solid: Solid) -> float:
    """How many times larger tiles and cells are than for a small object: 1 up to `SURFACE`."""
    surface = sum(float(areas(hull).sum()) for hull in solid.hulls)
    return max(1.0, sqrt(surface / SURFACE))


def tiles(triangles: Floats, reach: float) -> Balls:
    """Balls of `reach` [m] at most about the small triangles that triangles (t, 3, 3) are cut into."""
    middles, reaches = [], []
    while len(triangles):
        centres = triangles.mean(axis=1)
        far = np.linalg.norm(triangles - centres[:, None], axis=2).max(axis=1)
        is_small = far <= reach
        middles.append(centres[is_small])
        reaches.append(far[is_small])
        triangles = halved(triangles[~is_small])
    return Balls(np.concatenate(middles), np.concatenate(reaches))


def halved(triangles: Floats) -> Floats:
    """Each triangle (t, 3, 3) cut in two (2 t, 3, 3) through the middle of its longest edge."""
    edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
    which, each = edges.argmax(axis=1), np.arange(len(triangles))
    a, b, c = (triangles[each, (which + i) % 3] for i in range(3))
    middle = (a + b) / 2
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])


def gathered(balls: Balls, side: float) -> tuple[Balls, NDArray[np.intp], NDArray[np.intp]]:
    """A ball around all balls in each cell of `side` [m].

    Besides the m balls: the order (n,) that puts the gathered side by side, and how many they are, (m,).
    """
    points = balls.centres
    cells = np.floor(points / side).astype(np.int64)
    _, which, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(which.reshape(-1), kind="stable")
    starts = np.cumsum(counts) - counts
    centres = np.add.reduceat(points[order], starts, axis=0) / counts[:, None]
    offsets = points[order] - np.repeat(centres, counts, axis=0)
    reaches = np.sqrt((offsets * offsets).sum(axis=1)) + balls.radii[order]
    return Balls(centres, np.maximum.reduceat(reaches, starts)), order, counts
