"""The interface of priors, and the two that do not look at the surface: given and spherical.

given: poses that are scored as they are; the genes are x y z [m], qx qy qz qw, the CoM frame.

spherical: only that hands are near objects; the prior of the paper's methods without a prefix. The base
frame's position in spherical coordinates about the centre of mass, and its rotation as Euler angles alpha,
beta, gamma about the fixed axes x, y and z in this order. All are drawn uniformly, so positions are dense at
the centre and the poles. The paper does not print the genes; they are those of its released code.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import Floats, from_euler
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_protocol import rows
from qdgrasp_protocol.rows import Layout
from qdgrasp_worker.object_geometry import ObjectSurface


@dataclass(frozen=True)
class PriorCandidates:
    """The candidates that genomes stand for; most priors have one for each genome."""

    rows: NDArray[np.intp]
    """(m,): the genome that each is a candidate for, ascending; every genome has one at least."""
    genes: Floats
    """(m, d): the values of its genes, in m and rad."""
    weights: Floats
    """(n, f): numbers by which a genome's candidates are ranked; f is 0 where there is no choice."""


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


class Prior(ABC):
    """Decodes the leading genes of a genome to a hand pose."""

    name: str

    def values(self, layout: Layout, genomes: NDArray[np.float32]) -> Floats:
        """The values (n, d) of genomes (n, d) in [-1, 1], in m and rad."""
        return layout.values(genomes)

    def candidates(
        self, genes: Floats, genomes: NDArray[np.float32], surface: ObjectSurface
    ) -> PriorCandidates:
        """The candidates of genomes (n, d) whose genes stand for `genes` (n, d)."""
        return PriorCandidates(np.arange(len(genes)), genes, np.zeros((len(genes), 0)))

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
        n = len(genes)
        return PriorPoses(genes[:, :3], quaternions, np.zeros((n, 3)), np.zeros(n), np.zeros(n, dtype=bool))


GIVEN = FixedPosePrior()


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
        n = len(genes)
        return PriorPoses(
            radius[:, None] * np.stack(outward, axis=-1),
            from_euler(genes[:, 3:6]),
            np.zeros((n, 3)),
            np.zeros(n),
            np.zeros(n, dtype=bool),
        )


SPHERICAL = SphericalPrior()
