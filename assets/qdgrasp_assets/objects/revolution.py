"""Solids of revolution about z: a profile turned around, with flat facets between its corners."""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.mesh import Floats, Mesh
from qdgrasp_assets.objects.solids import hull

Faces = NDArray[np.int64]


def revolved(profile: Floats, sides: int) -> Floats:
    """(p, sides, 3) [m]: the profile at the corners; facet k lies between corners k and k + 1.

    `profile` is (p, 2) [m]: radius and height. Facet 0 faces x.
    """
    angles = (np.arange(sides) - 0.5) * 2 * np.pi / sides
    radius, height = profile.T[:, :, None]
    return np.stack(
        [radius * np.cos(angles), radius * np.sin(angles), np.broadcast_to(height, (len(profile), sides))],
        axis=-1,
    )


def disc(profile: Floats, sides: int) -> Mesh:
    """The convex part that a profile encloses with the axis."""
    return hull(revolved(profile, sides).reshape(-1, 3))


def ring(cut: Floats, sides: int) -> list[Mesh]:
    """One convex part for each facet of the ring with this convex cross-section, (n, 2) radius and height."""
    corners = revolved(cut, sides)
    return [hull(np.concatenate([corners[:, side - 1], corners[:, side]])) for side in range(sides)]


def cup(profile: Floats, sides: int) -> Mesh:
    """The closed surface of a profile that begins at the bottom, outside, and ends at the floor, inside."""
    corners = revolved(profile, sides).reshape(-1, 3)
    centres = np.array([(0.0, 0.0, profile[0, 1]), (0.0, 0.0, profile[-1, 1])])
    rings = np.arange(len(corners)).reshape(-1, sides)
    below, above = len(corners), len(corners) + 1
    faces = [fan(below, rings[0][::-1]), strip(rings), fan(above, rings[-1])]
    return Mesh(np.concatenate([corners, centres]), np.concatenate(faces))


def fan(centre: int, ring: Faces) -> Faces:
    """Triangles between a centre and each two neighbours of a ring (s,) of vertices, counter-clockwise."""
    return np.stack([np.full(len(ring), centre), ring, np.roll(ring, -1)], axis=1)


def strip(rings: Faces) -> Faces:
    """Two triangles for each quadrilateral between rings (r, s) of vertices."""
    here, there = rings[:-1], rings[1:]
    right, far = np.roll(here, -1, axis=1), np.roll(there, -1, axis=1)
    quads = np.stack([here, right, far, here, far, there], axis=-1)
    return quads.reshape(-1, 3)
