"""Searches that aim at cells beside successes, with a neighbour's grasp.

An archive distinguishes grasps by the position of the hand, which is known before anything is simulated. So
the search chooses the cell first, by its frontier, and then the genes that bring the hand there: the
contact point, roll and posture of a successful neighbour. The worker makes candidates of these, screens
them for overlap, and simulates the one that a model ranks first; the model learns here, and its weights
are sent in the genome.

Exploration: grasps without a success to learn from aim as the prior `approach` would at a box: at a cell
before one of its faces, at most 45 degrees aside, and near it, where most grasps hold. They use the object's
box and the hand's distances, and leave the surface to the worker.

Other modules decide which cells and which candidates are worth a try: `value_search` and `niche_search`.

New in this project, not from the paper.
"""

from dataclasses import dataclass, replace

import numpy as np

from qdgrasp_assets.genes import NU_A, RANKING_GENES
from qdgrasp_assets.geometry.rotation import Floats, tangents, turned
from qdgrasp_coordinator.metrics.cells import PER_METRE
from qdgrasp_coordinator.search.base import SearchSpace
from qdgrasp_protocol.rows import Genomes, Layout

TARGET, CONTACT, ROLL, LOOSENESS, CANDIDATES = slice(0, 3), slice(3, 6), 6, 7, 8
"""Places of the prior's genes in a genome (assets, `genes`)."""
FIRST_WEIGHT = 9  # Place of the first gene that ranks candidates
SYNERGY = "synergy"
SCATTER_SHARE = 0.5  # Inner share of a cell in which a scattered target may be, along each axis
POINT_SIGMA = 0.002  # Standard deviation of a scattered contact point along each axis [m]
ROLL_SIGMA = 0.05  # rad


@dataclass(frozen=True)
class AimedGrasps:
    """Cells to aim at, each with the grasp to try there."""

    targets: Floats
    """(n, 3) [m]: the middles of the cells."""
    contacts: Floats
    """(n, 3) [m]: the surface points to look at, approximately."""
    rolls: Floats
    """(n,) [rad]: about the direction from target to contact."""
    looseness: Floats
    """(n,): 0 keeps to contact and roll, 1 takes any."""
    postures: Floats
    """(n, k): genes of synergy and free joints."""

    def __len__(self) -> int:
        return len(self.targets)

    def genomes(self, layout: Layout, candidates: int, weights: Floats) -> Genomes:
        """Return their genomes (n, d), with `candidates` each, ranked by weights (n, w)."""
        values = np.zeros((len(self), FIRST_WEIGHT + weights.shape[1]))
        values[:, TARGET], values[:, CONTACT] = self.targets, self.contacts
        values[:, ROLL], values[:, LOOSENESS] = self.rolls, self.looseness
        values[:, CANDIDATES], values[:, FIRST_WEIGHT:] = candidates, weights
        own = Layout(layout.prior, layout.genes[: values.shape[1]]).genomes(values)
        return np.concatenate([own, self.postures.astype(np.float32)], axis=1)


def directions(targets: Floats, contacts: Floats) -> Floats:
    """The unit vectors (n, 3) from targets to contacts; along z where both points are the same."""
    ways = contacts - targets
    lengths = np.sqrt((ways * ways).sum(axis=1))[:, None]
    along: Floats = np.tile([0.0, 0.0, 1.0], (len(ways), 1))
    np.divide(ways, lengths, out=along, where=lengths > 0)
    return along


def join_grasps(one: AimedGrasps, other: AimedGrasps) -> AimedGrasps:
    """The aims of both, one after the other."""
    return AimedGrasps(*(np.concatenate([vars(one)[name], vars(other)[name]]) for name in vars(one)))


def scatter_grasps(aims: AimedGrasps, generator: np.random.Generator) -> AimedGrasps:
    """Scatter aims a little, for genomes of one candidate, which the prior does not scatter.

    It is less than the prior's scatter, where the best of many candidates is taken.
    """
    n = len(aims)
    return replace(
        aims,
        targets=aims.targets + SCATTER_SHARE / PER_METRE * generator.uniform(-0.5, 0.5, (n, 3)),
        contacts=aims.contacts + POINT_SIGMA * generator.standard_normal((n, 3)),
        rolls=aims.rolls + ROLL_SIGMA * generator.standard_normal(n),
    )


NEAR_SHARE = 0.5  # Share of the hand's distances, from the nearest: farther off few grasps hold
LEAST_LOOSENESS = 0.3  # The least looseness, as a share of the greatest


def exploration_grasps(
    space: SearchSpace, n: int, free_share: float, loosest: float, generator: np.random.Generator
) -> AimedGrasps:
    """Return `n` grasps that explore, without a success to learn from.

    The share `free_share` of them aims anywhere in the archive's box, at any point: for objects unlike
    their boxes. The others have at most the looseness `loosest`: many candidates make up for a box that is
    not the surface; a single one should keep to its aim.
    """
    low, high = (corner[CONTACT] for corner in space.layout.intervals)
    bottom, top = (corner[TARGET] for corner in space.layout.intervals)
    nearest, farthest = space.distances
    contacts, outward = _on_faces(low, high, n, generator)
    distances = nearest + NEAR_SHARE * (farthest - nearest) * generator.random(n)
    targets = contacts + distances[:, None] * _leaning(outward, generator)
    looseness = loosest * generator.uniform(LEAST_LOOSENESS, 1.0, n)
    anywhere = generator.uniform(bottom, top, (n, 3))
    is_free = generator.random(n) < free_share
    return AimedGrasps(
        np.where(is_free[:, None], anywhere, targets),
        contacts,
        generator.uniform(0.0, 2 * np.pi, n),
        np.where(is_free, 1.0, looseness),
        generator.uniform(-1.0, 1.0, (n, posture_genes(space))),
    )


def posture_genes(space: SearchSpace) -> int:
    """The number of genes of the posture, synergy and free joints, behind the prior's own."""
    return space.genes - FIRST_WEIGHT - RANKING_GENES


def _on_faces(low: Floats, high: Floats, n: int, generator: np.random.Generator) -> tuple[Floats, Floats]:
    """Points (n, 3) uniform on the surface of a box, and its normals there."""
    size = high - low
    areas = np.roll(size, 1) * np.roll(size, 2)
    axes = generator.choice(3, n, p=areas / areas.sum())
    is_high = generator.random(n) < 0.5
    points = generator.uniform(low, high, (n, 3))
    rows = np.arange(n)
    points[rows, axes] = np.where(is_high, high[axes], low[axes])
    normals = np.zeros((n, 3))
    normals[rows, axes] = np.where(is_high, 1.0, -1.0)
    return points, normals


def _leaning(normals: Floats, generator: np.random.Generator) -> Floats:
    """Directions (n, 3) at most 45 degrees from `normals`, as the prior `approach` draws them."""
    n = len(normals)
    nu, xi = generator.uniform(0.0, NU_A, n), generator.uniform(0.0, 2 * np.pi, n)
    aside, _ = turned(*tangents(normals), xi)
    return np.cos(nu)[:, None] * normals + np.sin(nu)[:, None] * aside
