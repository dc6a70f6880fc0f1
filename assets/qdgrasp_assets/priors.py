"""Priors: from a genome's leading genes to hand poses; interface, kinds and table.

Workers decode genomes by them, and searches compute poses on the surface.

given: poses that are scored as they are; the genes are x y z [m], qx qy qz qw, the CoM frame.

spherical: only that hands are near objects: the base frame's position in spherical coordinates about the
centre of mass, and Euler angles about the fixed axes x, y and z; the genes of the paper's released code.

contact and approach, eq. 1-2: theta = (x_r, y_r, z_r, nu, d, xi, omega): the finder r chooses the nearest
surface point p with normal n; the hand stands at the distance d + w from p, in the direction that leans from
n by nu, turned about n by xi; its approach axis points at p, and omega is the roll about that axis. contact
looks from anywhere, nu in [0, pi]; approach from near the normal, nu in [0, nu_a], nu_a = pi / 4. The
interval of nu is the layout's.

antipodal, eq. 3-4: two fingers press on each other. theta = (x_r1, y_r1, z_r1, Omega): the finder chooses
the nearest surface point P1 with normal n1; P2 is the last point of the object along -n1 within the hand's
opening, n2 its normal. They make a grasp when the angle between n1 and -n2 is at most nu_t = pi / 6; else
the genome is a dead end. The fingers close along P1 P2, the fingertips stand at its middle, and Omega is the
roll about it.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.object_surface import ObjectSurface, cross
from qdgrasp_assets.geometry.rotation import (
    Floats,
    conjugate,
    dot,
    from_euler,
    from_frame,
    multiply,
    tangents,
    turned,
)
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_protocol import rows
from qdgrasp_protocol.rows import Layout


@dataclass(frozen=True)
class PriorPoses:
    """Hand poses before they are rounded; the hand's root link in the object's CoM frame."""

    positions: Floats
    """(n, 3) [m]."""
    quaternions: Floats
    """(n, 4) xyzw, unit; NaN where the genes name no rotation."""
    surface_points: Floats
    """(n, 3) [m]; zeros where the prior aims at none."""
    nu: Floats
    """(n,) [rad]; zero where the prior aims at none."""
    dead_ends: NDArray[np.bool_]
    """(n,): genomes that stand for no pose, though all genes are finite; their poses are zeros."""


def aimless(positions: Floats, quaternions: Floats) -> PriorPoses:
    """Return the poses of a prior that does not aim at the surface."""
    n = len(positions)
    return PriorPoses(positions, quaternions, np.zeros((n, 3)), np.zeros(n), np.zeros(n, dtype=bool))


class Prior(ABC):
    """Decodes the leading genes of a genome to a hand pose."""

    name: str

    def values(self, layout: Layout, genomes: NDArray[np.float32]) -> Floats:
        """The values (n, d) of genomes (n, d) in [-1, 1], in m and rad."""
        return layout.values(genomes)

    @abstractmethod
    def poses(self, genes: Floats, surface: ObjectSurface, hand: SceneGripper) -> PriorPoses:
        """The poses that the prior's own genes (n, k) stand for, one for each row."""


ROUNDING = 1e-6  # Deviation of a unit quaternion's length in float32; poses within it are left as stored


class FixedPosePrior(Prior):
    """A prior whose genes are the pose itself."""

    name = rows.GIVEN

    def values(self, layout: Layout, genomes: NDArray[np.float32]) -> Floats:
        """The genes, unchanged."""
        return genomes.astype(np.float64)

    def poses(self, genes: Floats, surface: ObjectSurface, hand: SceneGripper) -> PriorPoses:
        """The poses (n, 7) themselves; quaternions are scaled to length one."""
        given = genes[:, 3:7]
        lengths = np.sqrt((given * given).sum(axis=1, keepdims=True))
        quaternions = np.where(np.abs(lengths - 1.0) < ROUNDING, given, given / lengths)
        return aimless(genes[:, :3], quaternions)


class SphericalPrior(Prior):
    """A prior that does not aim at the surface."""

    name = "spherical"

    def poses(self, genes: Floats, surface: ObjectSurface, hand: SceneGripper) -> PriorPoses:
        """The poses that (r, longitude, colatitude, alpha, beta, gamma) (n, 6) stand for."""
        radius, longitude, colatitude = genes[:, 0], genes[:, 1], genes[:, 2]
        outward = [
            np.sin(colatitude) * np.cos(longitude),
            np.sin(colatitude) * np.sin(longitude),
            np.cos(colatitude),
        ]
        return aimless(radius[:, None] * np.stack(outward, axis=-1), from_euler(genes[:, 3:6]))


class ConePrior(Prior):
    """A prior that looks at the object out of a cone, opened by the interval of the gene nu."""

    def __init__(self, name: str) -> None:
        self.name = name

    def poses(self, genes: Floats, surface: ObjectSurface, hand: SceneGripper) -> PriorPoses:
        """The poses that theta (n, 7) stands for."""
        nu, d, xi, omega = genes[:, 3], genes[:, 4], genes[:, 5], genes[:, 6]
        nearest = surface.nearest(genes[:, :3])
        points = surface.points[nearest]
        normals = surface.normals[nearest]
        aside, _ = turned(*tangents(normals), xi)
        outward = np.cos(nu)[:, None] * normals + np.sin(nu)[:, None] * aside
        positions = points + (d + hand.palm_offset)[:, None] * outward
        return PriorPoses(
            positions, look_along(-outward, omega, hand), points, nu, np.zeros(len(genes), bool)
        )


def look_along(directions: Floats, omega: Floats, hand: SceneGripper) -> Floats:
    """Rotations (n, 4) of the hand's approach axis to `directions`, rolled by `omega` (n,)."""
    axis = np.array([hand.approach_axis], dtype=np.float64)
    at_rest = from_frame(*tangents(axis), axis)
    return multiply(
        from_frame(*turned(*tangents(directions), omega), directions),
        conjugate(np.broadcast_to(at_rest, (len(directions), 4))),
    )


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
        assert hand.jaw is not None  # noqa: S101  # without one there are no genes for this prior
        jaw, approach = np.array([hand.jaw.axis]), np.array([hand.approach_axis])
        in_hand = np.broadcast_to(from_frame(jaw, cross(approach, jaw), approach), (len(genes), 4))
        quaternions = multiply(from_frame(inward, -aside, pointing), conjugate(in_hand))
        return PriorPoses(
            np.where(found[:, None], positions, 0.0),
            np.where(found[:, None], quaternions, 0.0),
            points,
            np.where(found, np.arctan2(hand.reach, -distances / 2.0), 0.0),
            ~found,
        )


EVERY = (
    AntipodalPrior(),
    ConePrior("approach"),
    ConePrior("contact"),
    FixedPosePrior(),
    SphericalPrior(),
)
PRIORS: dict[str, Prior] = {prior.name: prior for prior in EVERY}
