"""Stand-ins: ten built-in objects in place of YCB scans, built from convex parts.

Each lies in the frame of the scanned mesh of the same name and has its centre of mass (the inertial origin
of the reference data), so that the same pose means the same grasp. Masses are those published with the YCB
set (Calli et al. 2015, table of object properties), and so are sizes where that table has them along the
axes: the scans differ from them by a few millimetres, the scanned cracker box by 17 mm in height. In metres.

- Banana: round outlines along an arc about an upright axis, those of the scan (the poisson reconstruction),
  which is some millimetres thicker than the published 36 mm.
- Bleach cleanser: a bottle that narrows to a waist, a grip, shoulders and a cap, outlined as the scan.
- Bowl: a floor, a wall in two bends and a rim, hollow; its axis is z, the bottom z = 0.
- Chips can: a cylinder with bevelled edges, one convex part, its bottom z = 0.
- Mug: a cup of revolution with a rim, and a swept handle. Surface and convex parts are built from the same
  polygons, so that they enclose the same space. The surface is one closed mesh without faces inside: the ends
  of the handle are windows in the facet of the cup that they stand on. The cup's axis is z, its bottom z = 0,
  the handle looks along x.
- Power drill: battery, handle and body, one above the other, the chuck along y. Its outlines are those of the
  scan (the poisson reconstruction), in a frame turned about z with the drill; the knobs on top are left out.
- Spatula: handle, neck and bent blade, one behind the other along x. Its outlines are those of the scan, in a
  frame turned about z with the spatula, a blade of 4 mm as the scan's sections show it; the hole in the
  handle's end is left out.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from qdgrasp_assets.geometry.mesh import (
    Faces,
    Floats,
    Mesh,
    box,
    cup,
    disc,
    fan,
    geodesic,
    hull,
    loft,
    placed,
    revolve,
    ring,
    stack,
    strip,
    superellipse,
)
from qdgrasp_assets.object_model import ObjectModel
from qdgrasp_assets.scene import Vector

BANANA_OUTLINES = (
    (77.5, 0.1095, 0.0166, 0.0055, 0.0055),
    (80.0, 0.1091, 0.0166, 0.0112, 0.0112),
    (84.0, 0.1086, 0.0165, 0.0158, 0.0156),
    (91.0, 0.1080, 0.0168, 0.0187, 0.0189),
    (105.0, 0.1087, 0.0164, 0.0205, 0.0212),
    (120.0, 0.1115, 0.0170, 0.0206, 0.0228),
    (135.0, 0.1174, 0.0176, 0.0211, 0.0235),
    (150.0, 0.1236, 0.0169, 0.0210, 0.0227),
    (157.0, 0.1255, 0.0165, 0.0196, 0.0198),
    (163.0, 0.1260, 0.0168, 0.0163, 0.0165),
    (170.0, 0.1246, 0.0180, 0.0092, 0.0104),
    (175.0, 0.1231, 0.0192, 0.0060, 0.0060),
    (179.0, 0.1226, 0.0194, 0.0022, 0.0022),
)
"""Angle about the axis [deg]; distance from it, height, half width and half height [m]."""


def banana() -> tuple[Mesh, tuple[Mesh, ...]]:
    """Return surface and convex parts of the banana around the axis of its arc."""
    up, outlines = np.array([0.0, 0.0, 1.0]), []
    for angle, distance, height, half_width, half_height in BANANA_OUTLINES:
        outward = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0.0])
        centre = distance * outward + height * up
        outlines.append(superellipse(centre, half_width * outward, half_height * up, power=2.0))
    return loft(outlines)


BLEACH_CLEANSER_OUTLINES = (
    (0.000, -0.0235, 0.0117, 0.0465, 0.0300, 3.5),
    (0.004, -0.0235, 0.0117, 0.0490, 0.0325, 3.5),
    (0.016, -0.0225, 0.0117, 0.0490, 0.0325, 3.2),
    (0.050, -0.0195, 0.0117, 0.0475, 0.0312, 3.0),
    (0.100, -0.0170, 0.0117, 0.0465, 0.0283, 3.0),
    (0.130, -0.0150, 0.0117, 0.0446, 0.0265, 3.0),
    (0.160, -0.0128, 0.0117, 0.0409, 0.0244, 3.0),
    (0.168, -0.0112, 0.0117, 0.0388, 0.0245, 2.8),
    (0.178, -0.0095, 0.0117, 0.0360, 0.0268, 2.3),
    (0.190, -0.0072, 0.0116, 0.0354, 0.0266, 2.4),
    (0.198, -0.0080, 0.0115, 0.0350, 0.0261, 2.3),
    (0.210, -0.0126, 0.0115, 0.0352, 0.0251, 2.1),
    (0.220, -0.0105, 0.0115, 0.0283, 0.0235, 2.0),
    (0.229, -0.0126, 0.0115, 0.0150, 0.0150, 2.0),
    (0.2405, -0.0126, 0.0115, 0.0153, 0.0153, 2.0),
    (0.2425, -0.0146, 0.0115, 0.0134, 0.0115, 2.3),
    (0.250, -0.0140, 0.0115, 0.0132, 0.0120, 2.3),
)
"""Height z, centre x and y, half sides in x and y [m], power.

Published: 250 mm high, foot 98 mm x 65 mm.
"""


def bleach_cleanser() -> tuple[Mesh, tuple[Mesh, ...]]:
    """Return surface and convex parts of the bottle, in the frame of the scan."""
    return loft(stack(BLEACH_CLEANSER_OUTLINES))


BOWL_SIDES = 20  # facets around
BOWL_BOTTOM, BOWL_FLOOR = 0.0450, 0.003
# the wall outside, as scanned
BOWL_LOW, BOWL_BEND, BOWL_HIGH = (0.0478, BOWL_FLOOR), (0.0635, 0.021), (0.0740, 0.0495)
BOWL_WALL = 0.0025  # thick; the scanned 1 mm is thickened to what a simulator holds apart
BOWL_RIM, BOWL_RIM_EDGE, BOWL_HEIGHT = 0.0795, 0.0505, 0.053  # published: 159 mm wide, 53 mm high

BOWL_PROFILE = np.array(
    [
        (BOWL_BOTTOM, 0.0),
        BOWL_LOW,
        BOWL_BEND,
        BOWL_HIGH,
        (BOWL_RIM, BOWL_RIM_EDGE),
        (BOWL_RIM, BOWL_HEIGHT),
        (BOWL_HIGH[0] - BOWL_WALL, BOWL_HEIGHT),
        *((radius - BOWL_WALL, height) for radius, height in (BOWL_HIGH, BOWL_BEND, BOWL_LOW)),
    ]
)
"""(10, 2): radius and height, upward outside and downward inside."""
BOWL_RINGS = tuple(BOWL_PROFILE[rows] for rows in ([9, 1, 2, 8], [8, 2, 3, 7], [7, 3, 4, 5, 6]))
"""Convex pieces of the wall's cross-section, (n, 2) radius and height."""


def bowl() -> tuple[Mesh, tuple[Mesh, ...]]:
    """Return surface and convex parts of the bowl."""
    walls = (part for cut in BOWL_RINGS for part in ring(cut, BOWL_SIDES))
    return cup(BOWL_PROFILE, BOWL_SIDES), (disc(BOWL_PROFILE[:2], BOWL_SIDES), *walls)


CAN_RADIUS, CAN_HEIGHT = 0.0375, 0.250  # published: 75 mm wide, 250 mm high
CAN_EDGE, CAN_BEVEL = 0.034, 0.005  # radius of the ends, height of the bevels


def chips_can() -> tuple[Mesh, tuple[Mesh, ...]]:
    """Return surface and convex part of the can, which are the same."""
    rings = (
        (0.0, CAN_EDGE),
        (CAN_BEVEL, CAN_RADIUS),
        (CAN_HEIGHT - CAN_BEVEL, CAN_RADIUS),
        (CAN_HEIGHT, CAN_EDGE),
    )
    return _convex(hull(np.concatenate(stack((z, 0.0, 0.0, radius, radius, 2.0) for z, radius in rings))))


MUG_SIDES = 20  # facets around the cup
MUG_RADIUS, MUG_HEIGHT = 0.040, 0.082  # published: 80 mm wide, 82 mm high
MUG_INNER, MUG_FLOOR = 0.0375, 0.004  # the scanned wall of 1.2 mm is thickened so that a simulator holds it
MUG_BOTTOM = 0.036  # radius under the chamfer
MUG_RIM, MUG_RIM_LOW, MUG_RIM_EDGE = 0.046, 0.077, 0.0795
MUG_WINDOWS = (0.009, 0.022), (0.0595, 0.0725)  # rows of the wall in which the handle ends
MUG_FACET = MUG_RADIUS * np.cos(np.pi / MUG_SIDES)

MUG_PROFILE = np.array(
    [
        (MUG_BOTTOM, 0.0),
        (MUG_RADIUS, MUG_FLOOR),
        *((MUG_RADIUS, z) for window in MUG_WINDOWS for z in window),
        (MUG_RADIUS, MUG_RIM_LOW),
        (MUG_RIM, MUG_RIM_EDGE),
        (MUG_RIM, MUG_HEIGHT),
        (MUG_INNER, MUG_HEIGHT),
        (MUG_INNER, MUG_FLOOR),
    ]
)
"""(9, 2): radius and height of the cup's rings, upward outside and downward inside."""
MUG_LOWER_ROW, MUG_UPPER_ROW = 2, 4  # The rows of `MUG_PROFILE` that hold windows

HANDLE_PATH = np.column_stack(
    [
        (MUG_FACET, 0.0540, 0.0620, 0.0663, 0.0663, 0.0630, 0.0560, MUG_FACET),
        (0.0660, 0.0655, 0.0600, 0.0500, 0.0400, 0.0290, 0.0210, 0.0155),
    ]
)
"""(8, 2): x and z of the handle's centre line, from its upper end to its lower one."""
HANDLE_SECTION = np.column_stack(
    [
        (0.0060, 0.0042, -0.0042, -0.0060, -0.0060, -0.0042, 0.0042, 0.0060),
        (0.0017, 0.0035, 0.0035, 0.0017, -0.0017, -0.0035, -0.0035, -0.0017),
    ]
)
"""(8, 2): the handle's cross-section, y and outward from the centre line, counter-clockwise."""


def mug() -> tuple[Mesh, tuple[Mesh, ...]]:
    """Return surface and convex parts of the mug: floor, wall, rim and handle."""
    floor, handle = disc(MUG_PROFILE[:2], MUG_SIDES), pairwise(_handle_sections())
    handle_parts = (hull(np.concatenate(sections)) for sections in handle)
    return _mug_surface(), (floor, *ring(MUG_WALL, MUG_SIDES), *ring(MUG_BRIM, MUG_SIDES), *handle_parts)


MUG_WALL = np.array(
    [(MUG_INNER, MUG_FLOOR), (MUG_RADIUS, MUG_FLOOR), (MUG_RADIUS, MUG_RIM_LOW), (MUG_INNER, MUG_RIM_LOW)]
)
MUG_BRIM = np.array(
    [
        (MUG_INNER, MUG_RIM_LOW),
        (MUG_RADIUS, MUG_RIM_LOW),
        (MUG_RIM, MUG_RIM_EDGE),
        (MUG_RIM, MUG_HEIGHT),
        (MUG_INNER, MUG_HEIGHT),
    ]
)
"""Convex halves of the cup's cross-section, (n, 2) radius and height."""


def _handle_sections() -> Floats:
    """Return the handle's cross-sections (8, 8, 3), each in the plane between two pieces."""
    along = np.diff(HANDLE_PATH, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    outward = np.stack([-along[:, 1], along[:, 0]], axis=1)
    inner = (outward[:-1] + outward[1:]) / (1 + np.sum(outward[:-1] * outward[1:], axis=1, keepdims=True))
    ends = [[(0.0, 1 / outward[end, 1])] for end in (0, -1)]  # cut off by the facet
    mitres = np.concatenate([ends[0], inner, ends[1]])
    places = HANDLE_PATH[:, None] + HANDLE_SECTION[None, :, 1:] * mitres[:, None]
    across = np.broadcast_to(HANDLE_SECTION[:, 0], places.shape[:2])
    return np.stack([places[..., 0], across, places[..., 1]], axis=-1)


def _mug_surface() -> Mesh:
    rings, sections = revolve(MUG_PROFILE, MUG_SIDES), _handle_sections()
    centres = np.array([(0.0, 0.0, 0.0), (0.0, 0.0, MUG_FLOOR)])
    vertices = np.concatenate([rings.reshape(-1, 3), centres, sections.reshape(-1, 3)])
    corners = np.arange(len(MUG_PROFILE) * MUG_SIDES).reshape(-1, MUG_SIDES)
    below, above = corners.size, corners.size + 1
    tube = corners.size + 2 + np.arange(len(HANDLE_PATH) * len(HANDLE_SECTION)).reshape(len(HANDLE_PATH), -1)
    quads = strip(corners).reshape(len(corners) - 1, MUG_SIDES, 2, 3)
    is_wall = np.ones(quads.shape[:2], dtype=bool)
    windows = []
    for row, hole in ((MUG_LOWER_ROW, tube[-1]), (MUG_UPPER_ROW, tube[0])):
        is_wall[row, 0] = False
        # facet 0 of the row, from +y +z counter-clockwise, seen from outside
        quad = corners[[row + 1, row + 1, row, row], [1, 0, 0, 1]]
        windows.append(_window_facet(vertices, quad, hole))
    wall = quads[is_wall].reshape(-1, 3)
    faces = [fan(below, corners[0][::-1]), wall, *windows, fan(above, corners[-1]), strip(tube)]
    return Mesh(vertices, np.concatenate(faces))


def _window_facet(vertices: Floats, quad: Faces, hole: Faces) -> Faces:
    """Return the facet around the handle's end: one corner of `quad` for two of the hole."""
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


POWER_DRILL_OUTLINES = (
    (-0.0055, -0.0105, 0.0100, 0.0120, 0.0280, 2.2),
    (0.0000, -0.0111, 0.0112, 0.0238, 0.0450, 3.0),
    (0.0060, -0.0117, 0.0112, 0.0284, 0.0515, 3.3),
    (0.0120, -0.0119, 0.0105, 0.0286, 0.0527, 3.5),
    (0.0220, -0.0122, 0.0092, 0.0250, 0.0508, 3.5),
    (0.0310, -0.0120, 0.0065, 0.0195, 0.0450, 2.6),
    (0.0390, -0.0122, -0.0130, 0.0168, 0.0235, 2.1),
    (0.0500, -0.0125, -0.0156, 0.0170, 0.0217, 2.2),
    (0.0800, -0.0126, -0.0126, 0.0192, 0.0244, 2.2),
    (0.1000, -0.0123, -0.0048, 0.0189, 0.0278, 2.0),
    (0.1180, -0.0125, -0.0004, 0.0174, 0.0375, 2.0),
    (0.1300, -0.0126, -0.0035, 0.0171, 0.0543, 2.4),
    (0.1400, -0.0127, 0.0115, 0.0218, 0.0770, 3.0),
    (0.1500, -0.0128, 0.0186, 0.0256, 0.0880, 3.6),
    (0.1600, -0.0130, 0.0203, 0.0270, 0.0899, 3.6),
    (0.1700, -0.0130, 0.0208, 0.0243, 0.0876, 3.0),
    (0.1780, -0.0132, 0.0190, 0.0185, 0.0750, 2.0),
    (0.1840, -0.0140, 0.0170, 0.0080, 0.0420, 2.0),
)
"""Height z, centre across and along the drill, half sides across and along it [m], power."""


def power_drill() -> tuple[Mesh, tuple[Mesh, ...]]:
    """Return surface and convex parts of the drill."""
    return loft(stack(POWER_DRILL_OUTLINES))


SPATULA_OUTLINES = (
    (-0.1645, -0.0836, 0.0163, 0.0030, 0.0025, 2.0),
    (-0.1600, -0.0837, 0.0159, 0.0078, 0.0048, 2.2),
    (-0.1500, -0.0838, 0.0152, 0.0122, 0.0071, 2.3),
    (-0.1340, -0.0842, 0.0142, 0.0146, 0.0091, 2.0),
    (-0.1170, -0.0847, 0.0130, 0.0148, 0.0096, 2.0),
    (-0.0930, -0.0853, 0.0114, 0.0123, 0.0095, 2.0),
    (-0.0700, -0.0860, 0.0108, 0.0109, 0.0083, 2.2),
    (-0.0480, -0.0866, 0.0082, 0.0116, 0.0085, 2.0),
    (-0.0450, -0.0866, 0.0066, 0.0102, 0.0052, 2.4),
    (-0.0233, -0.0871, 0.0092, 0.0089, 0.0045, 3.0),
    (0.0048, -0.0879, 0.0151, 0.0076, 0.0036, 3.0),
    (0.0235, -0.0886, 0.0210, 0.0072, 0.0030, 2.6),
    (0.0370, -0.0890, 0.0274, 0.0092, 0.0029, 2.4),
    (0.0450, -0.0895, 0.0296, 0.0138, 0.0025, 2.4),
    (0.0530, -0.0900, 0.0291, 0.0225, 0.0022, 2.4),
    (0.0640, -0.0900, 0.0259, 0.0345, 0.0021, 2.4),
    (0.0730, -0.0899, 0.0231, 0.0382, 0.0021, 3.0),
    (0.1000, -0.0901, 0.0142, 0.0407, 0.0020, 3.0),
    (0.1266, -0.0908, 0.0053, 0.0417, 0.0022, 3.0),
    (0.1380, -0.0902, 0.0022, 0.0390, 0.0020, 2.4),
    (0.1450, -0.0880, 0.0011, 0.0180, 0.0012, 2.0),
)
"""Place along x, centre y and z, half sides in y and z [m], power."""


def spatula() -> tuple[Mesh, tuple[Mesh, ...]]:
    """Return surface and convex parts of the spatula."""
    _, across, up = np.eye(3)
    return loft(
        [
            superellipse(np.array([x, y, z]), half_width * across, half_height * up, power)
            for x, y, z, half_width, half_height, power in SPATULA_OUTLINES
        ]
    )


LICENCE = "Apache-2.0"
SurfaceAndParts = tuple[Mesh, tuple[Mesh, ...]]  # A surface and the convex parts that enclose the same space


@dataclass(frozen=True)
class StandIn:
    """One object, in the frame of the scan of the same name."""

    mass: float
    """Published mass [kg]."""
    com: Vector
    """Centre of mass [m]: the scan's inertial origin."""
    build: Callable[[], SurfaceAndParts]
    """Builds the solid around its own origin."""
    place: Vector
    """Position of the solid's own origin [m]."""
    turn: float = 0.0
    """Rotation about z [deg]."""


def _convex(solid: Mesh) -> SurfaceAndParts:
    return solid, (solid,)


def _tennis_ball() -> SurfaceAndParts:
    """Return a fine sphere as the surface and a coarse one of the same volume for contacts."""
    fine, coarse = geodesic(0.0647 / 2, 8), geodesic(0.0647 / 2, 3)
    scale = (fine.volume / coarse.volume) ** (1 / 3)
    return fine, (Mesh(coarse.vertices * scale, coarse.faces),)


ORIGIN = (0.0, 0.0, 0.0)
CRACKER_BOX = (-0.014543, -0.013973, 0.102630)
RUBIKS_CUBE = (-0.016184, -0.000449, 0.028548)
TENNIS_BALL = (0.008233, -0.044192, 0.032887)
"""Centres of the convex objects: their origins, and centres of mass."""
STAND_INS = {
    "banana": StandIn(0.066, (0.008573, -0.002315, 0.017070), banana, (0.075, -0.085, 0.0)),
    "bleach_cleanser": StandIn(1.131, (-0.017801, 0.011582, 0.100397), bleach_cleanser, ORIGIN),
    "bowl": StandIn(0.147, (-0.014691, -0.044719, 0.025943), bowl, (-0.0148, -0.0437, -0.0005), turn=9.0),
    "chips_can": StandIn(0.205, (-0.006005, 0.011113, 0.122552), chips_can, (-0.0060, 0.0111, -0.0019)),
    "cracker_box": StandIn(0.411, CRACKER_BOX, lambda: _convex(box((0.060, 0.160, 0.230))), CRACKER_BOX),
    "mug": StandIn(0.118, (-0.018190, 0.017067, 0.029618), mug, (-0.0207, 0.0174, -0.0005), turn=-2.5),
    "power_drill": StandIn(0.895, (-0.000146, 0.014914, 0.044118), power_drill, ORIGIN, turn=-57.0),
    "rubiks_cube": StandIn(0.094, RUBIKS_CUBE, lambda: _convex(box((0.057,) * 3)), RUBIKS_CUBE, turn=27.0),
    "spatula": StandIn(0.0515, (-0.034109, -0.081907, 0.013496), spatula, ORIGIN, turn=-13.5),
    "tennis_ball": StandIn(0.058, TENNIS_BALL, _tennis_ball, TENNIS_BALL),
}
"""Sizes and masses: Calli et al. 2015. Places and turns: measured on the scans."""


def stand_in(name: str) -> ObjectModel:
    """Build one of `STAND_INS`; in `released` normals come from its convex parts."""
    entry = STAND_INS[name]
    surface, parts = entry.build()
    turn = np.radians(entry.turn)
    return ObjectModel(
        name=name,
        source="built in",
        licence=LICENCE,
        collision_source="own parts",
        mass=entry.mass,
        mesh=placed(surface, turn, entry.place),
        parts=tuple(placed(part, turn, entry.place) for part in parts),
        com_in_mesh=np.array(entry.com),
    )
