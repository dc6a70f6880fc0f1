"""The stand-in of the mug: a cup of revolution with a rim, and a swept handle.

Surface and convex parts are built from the same polygons, so that they enclose the same space. The surface
is one closed mesh without faces inside: the ends of the handle are windows in the facet of the cup that they
stand on. Lengths in metres; the cup's axis is z, its bottom z = 0, the handle looks along x.
"""

from itertools import pairwise

import numpy as np

from qdgrasp_assets.mesh import Floats, Mesh
from qdgrasp_assets.objects.revolution import Faces, disc, fan, revolved, ring, strip
from qdgrasp_assets.objects.solids import hull

SIDES = 20  # facets around the cup
RADIUS, HEIGHT = 0.040, 0.082  # published: 80 mm wide, 82 mm high
INNER, FLOOR = 0.0375, 0.004  # the scanned wall of 1.2 mm is thickened to what a simulator holds apart
BOTTOM = 0.036  # radius under the chamfer
RIM, RIM_LOW, RIM_EDGE = 0.046, 0.077, 0.0795
WINDOWS = (0.009, 0.022), (0.0595, 0.0725)  # rows of the wall in which the handle ends
FACET = RADIUS * np.cos(np.pi / SIDES)

PROFILE = np.array(
    [
        (BOTTOM, 0.0),
        (RADIUS, FLOOR),
        *((RADIUS, z) for window in WINDOWS for z in window),
        (RADIUS, RIM_LOW),
        (RIM, RIM_EDGE),
        (RIM, HEIGHT),
        (INNER, HEIGHT),
        (INNER, FLOOR),
    ]
)
"""(9, 2): radius and height of the cup's rings, upward outside and downward inside."""
LOWER_ROW, UPPER_ROW = 2, 4
"""The rows of `PROFILE` that hold windows."""

PATH = np.array(
    [
        (FACET, 0.0660),
        (0.0540, 0.0655),
        (0.0620, 0.0600),
        (0.0663, 0.0500),
        (0.0663, 0.0400),
        (0.0630, 0.0290),
        (0.0560, 0.0210),
        (FACET, 0.0155),
    ]
)
"""(8, 2): x and z of the handle's centre line, from its upper end to its lower one."""
SECTION = np.array(
    [
        (0.0060, 0.0017),
        (0.0042, 0.0035),
        (-0.0042, 0.0035),
        (-0.0060, 0.0017),
        (-0.0060, -0.0017),
        (-0.0042, -0.0035),
        (0.0042, -0.0035),
        (0.0060, -0.0017),
    ]
)
"""(8, 2): the handle's cross-section, y and outward from the centre line, counter-clockwise."""


def mug() -> tuple[Mesh, tuple[Mesh, ...]]:
    """Surface and convex parts of the mug: floor, wall, rim and handle."""
    return _surface(), (disc(PROFILE[:2], SIDES), *ring(WALL, SIDES), *ring(BRIM, SIDES), *_handle())


WALL = np.array([(INNER, FLOOR), (RADIUS, FLOOR), (RADIUS, RIM_LOW), (INNER, RIM_LOW)])
BRIM = np.array([(INNER, RIM_LOW), (RADIUS, RIM_LOW), (RIM, RIM_EDGE), (RIM, HEIGHT), (INNER, HEIGHT)])
"""Convex halves of the cup's cross-section, (n, 2) radius and height."""


def _handle() -> list[Mesh]:
    """One part between each two sections."""
    return [hull(np.concatenate(pair)) for pair in pairwise(_sections())]


def _sections() -> Floats:
    """(8, 8, 3): the handle's cross-section at each point of its path, in the plane between two pieces."""
    along = np.diff(PATH, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    outward = np.stack([-along[:, 1], along[:, 0]], axis=1)
    inner = (outward[:-1] + outward[1:]) / (1 + np.sum(outward[:-1] * outward[1:], axis=1, keepdims=True))
    ends = [[(0.0, 1 / outward[end, 1])] for end in (0, -1)]  # cut off by the facet
    mitres = np.concatenate([ends[0], inner, ends[1]])
    places = PATH[:, None] + SECTION[None, :, 1:] * mitres[:, None]
    across = np.broadcast_to(SECTION[:, 0], places.shape[:2])
    return np.stack([places[..., 0], across, places[..., 1]], axis=-1)


def _surface() -> Mesh:
    rings, sections = revolved(PROFILE, SIDES), _sections()
    centres = np.array([(0.0, 0.0, 0.0), (0.0, 0.0, FLOOR)])
    vertices = np.concatenate([rings.reshape(-1, 3), centres, sections.reshape(-1, 3)])
    corners = np.arange(len(PROFILE) * SIDES).reshape(-1, SIDES)
    below, above = corners.size, corners.size + 1
    tube = corners.size + 2 + np.arange(len(PATH) * len(SECTION)).reshape(len(PATH), -1)
    faces = [
        fan(below, corners[0][::-1]),
        _cup(corners),
        _window(vertices, _quad(corners, LOWER_ROW), tube[-1]),
        _window(vertices, _quad(corners, UPPER_ROW), tube[0]),
        fan(above, corners[-1]),
        strip(tube),
    ]
    return Mesh(vertices, np.concatenate(faces))


def _cup(ring: Faces) -> Faces:
    """The strip of the cup's rings without the two facets that are windows."""
    quads = strip(ring).reshape(len(ring) - 1, SIDES, 2, 3)
    kept = np.ones(quads.shape[:2], dtype=bool)
    kept[[LOWER_ROW, UPPER_ROW], 0] = False
    return quads[kept].reshape(-1, 3)


def _quad(ring: Faces, row: int) -> Faces:
    """Corners of facet 0 in a row: from +y +z counter-clockwise, seen from outside."""
    return np.array([ring[row + 1, 1], ring[row + 1, 0], ring[row, 0], ring[row, 1]])


def _window(vertices: Floats, quad: Faces, hole: Faces) -> Faces:
    """The facet around the handle's end: one corner of `quad` for each two corners of the hole."""
    _, y, z = (vertices[hole] - vertices[hole].mean(axis=0)).T
    hole = hole[np.argsort(np.arctan2(z, y) % (2 * np.pi))]
    first, second = hole[0::2], hole[1::2]
    return np.concatenate(
        [
            np.stack([quad, second, first], axis=1),
            np.stack([np.roll(first, -1), second, quad], axis=1),
            np.stack([np.roll(first, -1), quad, np.roll(quad, -1)], axis=1),
        ]
    )
