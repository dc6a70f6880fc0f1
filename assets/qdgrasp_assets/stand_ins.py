"""Stand-ins: ten built-in objects in place of YCB scans, with meshes in `objects`.

Each lies in the frame of the scanned mesh of the same name and has its centre of mass (the inertial origin
of the reference data), so that the same pose means the same grasp. Masses are those published with the YCB
set (Calli et al. 2015, table of object properties), and so are sizes where that table has them along the
axes: the scans differ from them by a few millimetres, the scanned cracker box by 17 mm in height. Banana,
bleach cleanser, drill and spatula have the outlines of the scans; thin walls are thickened to what a
simulator holds apart. Surface and convex parts enclose the same space.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from qdgrasp_assets.geometry.mesh import read_parts
from qdgrasp_assets.object_model import ObjectModel
from qdgrasp_assets.scene import Vector

LICENCE = "Apache-2.0"
MESHES = Path(__file__).parent / "objects"
"""OBJ files in metres; the first group is the surface, each other one a convex part."""


@dataclass(frozen=True)
class StandIn:
    """One object, in the frame of the scan of the same name."""

    mass: float
    """Published mass [kg]."""
    com: Vector
    """Centre of mass [m]: the scan's inertial origin."""


STAND_INS = {
    "banana": StandIn(0.066, (0.008573, -0.002315, 0.017070)),
    "bleach_cleanser": StandIn(1.131, (-0.017801, 0.011582, 0.100397)),
    "bowl": StandIn(0.147, (-0.014691, -0.044719, 0.025943)),
    "chips_can": StandIn(0.205, (-0.006005, 0.011113, 0.122552)),
    "cracker_box": StandIn(0.411, (-0.014543, -0.013973, 0.102630)),
    "mug": StandIn(0.118, (-0.018190, 0.017067, 0.029618)),
    "power_drill": StandIn(0.895, (-0.000146, 0.014914, 0.044118)),
    "rubiks_cube": StandIn(0.094, (-0.016184, -0.000449, 0.028548)),
    "spatula": StandIn(0.0515, (-0.034109, -0.081907, 0.013496)),
    "tennis_ball": StandIn(0.058, (0.008233, -0.044192, 0.032887)),
}


def stand_in(name: str) -> ObjectModel:
    """Read one of `STAND_INS`; in `released` normals come from its convex parts."""
    entry = STAND_INS[name]
    surface, *parts = read_parts(MESHES / f"{name}.obj")
    return ObjectModel(
        name=name,
        source="built in",
        licence=LICENCE,
        collision_source="own parts",
        mass=entry.mass,
        mesh=surface,
        parts=tuple(parts),
        com_in_mesh=np.array(entry.com),
    )
