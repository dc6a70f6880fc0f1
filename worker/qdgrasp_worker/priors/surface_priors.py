"""Priors that aim at a surface point: contact, approach and antipodal (Huber et al. 2024).

contact and approach, eq. 1-2: theta = (x_r, y_r, z_r, nu, d, xi, omega): the finder r chooses the nearest
surface point p with normal n; the hand stands at the distance d + w from p, in the direction that leans from
n by nu, turned about n by xi; its approach axis points at p, and omega is the roll about that axis. contact
looks from anywhere, nu in [0, pi]; approach from near the normal, nu in [0, nu_a], nu_a = pi / 4. The
interval of nu is the layout's.

The zeros of xi and omega come from `rotation.tangents`, which has no singularity; the frame of the public
code divides by the normal's z. Only the zeros differ: both angles cover the full circle.

antipodal, eq. 3-4: two fingers press on each other. theta = (x_r1, y_r1, z_r1, Omega): the finder chooses
the nearest surface point P1 with normal n1; P2 is the last point of the object along -n1 within the hand's
opening, n2 its normal. They make a grasp when the angle between n1 and -n2 is at most nu_t = pi / 6; else
the genome is a dead end. The fingers close along P1 P2, the fingertips stand at its middle, and Omega is the
roll about it. It is geometry alone, in every evaluation protocol. The released code of the paper probes with
a sphere and takes the first exit, accepts angles of 160 to 190 and -15 to 15 degrees, and stops at 8 cm for
every hand.
"""

from math import sqrt

import numpy as np

from qdgrasp_assets.geometry.rotation import Floats, conjugate, dot, from_frame, multiply, tangents, turned
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_worker.object_geometry import ObjectSurface, cross
from qdgrasp_worker.priors.base import Prior, PriorPoses


class ConePrior(Prior):
    """A prior that looks at the object out of a cone, opened by the interval of the gene nu."""

    def __init__(self, name: str) -> None:
        self.name = name

    def poses(self, genes: Floats, surface: ObjectSurface, hand: SceneGripper) -> PriorPoses:
        """The poses that theta (n, 7) stands for."""
        nu, d, xi, omega = genes[:, 3], genes[:, 4], genes[:, 5], genes[:, 6]
        nearest = surface.nearest(genes[:, :3])
        points = surface.points[nearest]
        outward = lean_from(surface.normals[nearest], nu, xi)
        positions = points + (d + hand.palm_offset)[:, None] * outward
        return PriorPoses(
            positions, look_along(-outward, omega, hand), points, nu, np.zeros(len(genes), bool)
        )


def lean_from(normals: Floats, nu: Floats, xi: Floats) -> Floats:
    """Unit vectors (n, 3): `normals` leant by `nu` (n,) [rad], turned about them by `xi` (n,)."""
    aside, _ = turned(*tangents(normals), xi)
    return np.cos(nu)[:, None] * normals + np.sin(nu)[:, None] * aside


def look_along(directions: Floats, omega: Floats, hand: SceneGripper) -> Floats:
    """Rotations (n, 4) of the hand's approach axis to `directions`, rolled by `omega` (n,)."""
    axis = np.array([hand.approach_axis], dtype=np.float64)
    at_rest = from_frame(*tangents(axis), axis)
    return multiply(
        from_frame(*turned(*tangents(directions), omega), directions),
        conjugate(np.broadcast_to(at_rest, (len(directions), 4))),
    )


CONTACT = ConePrior("contact")
APPROACH = ConePrior("approach")


COS_NU_T = sqrt(3.0) / 2.0  # nu_t = pi / 6 as the code compares it


class AntipodalPrior(Prior):
    """A prior that closes two fingers on opposite points."""

    name = "antipodal"

    def poses(self, genes: Floats, surface: ObjectSurface, hand: SceneGripper) -> PriorPoses:
        """The poses that theta (n, 4) stands for; dead ends are zeros but for the surface point."""
        nearest = surface.nearest(genes[:, :3])
        points, inward = surface.points[nearest], -surface.normals[nearest]
        distances, normals = surface.opposites.distances[nearest], surface.opposites.normals[nearest]
        found = dot(inward, normals) >= COS_NU_T
        found &= np.isfinite(distances)
        pointing, aside = turned(*tangents(inward), genes[:, 3])
        positions = points + (distances / 2.0)[:, None] * inward - hand.reach * pointing
        quaternions = multiply(
            from_frame(inward, -aside, pointing), conjugate(jaw_rotation(hand, len(genes)))
        )
        return PriorPoses(
            np.where(found[:, None], positions, 0.0),
            np.where(found[:, None], quaternions, 0.0),
            points,
            np.where(found, np.arctan2(hand.reach, -distances / 2.0), 0.0),
            ~found,
        )


def jaw_rotation(hand: SceneGripper, n: int) -> Floats:
    """The rotation (n, 4) of a frame whose x is the jaw's axis and whose z is the approach axis."""
    assert hand.jaw is not None  # noqa: S101  # without one there are no genes for this prior
    jaw, approach = np.array([hand.jaw.axis]), np.array([hand.approach_axis])
    return np.broadcast_to(from_frame(jaw, cross(approach, jaw), approach), (n, 4))


ANTIPODAL = AntipodalPrior()
