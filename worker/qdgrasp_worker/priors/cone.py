"""The cone over a surface point, from which the palm looks at it (Huber et al. 2024, section III-A, eq. 1-2).

theta = (x_r, y_r, z_r, nu, d, xi, omega): the finder r chooses the nearest surface point p with normal n;
the hand stands at the distance d + w from p, in the direction that leans from n by nu, turned about n by xi;
its approach axis points at p, and omega is the roll about that axis.

The zeros of xi and omega come from `rotation.tangents`, which has no singularity; the frame of the public
code divides by the normal's z. Only the zeros differ: both angles cover the full circle.
"""

import numpy as np

from qdgrasp_assets.rotation import Floats, conjugate, from_frame, multiply, tangents, turned
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_worker.priors.prior import Poses, Prior
from qdgrasp_worker.surface import Surface


class Cone(Prior):
    """A prior that looks at the object out of a cone; how far it opens is the interval of the gene nu."""

    def __init__(self, name: str) -> None:
        self.name = name

    def poses(self, genes: Floats, surface: Surface, hand: SceneGripper) -> Poses:
        """The poses that theta (n, 7) stands for."""
        nu, d, xi, omega = genes[:, 3], genes[:, 4], genes[:, 5], genes[:, 6]
        nearest = surface.nearest(genes[:, :3])
        points = surface.points[nearest]
        outward = leaning(surface.normals[nearest], nu, xi)
        positions = points + (d + hand.palm_offset)[:, None] * outward
        return Poses(positions, looking(-outward, omega, hand), points, nu, np.zeros(len(genes), bool))


def leaning(normals: Floats, nu: Floats, xi: Floats) -> Floats:
    """Unit vectors (n, 3) that lean from `normals` by `nu` (n,) [rad], turned about them by `xi` (n,)."""
    aside, _ = turned(*tangents(normals), xi)
    return np.cos(nu)[:, None] * normals + np.sin(nu)[:, None] * aside


def looking(directions: Floats, omega: Floats, hand: SceneGripper) -> Floats:
    """The rotations (n, 4) that turn the hand's approach axis to `directions` and roll it by `omega` (n,)."""
    axis = np.array([hand.approach_axis], dtype=np.float64)
    at_rest = from_frame(*tangents(axis), axis)
    return multiply(
        from_frame(*turned(*tangents(directions), omega), directions),
        conjugate(np.broadcast_to(at_rest, (len(directions), 4))),
    )
