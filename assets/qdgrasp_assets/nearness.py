"""How near two surfaces come to each other: looked at ever more finely, where they may be nearest."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.mesh import Floats

MOST = 200_000
"""With more pieces of triangles it stays open whether surfaces come near each other."""
ENOUGH = 50_000
"""With more pieces no distance is told more accurately."""
FINEST = 1e-6
"""Nor is anything looked for in smaller pieces [m]."""
ACCURACY = 0.3
"""Of a distance that is told, in distances."""
SLACK = 0.1
"""So much farther may be what is taken for the nearest piece then, in distances: it is found sooner."""


def come_within(first: Floats, second: Floats, distance: float) -> bool:
    """Whether two surfaces, of triangles (n, 3, 3) [m] each, come within a distance [m] of each other.

    True also where they are a hair's breadth farther apart over so much surface that it stays open.
    """
    for least, most in _bounds(first, second, MOST, limit=distance):
        if most <= distance:
            return True
        if least > distance:
            return False
    return True


def nearest(first: Floats, second: Floats) -> float:
    """The distance of two surfaces that do not touch [m], or a little more."""
    found = np.inf
    for least, most in _bounds(first, second, ENOUGH, slack=SLACK):
        found = most
        if most - least <= ACCURACY * most:
            break
    return found


def _bounds(
    first: Floats, second: Floats, pieces: int, *, limit: float = np.inf, slack: float = 0.0
) -> Iterator[tuple[float, float]]:
    """What the distance is at least and at most [m], ever closer, until more `pieces` than that are left.

    Surfaces are cut into pieces that are small enough for the next bounds, and those left out that are
    farther from the other surface than the two are from each other, or than `limit`, beyond which distances
    are infinite.
    """
    size = float(max(np.ptp(each.reshape(-1, 3), axis=0).max() for each in (first, second)))
    is_open = True
    while is_open:
        size /= 2
        first, second = _cut(first, size), _cut(second, size)
        middles, error = (first.mean(axis=1), second.mean(axis=1)), _radius(first) + _radius(second)
        far = (1 + slack) * (limit + error)
        there = _away(middles[0], middles[1], slack, far)
        back = _away(middles[1], middles[0], slack, far)
        most = float(min(there.min(), back.min()))
        yield max(0.0, most / (1 + slack) - error), most
        far = (1 + slack) * (min(most, limit) + error)
        first, second = first[there <= far], second[back <= far]
        is_open = len(first) + len(second) <= pieces and size > FINEST


def _away(points: Floats, others: Floats, slack: float, far: float) -> Floats:
    """How far it is from each of some points to the nearest of others: (n,) [m], infinite beyond `far`."""
    from scipy.spatial import KDTree

    away: Floats = np.asarray(KDTree(others).query(points, eps=slack, distance_upper_bound=far)[0])
    return away


def _radius(pieces: Floats) -> float:
    """How far a point of a piece is from its middle, at most [m]."""
    return float(np.linalg.norm(pieces - pieces.mean(axis=1, keepdims=True), axis=2).max())


def _cut(triangles: Floats, size: float) -> Floats:
    """The same surface (n, 3, 3) in triangles whose edges are no longer than `size`."""
    small = []
    while len(triangles):
        edges = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
        is_small = edges.max(axis=1) <= size
        small.append(triangles[is_small])
        triangles = _halved(triangles[~is_small], edges[~is_small].argmax(axis=1))
    return np.concatenate(small)


def _halved(triangles: Floats, longest: NDArray[np.int64]) -> Floats:
    """Triangles (2 n, 3, 3): each cut in two through the middle of an edge, whose number (n,) is told."""
    rows = np.arange(len(triangles))
    a, b, c = (triangles[rows, (longest + turn) % 3] for turn in range(3))
    middle = (a + b) / 2
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
