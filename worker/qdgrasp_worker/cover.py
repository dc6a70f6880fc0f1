"""The cover: balls that the surface of an object is within, small ones gathered in large ones."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats
from qdgrasp_worker.solid import Solid

TILE = 1.5e-3
"""How far a tile of the surface reaches from its middle at most [m]."""
SMALL, LARGE = 3e-3, 15e-3
"""The sides of the cells in which tiles, and then small balls, are gathered [m]."""


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
        small, _, _ = gathered(tiles(np.concatenate([hull.triangles for hull in solid.hulls])), SMALL)
        large, order, counts = gathered(small, LARGE)
        return cls(large, Balls(small.centres[order], small.radii[order]), counts)


def tiles(triangles: Floats) -> Balls:
    """Balls about the small triangles that triangles (t, 3, 3) are cut into."""
    middles, reaches = [], []
    while len(triangles):
        centres = triangles.mean(axis=1)
        far = np.linalg.norm(triangles - centres[:, None], axis=2).max(axis=1)
        is_small = far <= TILE
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
