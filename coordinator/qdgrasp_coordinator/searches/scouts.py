"""Scouts: aims without a success to learn from, for a first one, and for some in places far from others.

A scout aims as the prior `approach` would at a box: at a cell before one of its faces, at most 45 degrees
aside, and near it, where hands hold. It knows the object's box and the hand's distances, from its space, and
leaves the surface to the worker.
"""

import numpy as np

from qdgrasp_assets.genes import NU_A
from qdgrasp_assets.rotation import Floats, tangents, turned
from qdgrasp_coordinator.searches.aims import CONTACT, OWN, TARGET, Aims
from qdgrasp_coordinator.searches.space import Space

NEAR = 0.5
"""The nearer share of the hand's distances: farther off hardly anything is held, by any hand."""
TIGHTEST = 0.3
"""The least looseness, as a share of the greatest."""


def scouts(space: Space, n: int, astray: float, loosest: float, generator: np.random.Generator) -> Aims:
    """`n` scouts.

    Parameters
    ----------
    astray
        The share of them that aim anywhere in the archive's box, at any point: for objects that are unlike
        their boxes.
    loosest
        The greatest looseness of the others. Many candidates make up for a box that is not the surface; a
        single one had better keep to its aim.
    """
    low, high = (corner[CONTACT] for corner in space.layout.intervals)
    bottom, top = (corner[TARGET] for corner in space.layout.intervals)
    nearest, farthest = space.distances
    contacts, outward = _on_faces(low, high, n, generator)
    distances = nearest + NEAR * (farthest - nearest) * generator.random(n)
    targets = contacts + distances[:, None] * _leaning(outward, generator)
    looseness = loosest * generator.uniform(TIGHTEST, 1.0, n)
    anywhere = generator.uniform(bottom, top, (n, 3))
    is_astray = generator.random(n) < astray
    return Aims(
        np.where(is_astray[:, None], anywhere, targets),
        contacts,
        generator.uniform(0.0, 2 * np.pi, n),
        np.where(is_astray, 1.0, looseness),
        generator.uniform(-1.0, 1.0, (n, space.genes - OWN)),
    )


def _on_faces(low: Floats, high: Floats, n: int, generator: np.random.Generator) -> tuple[Floats, Floats]:
    """Points (n, 3) uniform on the surface of a box, and its normals there."""
    size = high - low
    areas = np.roll(size, 1) * np.roll(size, 2)
    axes = generator.choice(3, n, p=areas / areas.sum())
    is_high = generator.random(n) < 0.5
    points = generator.uniform(low, high, (n, 3))
    rows = np.arange(n)
    points[rows, axes] = np.where(is_high, high[axes], low[axes])
    normals = np.zeros((n, 3))
    normals[rows, axes] = np.where(is_high, 1.0, -1.0)
    return points, normals


def _leaning(normals: Floats, generator: np.random.Generator) -> Floats:
    """Directions (n, 3) at most 45 degrees from `normals`, as the prior `approach` draws them."""
    n = len(normals)
    nu, xi = generator.uniform(0.0, NU_A, n), generator.uniform(0.0, 2 * np.pi, n)
    aside, _ = turned(*tangents(normals), xi)
    leaning: Floats = np.cos(nu)[:, None] * normals + np.sin(nu)[:, None] * aside
    return leaning
