"""Priors: decoding of a genome's leading genes to hand poses; interface, kinds and table.

given: poses that are scored as they are; the genes are x y z [m], qx qy qz qw, the CoM frame.

spherical: only that hands are near objects; the prior of the paper's methods without a prefix. The base
frame's position in spherical coordinates about the centre of mass, and its rotation as Euler angles alpha,
beta, gamma about the fixed axes x, y and z in this order. All are drawn uniformly, so positions are dense at
the centre and the poles. The paper does not print the genes; they are those of its released code.

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

valued: the hand is put into a cell, and looks at the object from there.

An archive keeps a pose by the hand's position, so that a search may choose the position and leave the rest to
geometry. A genome names a target, whose cell of 1 cm the hand stands in, a hint of the contact point, a roll,
and the number of candidates. A candidate's position is uniform in the cell; its contact point is the surface
point nearest to the hint, moved by 7 mm, or anywhere; the hand looks at it. A single candidate is not
scattered: it stands at the target itself and looks at the hint, unless the hint is drawn from anywhere.
Distance and direction follow: candidates out of the stand-off are dead ends. `CandidateScreen` chooses which
of the others is simulated.

The roll is about the direction from the target's own position to the hint. It is carried over to the
directions of the candidates as a vector, because its zero jumps between directions (`rotation.tangents`).

The draws depend on the genome's bytes alone.
"""

import hashlib
from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from qdgrasp_assets import genes as known
from qdgrasp_assets.geometry.rotation import (
    Floats,
    conjugate,
    dot,
    from_euler,
    from_frame,
    multiply,
    rolls,
    tangents,
    turned,
)
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_protocol import rows
from qdgrasp_protocol.rows import Layout
from qdgrasp_worker.object_geometry import ObjectSurface, cross


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


PER_METRE = 100  # Cells in a metre: cell k reaches from k - 0.5 to k + 0.5 cm
POINT_SIGMA = 0.007  # Standard deviation of a tightly drawn contact point along each axis [m]
ROLL_SIGMA = 0.15  # rad
TARGET, HINT, OMEGA, LOOSENESS, CANDIDATES = slice(0, 3), slice(3, 6), 6, 7, 8
WEIGHTS = slice(9, 9 + known.RANKING_GENES)
"""The places of the prior's own genes; `WEIGHTS` rank candidates."""


class ValuedPrior(Prior):
    """A prior whose genomes stand for several candidates each, ranked by genes of their own."""

    name = known.VALUED

    def candidates(
        self, genes: Floats, genomes: NDArray[np.float32], surface: ObjectSurface
    ) -> PriorCandidates:
        """Candidates, as genes whose target is the hand's position, and whose hints are exact."""
        asked = np.clip(np.nan_to_num(genes[:, CANDIDATES]), 1.0, known.MOST_CANDIDATES)
        counts = np.rint(asked).astype(np.int64)
        rows = np.repeat(np.arange(len(genes)), counts)
        asides, _ = turned(*tangents(unit_directions(genes[:, TARGET], genes[:, HINT])), genes[:, OMEGA])
        candidates = genes[rows]
        starts = np.cumsum(counts) - counts
        for genome, start, count in zip(genomes, starts.tolist(), counts.tolist(), strict=True):
            scatter_candidates(candidates[start : start + count], genome_generator(genome), surface)
        points = surface.points[surface.nearest(candidates[:, HINT])]
        candidates[:, OMEGA] += rolls(asides[rows], unit_directions(candidates[:, TARGET], points))
        return PriorCandidates(rows, candidates, genes[:, WEIGHTS])

    def poses(self, genes: Floats, surface: ObjectSurface, hand: SceneGripper) -> PriorPoses:
        """The poses that candidates (m, k) stand for; dead ends are zeros."""
        positions, nearest = genes[:, TARGET], surface.nearest(genes[:, HINT])
        points, normals = surface.points[nearest], surface.normals[nearest]
        offsets = positions - points
        distances = np.sqrt(dot(offsets, offsets))
        low, high = hand.standoff
        stood_off = distances - hand.palm_offset
        found = (distances > 0.0) & (stood_off >= low) & (stood_off <= high) | np.isnan(distances)
        outward = np.where(found[:, None], offsets / distances[:, None], normals)
        aside = cross(normals, outward)
        nu = np.arctan2(np.sqrt(dot(aside, aside)), dot(normals, outward))
        quaternions = look_along(-outward, genes[:, OMEGA], hand)
        return PriorPoses(
            np.where(found[:, None], positions, 0.0),
            np.where(found[:, None], quaternions, 0.0),
            np.where(found[:, None], points, 0.0),
            np.where(found, nu, 0.0),
            ~found,
        )


def scatter_candidates(genes: Floats, random: Generator, surface: ObjectSurface) -> None:
    """Draw candidates (k, g) of one genome in place: position, contact point, roll by the hint."""
    k = len(genes)
    genes[:, OMEGA] = 0.0
    if k > 1:
        cells = np.rint(genes[:, TARGET] * PER_METRE)
        genes[:, TARGET] = (cells - 0.5 + random.random((k, 3))) / PER_METRE
        genes[:, HINT] += random.normal(0.0, POINT_SIGMA, (k, 3))
        genes[:, OMEGA] = random.normal(0.0, ROLL_SIGMA, k)
    is_loose = random.random(k) < genes[:, LOOSENESS]
    anywhere = surface.points[random.integers(len(surface.points), size=k)]
    genes[:, HINT] = np.where(is_loose[:, None], anywhere, genes[:, HINT])
    genes[:, OMEGA] = np.where(is_loose, random.uniform(0.0, 2.0 * np.pi, k), genes[:, OMEGA])


def unit_directions(positions: Floats, points: Floats) -> Floats:
    """The unit vectors (n, 3) from positions to points; z where both are the same."""
    ways = points - positions
    lengths = np.sqrt(dot(ways, ways))[:, None]
    return np.where(lengths > 0.0, ways / lengths, np.array([0.0, 0.0, 1.0]))


def genome_generator(genome: NDArray[np.float32]) -> Generator:
    """The random generator that a genome's bytes seed."""
    digest = hashlib.sha256(genome.astype("<f4").tobytes()).digest()
    return np.random.default_rng(np.frombuffer(digest, dtype="<u4").tolist())


EVERY = (
    AntipodalPrior(),
    ConePrior("approach"),
    ConePrior("contact"),
    FixedPosePrior(),
    SphericalPrior(),
    ValuedPrior(),
)
PRIORS: dict[str, Prior] = {prior.name: prior for prior in EVERY}
