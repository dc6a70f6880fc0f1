"""spherical: no prior but that hands are near objects; that of the paper's methods without a prefix.

The base frame's position in spherical coordinates about the centre of mass, and its rotation as Euler angles
alpha, beta, gamma about the fixed axes x, y and z in this order. All are drawn uniformly, so positions crowd
about the centre and the poles. The paper does not print the genes; they are those of its released code.
"""

import numpy as np

from qdgrasp_assets.rotation import Floats, from_euler
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_worker.priors.prior import Poses, Prior
from qdgrasp_worker.surface import Surface


class Spherical(Prior):
    """A prior that aims at nothing."""

    name = "spherical"

    def poses(self, genes: Floats, surface: Surface, hand: SceneGripper) -> Poses:
        """The poses that (r, longitude, colatitude, alpha, beta, gamma) (n, 6) stand for."""
        radius, longitude, colatitude = genes[:, 0], genes[:, 1], genes[:, 2]
        outward = [
            np.sin(colatitude) * np.cos(longitude),
            np.sin(colatitude) * np.sin(longitude),
            np.cos(colatitude),
        ]
        n = len(genes)
        return Poses(
            radius[:, None] * np.stack(outward, axis=-1),
            from_euler(genes[:, 3:6]),
            np.zeros((n, 3)),
            np.zeros(n),
            np.zeros(n, dtype=bool),
        )


SPHERICAL = Spherical()
