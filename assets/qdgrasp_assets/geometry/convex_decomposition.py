"""Convex parts of a mesh, cut at planes where parts fill free space that a finger needs.

A part is the hull of the surface in a convex cell. The one that fills most is cut in two, at the best of some
planes, until few free points are filled; then parts are joined where their common hull fills hardly more.
The work is bounded by the number of parts, and nothing in it is drawn or timed.
"""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import Floats, Mesh
from qdgrasp_assets.geometry.mesh_repair import bodies, simplify_mesh
from qdgrasp_assets.geometry.rotation import dot

MOST_TRIANGLES = 4000  # A denser mesh is simplified before it is cut
MOST_POINTS = 2500  # Of more free points, one in so many is looked at
MOST_PIECES = 128  # Most pieces that a mesh is cut into
MOST_BODIES = 32  # Bodies are pieces to begin with, unless there are more
CONVEX = 0.99  # Share of its hull's volume that a convex body has
CUTS = 5  # Planes across each axis that are tried
LEAST_SIDE = 4e-3  # A piece is not cut across an axis along which it extends less [m]
VOLUME_WEIGHT = 0.3  # Weight of the volume of two halves, beside what they reach into free space
TOUCHING = 1e-3  # Largest distance of the boxes of pieces that are joined [m]
ON_PLANE = 1e-9  # Depth below its planes from which a point is inside a hull [m]
MIXED = np.sqrt([1.0, 2.0, 3.0])  # Weights of coordinates in a number by which equal points are found

Indices = NDArray[np.int64]


FreePoints = tuple[Floats, Floats]
"""Points (n, 3) [m] in free space in front of a surface, and the unit normals (n, 3) of it behind them."""


@dataclass(frozen=True, eq=False)
class Piece:
    """The surface in a convex cell, and its hull."""

    triangles: Floats
    """(t, 3, 3) [m]."""
    corners: Floats
    """(v, 3) [m]: those of its hull."""
    volume: float
    """Of its hull [m3]."""
    filled: Indices
    """(k,): the free points inside its hull."""
    reach: float
    """Sum of the distances [m] that the hull reaches in front of the surface, at these points."""


def cut_parts(mesh: Mesh, points: Floats, normals: Floats, share: float) -> list[Floats]:
    """Return the corners (v, 3) [m] of convex parts that fill few of the free points.

    `points` (n, 3) [m] are free, in front of a surface of unit `normals` (n, 3). The parts fill at most a
    `share` of them, unless `MOST_PIECES` do not suffice, and hold all of the mesh, simplified.
    """
    if len(mesh.faces) > MOST_TRIANGLES:
        mesh = simplify_mesh(mesh, MOST_TRIANGLES)
    step = max(1, len(points) // MOST_POINTS)
    free = points[::step], normals[::step]
    most = int(share * len(free[0]))
    return [piece.corners for piece in _joined(_cut(mesh, free, most), free, most)]


def _cut(mesh: Mesh, free: FreePoints, most: int) -> list[Piece]:
    """Cut a mesh until the pieces fill at most so many free points."""
    labels, everything = bodies(mesh), np.arange(len(free[0]))
    if labels.max() >= MOST_BODIES:
        labels = np.zeros_like(labels)
    pieces: list[Piece] = []
    done: list[Piece] = []
    for body in range(labels.max() + 1):
        solid = Mesh(mesh.vertices, mesh.faces[labels == body])
        if piece := _piece(solid.corners, free, everything):
            (done if solid.volume > CONVEX * piece.volume else pieces).append(piece)
    while pieces and len(pieces) + len(done) < MOST_PIECES and _filled([*pieces, *done]) > most:
        worst = max(pieces, key=lambda piece: len(piece.filled))
        pieces.remove(worst)
        halves = _best_halves(worst, free)
        pieces += halves
        done += [] if halves else [worst]
    return pieces + done


def _filled(pieces: list[Piece]) -> int:
    return len(np.unique(np.concatenate([piece.filled for piece in pieces])))


def _piece(triangles: Floats, free: FreePoints, near: Indices) -> Piece | None:
    """Return a piece of triangles (t, 3, 3), which fills some of the points `near`; None: flat."""
    from scipy.spatial import ConvexHull, QhullError

    vertices = triangles.reshape(-1, 3)
    vertices = vertices[np.unique(dot(vertices, MIXED), return_index=True)[1]]
    try:
        hull = ConvexHull(vertices)
    except (QhullError, ValueError):  # of few or no points
        return None
    corners = vertices[hull.vertices]
    low, high = corners.min(axis=0), corners.max(axis=0)
    points, normals = free
    near = near[((points[near] >= low) & (points[near] <= high)).all(axis=1)]
    heights = points[near] @ hull.equations[:, :3].T + hull.equations[:, 3]
    filled = near[(heights < -ON_PLANE).all(axis=1)]
    ahead = (normals[filled] @ corners.T).max(axis=1) - dot(normals[filled], points[filled])
    return Piece(triangles, corners, float(hull.volume), filled, float(ahead.sum()))


def _best_halves(piece: Piece, free: FreePoints) -> list[Piece]:
    """Return the halves of a piece at the best of the planes; none if one is always flat."""
    found: list[tuple[float, int, list[Piece]]] = []
    for normal, offset in _planes(piece) if len(piece.filled) else ():
        sides = cut_triangles(piece.triangles, normal, offset)
        halves = [half for side in sides if (half := _piece(side, free, piece.filled))]
        if len(halves) == len(sides):
            reach = sum(half.reach for half in halves) / piece.reach
            cost = reach + VOLUME_WEIGHT * sum(half.volume for half in halves) / piece.volume
            found.append((round(cost, 6), len(found), halves))
    return min(found)[2] if found else []


def _planes(piece: Piece) -> Iterator[tuple[Floats, float]]:
    """Yield planes, as a unit normal and an offset [m], at which a piece may be cut.

    At equal distances across the axes of the mesh and the piece's longest directions; at a vertex if one is
    nearer than the next plane, as the faces of a drawing are.
    """
    vertices = piece.triangles.reshape(-1, 3)
    for axis in (*np.eye(3), *_long_axes(piece.corners)):
        heights = dot(vertices, axis)
        even, step = np.linspace(heights.min(), heights.max(), CUTS + 2, retstep=True)
        if step * (CUTS + 1) > LEAST_SIDE:
            away = np.abs(heights[:, None] - even[1:-1])
            nearest = heights[away.argmin(axis=0)]
            yield from (
                (axis, offset) for offset in np.where(away.min(axis=0) < step / 2, nearest, even[1:-1])
            )


def _long_axes(corners: Floats) -> Floats:
    """Return three directions (3, 3) at right angles in which corners (v, 3) extend far."""
    along = corners - corners.mean(axis=0)
    along = along - along[dot(along, along).argmax()]
    first = along[dot(along, along).argmax()]
    first = first / np.sqrt(dot(first, first))
    across = along - dot(along, first)[:, None] * first
    second = across[dot(across, across).argmax()]
    second = second / np.sqrt(dot(second, second))
    return np.array([first, second, np.cross(first, second)])


def cut_triangles(triangles: Floats, normal: Floats, offset: float) -> tuple[Floats, Floats]:
    """Cut triangles (t, 3, 3) at a plane; return those below and above."""
    heights = (dot(triangles, normal) - offset).round(9)  # else triangles in the plane are cut by rounding
    is_below = (heights <= 0.0).all(axis=1)
    is_above = ~is_below & (heights >= 0.0).all(axis=1)
    is_cut = ~(is_below | is_above)
    # of a triangle that is cut, one corner is alone on its side: put it first
    is_up = heights[is_cut] > 0.0
    alone_up = is_up.sum(axis=1) == 1
    order = ((is_up == alone_up[:, None]).argmax(axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(np.take_along_axis(triangles[is_cut], order[:, :, None], axis=1), 1, 0)
    p, q, r = np.take_along_axis(heights[is_cut], order, axis=1).T[:, :, None]
    ab, ac = a + p / (p - q) * (b - a), a + p / (p - r) * (c - a)
    tips = np.stack([a, ab, ac], axis=1)
    rests = np.concatenate([np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)])
    both = np.tile(alone_up, 2)
    return (
        np.concatenate([triangles[is_below], tips[~alone_up], rests[both]]),
        np.concatenate([triangles[is_above], tips[alone_up], rests[~both]]),
    )


def _joined(pieces: list[Piece], free: FreePoints, most: int) -> list[Piece]:
    """Join pieces, those first that then fill least more, while all fill at most so many."""
    left = dict(enumerate(pieces))
    waiting: list[tuple[int, float, int, int, Piece]] = []
    most, everything = max(most, _filled(pieces)), np.arange(len(free[0]))

    def propose(a: int, b: int) -> None:
        pair = left[a], left[b]
        low = np.max([piece.corners.min(axis=0) for piece in pair], axis=0)
        high = np.min([piece.corners.max(axis=0) for piece in pair], axis=0)
        corners = np.concatenate([piece.corners for piece in pair])
        if (low - high <= TOUCHING).all() and (common := _piece(corners[:, None], free, everything)):
            more = len(common.filled) - sum(len(piece.filled) for piece in pair)
            growth = round(common.volume - sum(piece.volume for piece in pair), 12)
            heapq.heappush(waiting, (more, growth, a, b, common))

    for a, b in combinations(left, 2):
        propose(a, b)
    while waiting:
        _, _, a, b, common = heapq.heappop(waiting)
        if a not in left or b not in left:
            continue
        others = [piece for number, piece in left.items() if number not in (a, b)]
        if _filled([*others, common]) > most:
            continue
        new = max(left) + 1
        del left[a], left[b]
        left[new] = common
        for number in list(left)[:-1]:
            propose(number, new)
    return list(left.values())
