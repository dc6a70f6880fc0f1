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

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from qdgrasp_assets.genes import MOST_CANDIDATES, NU_A, RANKING_GENES
from qdgrasp_assets.geometry.rotation import Floats, tangents, turned
from qdgrasp_coordinator.metrics.cells import PER_METRE
from qdgrasp_coordinator.search.archive import PositionBox
from qdgrasp_coordinator.search.base import SearchSpace, keyed_generator
from qdgrasp_coordinator.search.frontier import ANYWHERE, EliteStore, Frontier, Places
from qdgrasp_coordinator.search.success_model import ValueThreshold
from qdgrasp_protocol.rows import Genomes, Layout, Rows
from qdgrasp_protocol.spec import RunSpec

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
    return space.genes - FIRST_WEIGHT - RANKING_GENES[space.layout.prior]


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


FIRST_EXPLORING = 100  # Genomes that explore before any is aimed
EXPLORING_SHARE = 0.04
"""Approximate share of evaluations that explore later; of genomes less, as none of these is refused."""
ANYWHERE_GENOMES = 2000
"""Genomes after which half of the exploring ones aim anywhere if there is no success; before, fewer do."""
SYNERGY_REDRAW = 0.15  # The probability that a synergy is drawn anew
POSTURE_SIGMA = 0.05  # Standard deviation by which free joints move from their neighbour's, in genes


class AimedSearch(ABC):
    """Aims at cells of a frontier, with genomes of a prior that chooses among candidates.

    Where overlaps count, a genome has one candidate, so that every pose that is tried counts.
    """

    def __init__(
        self,
        spec: RunSpec,
        space: SearchSpace,
        frontier: Callable[[PositionBox, float, tuple[float, float]], Frontier],
        threshold: ValueThreshold,
    ) -> None:
        self._spec = spec
        self._space = space
        self._counts_all = spec.overlaps == "count"
        self._within = space.distances if self._counts_all else ANYWHERE
        self._frontier = frontier(space.box, space.distances[1], self._within)
        self._elites = EliteStore(self._frontier.size, space.approach_axis, posture_genes(space))
        self._threshold = threshold
        self._open: dict[int, Floats] = {}  # Features of the cells that generations not told yet aim at
        self._candidates = 1 if self._counts_all else MOST_CANDIDATES
        self._asked = 0

    @abstractmethod
    def tell(self, generation: int, rows: Rows) -> None:
        """Learn from a generation's nominal rows, of which those that aimed at cells come first."""

    @abstractmethod
    def _choose_cells(self, generation: int, n: int, generator: np.random.Generator) -> Places:
        """The cells to aim at, each once, at most `n`."""

    @abstractmethod
    def _ranking(self, wanted: Floats) -> Floats:
        """Return the numbers (n, w) that rank candidates, by the value wanted (n,); 0: any."""

    def ask(self, generation: int) -> Genomes:
        """Return genomes that aim at the best cells, and some that explore: (population, genes)."""
        targets = self._targets(generation)
        self._open[generation] = self._frontier.features(targets)
        aimed = self._aimed(targets, generation)
        if self._candidates == 1:
            aimed = scatter_grasps(aimed, keyed_generator(self._spec.seed, "scatter", generation))
        exploring = self._exploring(generation, self._spec.population - len(aimed))
        wanted = self._threshold.wanted(self._frontier.dead_ends(aimed.targets))
        weights = self._weights(np.concatenate([wanted, np.zeros(len(exploring))]))
        genomes = join_grasps(aimed, exploring).genomes(self._space.layout, self._candidates, weights)
        self._frontier.count_tries(self._aimed_at(genomes))
        self._asked += len(genomes)
        return genomes

    def _targets(self, generation: int) -> Places:
        """The cells that a generation aims at; none at the start."""
        if self._asked < FIRST_EXPLORING:
            return np.zeros(0, np.intp)
        generator = keyed_generator(self._spec.seed, "targets", generation)
        exploring = EXPLORING_SHARE * self._threshold.share
        n = int(np.count_nonzero(generator.random(self._spec.population) >= exploring))
        return self._choose_cells(generation, n, generator)

    def _aimed(self, targets: Places, generation: int) -> AimedGrasps:
        """Return the grasps of neighbours, for the cells `targets`."""
        generator = keyed_generator(self._spec.seed, "parents", generation)
        parents = self._parents(targets, generator)
        centres, contacts = self._frontier.centres(targets), self._elites.points(parents)
        rolls = self._elites.rolls(parents, directions(centres, contacts))
        postures = self._varied(self._elites.postures(parents), generator)
        return AimedGrasps(centres, contacts, rolls, np.zeros(len(targets)), postures)

    def _parents(self, targets: Places, generator: np.random.Generator) -> Places:
        """Choose for each target a success in or around it, at a wanted distance where possible."""
        options = self._frontier.block(targets)
        preference = self._elites.preference(options, generator)
        least, greatest = self._within
        distances = self._elites.distances(options, self._frontier.centres(targets))
        is_near = (distances >= least) & (distances <= greatest)
        preference = np.where(is_near, preference, np.minimum(preference, 0.0))
        parents: Places = options[np.arange(len(targets)), preference.argmax(axis=1)]
        return parents

    def _varied(self, postures: Floats, generator: np.random.Generator) -> Floats:
        """Postures (n, k) with some synergies drawn anew and free joints moved a little."""
        names = self._space.layout.names[len(self._space.layout) - postures.shape[1] :]
        anew = generator.uniform(-1.0, 1.0, postures.shape)
        moved = np.clip(postures + POSTURE_SIGMA * generator.standard_normal(postures.shape), -1.0, 1.0)
        is_anew = generator.random((len(postures), 1)) < SYNERGY_REDRAW
        is_synergy = np.array([name == SYNERGY for name in names], dtype=np.bool_)
        return np.where(is_synergy, np.where(is_anew, anew, postures), moved)

    def _weights(self, wanted: Floats) -> Floats:
        """Return the numbers that rank each genome's candidates: (n, w).

        All zero where every pose counts, because one that is refused would count as well.
        """
        if self._counts_all:
            return np.zeros((len(wanted), RANKING_GENES[self._space.layout.prior]))
        return self._ranking(wanted)

    def _exploring(self, generation: int, n: int) -> AimedGrasps:
        found = len(self._elites) > 0
        free_share = 0.0 if found else min(0.5, 0.5 * self._asked / ANYWHERE_GENOMES)
        loosest = 0.0 if self._candidates == 1 else 1.0
        rng = keyed_generator(self._spec.seed, "scouts", generation)  # another key, other runs
        return exploration_grasps(self._space, n, free_share, loosest, rng)

    def _aimed_at(self, genomes: Genomes) -> Places:
        """The cells (n,) that genomes (n, d) aim at."""
        target = Layout(self._space.layout.prior, self._space.layout.genes[TARGET])
        return self._frontier.places(target.values(genomes[:, TARGET]))
