"""Convex solids that the stand-ins are made of."""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.mesh import Floats, Mesh

GOLDEN = (1 + 5**0.5) / 2


def placed(mesh: Mesh, turn: float, centre: tuple[float, float, float]) -> Mesh:
    """The mesh turned about z by `turn` [rad], then shifted so that its origin comes to `centre` [m]."""
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return Mesh(mesh.vertices @ rotation.T, mesh.faces).moved(centre)


def hull(points: Floats) -> Mesh:
    """The convex hull of (n, 3) points, wound outward; only points on it are kept."""
    from scipy.spatial import ConvexHull

    found = ConvexHull(points)
    used, faces = np.unique(found.simplices, return_inverse=True)
    mesh = Mesh(points[used], faces.reshape(-1, 3).astype(np.int64))
    inward = np.einsum("fc,fc->f", mesh.normals, found.equations[:, :3]) < 0
    return Mesh(mesh.vertices, np.where(inward[:, None], mesh.faces[:, ::-1], mesh.faces))


def heights(solid: Mesh, points: Floats) -> Floats:
    """How far points (n, 3) are in front of each face of a convex solid (n, f) [m]; negative behind it."""
    normals = solid.normals
    found: Floats = points @ normals.T - np.einsum("fc,fc->f", normals, solid.corners[:, 0])
    return found


def box(sides: tuple[float, float, float]) -> Mesh:
    """A box of these sides [m] around the origin."""
    return hull(np.array(list(product((-0.5, 0.5), repeat=3))) * sides)


def geodesic(radius: float, frequency: int) -> Mesh:
    """A sphere of 10 frequency^2 + 2 vertices around the origin; of full extents for even frequencies."""
    return hull(_directions(frequency) * radius)


def _directions(frequency: int) -> Floats:
    """Unit vectors over a regular icosahedron whose edges are divided `frequency` times."""
    corners = _icosahedron()
    triples = hull(corners).faces
    steps = [(i, j, frequency - i - j) for i in range(frequency + 1) for j in range(frequency + 1 - i)]
    points = np.concatenate([np.array(steps) @ corners[triple] / frequency for triple in triples])
    units = points / np.linalg.norm(points, axis=1, keepdims=True)
    _, first = np.unique(units.round(9), axis=0, return_index=True)
    distinct: Floats = units[np.sort(first)]
    return distinct


def _icosahedron() -> NDArray[np.float64]:
    """(12, 3): (0, +-1, +-golden) and its cyclic permutations."""
    rectangle = np.array([(0.0, a, b * GOLDEN) for a in (-1, 1) for b in (-1, 1)])
    return np.concatenate([np.roll(rectangle, shift, axis=1) for shift in range(3)])
