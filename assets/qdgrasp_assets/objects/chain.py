"""Solids strung along a line: convex outlines in planes, and a convex part between each two of them."""

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np

from qdgrasp_assets.mesh import Floats, Mesh
from qdgrasp_assets.objects.solids import hull

CORNERS = 20  # of a round outline; two of them are a part of 40 vertices


def outline(centre: Floats, across: Floats, along: Floats, power: float, corners: int = CORNERS) -> Floats:
    """(corners, 3) [m]: a superellipse around `centre`, in the plane of its two half axes.

    Parameters
    ----------
    centre, across, along
        (3,) [m].
    power
        2 is an ellipse; the greater, the closer to a rectangle.
    corners
        How many corners; a multiple of four touches all four ends of the half axes.
    """
    angles = np.arange(corners) * 2 * np.pi / corners
    c, s = np.cos(angles).round(12), np.sin(angles).round(12)
    u, v = (np.sign(x) * np.abs(x) ** (2 / power) for x in (c, s))
    points: Floats = centre + u[:, None] * across + v[:, None] * along
    return points


def stack(rows: Iterable[Sequence[float]]) -> list[Floats]:
    """Outlines one above the other.

    Each row: height z, centre x and y, half sides in x and y [m], power.
    """
    x_axis, y_axis = np.eye(3)[:2]
    return [outline(np.array([x, y, z]), a * x_axis, b * y_axis, power) for z, x, y, a, b, power in rows]


def chain(outlines: Sequence[Floats]) -> tuple[Mesh, tuple[Mesh, ...]]:
    """Surface and parts: the hull of each two neighbouring outlines, and those faces that are outside.

    Every outline is convex and flat, and the outlines before and after it lie on different sides of its
    plane. So it is a face of both hulls that end there, and the other faces close up around it.
    """
    parts = tuple(hull(np.concatenate(pair)) for pair in pairwise(outlines))
    firsts = np.cumsum([0, *(len(points) for points in outlines)])
    faces = []
    for number, (part, first, second) in enumerate(zip(parts, firsts, firsts[1:], strict=False)):
        size = second - first
        among_first = (part.faces < size).sum(axis=1)
        shown = (among_first % 3 > 0) | (number == 0) & (among_first == 3)
        shown |= (number == len(parts) - 1) & (among_first == 0)
        faces.append(part.faces[shown] + first)
    return Mesh(np.concatenate(list(outlines)), np.concatenate(faces)), parts
