"""The stand-in of the bowl: a floor, a wall in two bends and a rim, hollow.

Lengths in metres; the axis is z, the bottom z = 0.
"""

import numpy as np

from qdgrasp_assets.mesh import Mesh
from qdgrasp_assets.objects.revolution import cup, disc, ring

SIDES = 20  # facets around
BOTTOM, FLOOR = 0.0450, 0.003
LOW, BEND, HIGH = (0.0478, FLOOR), (0.0635, 0.021), (0.0740, 0.0495)  # the wall outside, as scanned
WALL = 0.0025  # thick; the scanned 1 mm is thickened to what a simulator holds apart
RIM, RIM_EDGE, HEIGHT = 0.0795, 0.0505, 0.053  # published: 159 mm wide, 53 mm high


def _inside(place: tuple[float, float]) -> tuple[float, float]:
    return place[0] - WALL, place[1]


PROFILE = np.array(
    [
        (BOTTOM, 0.0),
        LOW,
        BEND,
        HIGH,
        (RIM, RIM_EDGE),
        (RIM, HEIGHT),
        (HIGH[0] - WALL, HEIGHT),
        _inside(HIGH),
        _inside(BEND),
        _inside(LOW),
    ]
)
"""(10, 2): radius and height, upward outside and downward inside."""
RINGS = (
    np.array([_inside(LOW), LOW, BEND, _inside(BEND)]),
    np.array([_inside(BEND), BEND, HIGH, _inside(HIGH)]),
    np.array([_inside(HIGH), HIGH, (RIM, RIM_EDGE), (RIM, HEIGHT), (HIGH[0] - WALL, HEIGHT)]),
)
"""Convex pieces of the wall's cross-section, (n, 2) radius and height."""


def bowl() -> tuple[Mesh, tuple[Mesh, ...]]:
    """Surface and convex parts of the bowl."""
    walls = (part for cut in RINGS for part in ring(cut, SIDES))
    return cup(PROFILE, SIDES), (disc(PROFILE[:2], SIDES), *walls)
