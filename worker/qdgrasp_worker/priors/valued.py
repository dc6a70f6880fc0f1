"""valued: the hand is put into a cell, and looks at the object from there.

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

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from qdgrasp_assets import genes as known
from qdgrasp_assets.geometry.rotation import Floats, dot, rolls, tangents, turned
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_worker.object_geometry import ObjectSurface, cross
from qdgrasp_worker.priors.base import Prior, PriorCandidates, PriorPoses
from qdgrasp_worker.priors.surface_priors import look_along

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


VALUED = ValuedPrior()
