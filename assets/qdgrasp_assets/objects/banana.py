"""The stand-in of the banana: round outlines along an arc about an upright axis.

Its outlines are those of the scan (the poisson reconstruction), which is some millimetres thicker than the
published 36 mm.
"""

import numpy as np

from qdgrasp_assets.mesh import Floats, Mesh
from qdgrasp_assets.objects.chain import chain, outline

OUTLINES = (
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
    """Surface and convex parts of the banana around the axis of its arc."""
    return chain([_outline(*row) for row in OUTLINES])


def _outline(angle: float, distance: float, height: float, half_width: float, half_height: float) -> Floats:
    outward = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    return outline(distance * outward + height * up, half_width * outward, half_height * up, power=2.0)
