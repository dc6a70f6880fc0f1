"""Convex primitives, lofts between outlines and solids of revolution, as meshes in metres."""

from collections.abc import Iterable, Sequence
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import Floats, Mesh

GOLDEN = (1 + 5**0.5) / 2


def placed(mesh: Mesh, turn: float, centre: tuple[float, float, float]) -> Mesh:
    """Turn a mesh about z by `turn` [rad], then shift its origin to `centre` [m]."""
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return Mesh(mesh.vertices @ rotation.T, mesh.faces).moved(centre)


def hull(points: Floats) -> Mesh:
    """Return the convex hull of (n, 3) points, wound outward; only points on it are kept."""
    from scipy.spatial import ConvexHull

    found = ConvexHull(points)
    used, faces = np.unique(found.simplices, return_inverse=True)
    mesh = Mesh(points[used], faces.reshape(-1, 3).astype(np.int64))
    inward = np.einsum("fc,fc->f", mesh.normals, found.equations[:, :3]) < 0
    return Mesh(mesh.vertices, np.where(inward[:, None], mesh.faces[:, ::-1], mesh.faces))


def heights(solid: Mesh, points: Floats) -> Floats:
    """Return the distances (n, f) [m] of points before a convex solid's faces; negative behind."""
    normals = solid.normals
    found: Floats = points @ normals.T - np.einsum("fc,fc->f", normals, solid.corners[:, 0])
    return found


def box(sides: tuple[float, float, float]) -> Mesh:
    """Return a box of these sides [m] around the origin."""
    return hull(np.array(list(product((-0.5, 0.5), repeat=3))) * sides)


def geodesic(radius: float, frequency: int) -> Mesh:
    """Return a sphere of 10 frequency^2 + 2 vertices; of full extents for even frequencies.

    They are the vertices of an icosahedron's edges divided `frequency` times, moved out to the sphere.
    """
    rectangle = np.array([(0.0, a, b * GOLDEN) for a in (-1, 1) for b in (-1, 1)])
    corners = np.concatenate([np.roll(rectangle, shift, axis=1) for shift in range(3)])
    steps = [(i, j, frequency - i - j) for i in range(frequency + 1) for j in range(frequency + 1 - i)]
    points = np.concatenate([np.array(steps) @ corners[face] / frequency for face in hull(corners).faces])
    units = points / np.linalg.norm(points, axis=1, keepdims=True)
    _, first = np.unique(units.round(9), axis=0, return_index=True)
    return hull(units[np.sort(first)] * radius)


OUTLINE_CORNERS = 20  # of a round outline; two of them are a part of 40 vertices


def superellipse(
    centre: Floats, across: Floats, along: Floats, power: float, corners: int = OUTLINE_CORNERS
) -> Floats:
    """Return a superellipse (corners, 3) [m] around `centre`, in the plane of its half axes.

    `centre`, `across` and `along` are (3,) [m]. The power 2 gives an ellipse; the greater, the closer to a
    rectangle. A multiple of four `corners` touches all four ends of the half axes.
    """
    angles = np.arange(corners) * 2 * np.pi / corners
    c, s = np.cos(angles).round(12), np.sin(angles).round(12)
    u, v = (np.sign(x) * np.abs(x) ** (2 / power) for x in (c, s))
    return centre + u[:, None] * across + v[:, None] * along


def stack(rows: Iterable[Sequence[float]]) -> list[Floats]:
    """Return level outlines from rows: z, centre x and y, half sides in x and y [m], power."""
    x_axis, y_axis = np.eye(3)[:2]
    return [superellipse(np.array([x, y, z]), a * x_axis, b * y_axis, power) for z, x, y, a, b, power in rows]


def loft(outlines: Sequence[Floats]) -> tuple[Mesh, tuple[Mesh, ...]]:
    """Return surface and parts: hulls of neighbouring outlines, and their outer faces.

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


Faces = NDArray[np.int64]


def revolve(profile: Floats, sides: int) -> Floats:
    """Return the profile at each corner (p, sides, 3) [m]; facet k is from corner k to k + 1.

    `profile` is (p, 2) [m]: radius and height. Facet 0 faces x.
    """
    angles = (np.arange(sides) - 0.5) * 2 * np.pi / sides
    radius, height = profile.T[:, :, None]
    return np.stack(
        [radius * np.cos(angles), radius * np.sin(angles), np.broadcast_to(height, (len(profile), sides))],
        axis=-1,
    )


def disc(profile: Floats, sides: int) -> Mesh:
    """Return the convex part that a profile encloses with the axis."""
    return hull(revolve(profile, sides).reshape(-1, 3))


def ring(cut: Floats, sides: int) -> list[Mesh]:
    """Return a convex part for each facet of a ring of cross-section (n, 2): radius, height."""
    corners = revolve(cut, sides)
    return [hull(np.concatenate([corners[:, side - 1], corners[:, side]])) for side in range(sides)]


def cup(profile: Floats, sides: int) -> Mesh:
    """Return the closed surface of a profile from the outer bottom to the inner floor."""
    corners = revolve(profile, sides).reshape(-1, 3)
    centres = np.array([(0.0, 0.0, profile[0, 1]), (0.0, 0.0, profile[-1, 1])])
    rings = np.arange(len(corners)).reshape(-1, sides)
    below, above = len(corners), len(corners) + 1
    faces = [fan(below, rings[0][::-1]), strip(rings), fan(above, rings[-1])]
    return Mesh(np.concatenate([corners, centres]), np.concatenate(faces))


def fan(centre: int, ring: Faces) -> Faces:
    """Return triangles from a centre to neighbours of a vertex ring (s,), counter-clockwise."""
    return np.stack([np.full(len(ring), centre), ring, np.roll(ring, -1)], axis=1)


def strip(rings: Faces) -> Faces:
    """Return two triangles for each quadrilateral between rings (r, s) of vertices."""
    here, there = rings[:-1], rings[1:]
    right, far = np.roll(here, -1, axis=1), np.roll(there, -1, axis=1)
    quads = np.stack([here, right, far, here, far, there], axis=-1)
    return quads.reshape(-1, 3)
