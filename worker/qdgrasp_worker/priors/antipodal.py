"""antipodal: two fingers press on each other (Huber et al. 2024, section III-A, eq. 3-4).

theta = (x_r1, y_r1, z_r1, Omega): the finder chooses the nearest surface point P1 with normal n1; P2 is the
last point of the object along -n1 within the hand's opening, n2 its normal. They make a grasp when the angle
between n1 and -n2 is at most nu_t = pi / 6; else the genome is a dead end. The fingers close along P1 P2, the
fingertips stand at its middle, and Omega is the roll about it.

It is geometry alone, in every evaluation protocol. The released code of the paper probes with a sphere and
takes the first exit, accepts angles of 160 to 190 and -15 to 15 degrees, and stops at 8 cm for every hand.
"""

from math import sqrt

import numpy as np

from qdgrasp_assets.rotation import Floats, conjugate, dot, from_frame, multiply, tangents, turned
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_worker.exits import cross
from qdgrasp_worker.priors.prior import Poses, Prior
from qdgrasp_worker.surface import Surface

COS_NU_T = sqrt(3.0) / 2.0
"""nu_t = pi / 6 as the code compares it."""


class Antipodal(Prior):
    """A prior that closes two fingers on opposite points."""

    name = "antipodal"

    def poses(self, genes: Floats, surface: Surface, hand: SceneGripper) -> Poses:
        """The poses that theta (n, 4) stands for; dead ends are zeros but for the surface point."""
        nearest = surface.nearest(genes[:, :3])
        points, inward = surface.points[nearest], -surface.normals[nearest]
        distances, normals = surface.opposites.distances[nearest], surface.opposites.normals[nearest]
        found = dot(inward, normals) >= COS_NU_T
        found &= np.isfinite(distances)
        pointing, aside = turned(*tangents(inward), genes[:, 3])
        positions = points + (distances / 2.0)[:, None] * inward - hand.reach * pointing
        quaternions = multiply(from_frame(inward, -aside, pointing), conjugate(at_rest(hand, len(genes))))
        return Poses(
            np.where(found[:, None], positions, 0.0),
            np.where(found[:, None], quaternions, 0.0),
            points,
            np.where(found, np.arctan2(hand.reach, -distances / 2.0), 0.0),
            ~found,
        )


def at_rest(hand: SceneGripper, n: int) -> Floats:
    """The rotation (n, 4) of a frame whose x is the jaw's axis and whose z is the approach axis."""
    assert hand.jaw is not None  # noqa: S101  # without one there are no genes for this prior
    jaw, approach = np.array([hand.jaw.axis]), np.array([hand.approach_axis])
    return np.broadcast_to(from_frame(jaw, cross(approach, jaw), approach), (n, 4))


ANTIPODAL = Antipodal()
