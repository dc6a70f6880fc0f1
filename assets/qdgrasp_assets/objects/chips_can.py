"""The stand-in of the chips can: a cylinder with bevelled edges, one convex part, its bottom z = 0."""

import numpy as np

from qdgrasp_assets.mesh import Mesh
from qdgrasp_assets.objects.chain import stack
from qdgrasp_assets.objects.solids import hull

RADIUS, HEIGHT = 0.0375, 0.250  # published: 75 mm wide, 250 mm high
EDGE, BEVEL = 0.034, 0.005  # radius of the ends, height of the bevels


def chips_can() -> tuple[Mesh, tuple[Mesh, ...]]:
    """Surface and convex part of the can, which are the same."""
    rings = ((0.0, EDGE), (BEVEL, RADIUS), (HEIGHT - BEVEL, RADIUS), (HEIGHT, EDGE))
    solid = hull(np.concatenate(stack((z, 0.0, 0.0, radius, radius, 2.0) for z, radius in rings)))
    return solid, (solid,)
