"""The stand-in of the spatula: handle, neck and bent blade, one behind the other along x.

Its outlines are those of the scan, in a frame turned about z with the spatula, a blade of 4 mm as the scan's
sections show it; the hole in the handle's end is left out.
"""

import numpy as np

from qdgrasp_assets.mesh import Floats, Mesh
from qdgrasp_assets.objects.chain import chain, outline

OUTLINES = (
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
    """Surface and convex parts of the spatula."""
    return chain([_outline(*row) for row in OUTLINES])


def _outline(x: float, y: float, z: float, half_width: float, half_height: float, power: float) -> Floats:
    _, across, up = np.eye(3)
    return outline(np.array([x, y, z]), half_width * across, half_height * up, power)
