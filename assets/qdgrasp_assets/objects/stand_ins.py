"""The table of the stand-ins: how each is built, where it lies, and what it weighs."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from qdgrasp_assets.mesh import Mesh
from qdgrasp_assets.objects.banana import banana
from qdgrasp_assets.objects.bleach_cleanser import bleach_cleanser
from qdgrasp_assets.objects.bowl import bowl
from qdgrasp_assets.objects.chips_can import chips_can
from qdgrasp_assets.objects.mug import mug
from qdgrasp_assets.objects.power_drill import power_drill
from qdgrasp_assets.objects.solids import box, geodesic, placed
from qdgrasp_assets.objects.spatula import spatula
from qdgrasp_assets.scene import Vector
from qdgrasp_assets.target import Target

LICENCE = "Apache-2.0"
Solid = tuple[Mesh, tuple[Mesh, ...]]
"""A surface and the convex parts that enclose the same space."""


@dataclass(frozen=True)
class StandIn:
    """One object, in the frame of the scan of the same name."""

    mass: float
    """Published [kg]."""
    com: Vector
    """Centre of mass [m]: the scan's inertial origin."""
    build: Callable[[], Solid]
    """The solid around its own origin."""
    place: Vector
    """Where that origin lies [m]."""
    turn: float = 0.0
    """Turned about z by this [deg]."""


def _box(x: float, y: float, z: float) -> Callable[[], Solid]:
    def build() -> Solid:
        solid = box((x, y, z))
        return solid, (solid,)

    return build


def _ball(radius: float) -> Callable[[], Solid]:
    """A fine sphere for the surface and a coarse one of the same volume for contacts."""

    def build() -> Solid:
        fine, coarse = geodesic(radius, 8), geodesic(radius, 3)
        scale = (fine.volume / coarse.volume) ** (1 / 3)
        return fine, (Mesh(coarse.vertices * scale, coarse.faces),)

    return build


ORIGIN = (0.0, 0.0, 0.0)
STAND_INS = {
    "banana": StandIn(
        mass=0.066,
        com=(0.008573, -0.002315, 0.017070),
        build=banana,
        place=(0.075, -0.085, 0.0),
    ),
    "bleach_cleanser": StandIn(
        mass=1.131,
        com=(-0.017801, 0.011582, 0.100397),
        build=bleach_cleanser,
        place=ORIGIN,
    ),
    "bowl": StandIn(
        mass=0.147,
        com=(-0.014691, -0.044719, 0.025943),
        build=bowl,
        place=(-0.0148, -0.0437, -0.0005),
        turn=9.0,
    ),
    "chips_can": StandIn(
        mass=0.205,
        com=(-0.006005, 0.011113, 0.122552),
        build=chips_can,
        place=(-0.0060, 0.0111, -0.0019),
    ),
    "cracker_box": StandIn(
        mass=0.411,
        com=(-0.014543, -0.013973, 0.102630),
        build=_box(0.060, 0.160, 0.230),
        place=(-0.014543, -0.013973, 0.102630),
    ),
    "mug": StandIn(
        mass=0.118,
        com=(-0.018190, 0.017067, 0.029618),
        build=mug,
        place=(-0.0207, 0.0174, -0.0005),
        turn=-2.5,
    ),
    "power_drill": StandIn(
        mass=0.895,
        com=(-0.000146, 0.014914, 0.044118),
        build=power_drill,
        place=ORIGIN,
        turn=-57.0,
    ),
    "rubiks_cube": StandIn(
        mass=0.094,
        com=(-0.016184, -0.000449, 0.028548),
        build=_box(0.057, 0.057, 0.057),
        place=(-0.016184, -0.000449, 0.028548),
        turn=27.0,
    ),
    "spatula": StandIn(
        mass=0.0515,
        com=(-0.034109, -0.081907, 0.013496),
        build=spatula,
        place=ORIGIN,
        turn=-13.5,
    ),
    "tennis_ball": StandIn(
        mass=0.058,
        com=(0.008233, -0.044192, 0.032887),
        build=_ball(0.0647 / 2),
        place=(0.008233, -0.044192, 0.032887),
    ),
}
"""Sizes and masses: Calli et al. 2015. Places and turns: measured on the scans."""


def stand_in(name: str) -> Target:
    """Build one of `STAND_INS`; in `released` normals come from its convex parts."""
    entry = STAND_INS[name]
    surface, parts = entry.build()
    turn = np.radians(entry.turn)
    return Target(
        name=name,
        source="built in",
        licence=LICENCE,
        collision_source="own parts",
        mass=entry.mass,
        mesh=placed(surface, turn, entry.place),
        parts=tuple(placed(part, turn, entry.place) for part in parts),
        com_in_mesh=np.array(entry.com),
    )
