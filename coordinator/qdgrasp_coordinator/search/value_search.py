"""The search that aims at value: at cells that may gain most, with the best candidates.

An archive distinguishes grasps by the position of the hand, which is known before anything is simulated. So
the search chooses the cell first, by its frontier, and then the genes that bring the hand there: the
contact point, roll and posture of a successful neighbour. The worker makes candidates of these, screens
them for overlap, and simulates the one that a model ranks first; the model learns here, and its weights
are sent in the genome. Grasps without a success to learn from explore: they aim as the prior `approach`
would at a box, at a cell before one of its faces, at most 45 degrees aside, and near it. They use the
object's box and the hand's distances, and leave the surface to the worker. New in this project, not from the
paper.

A pose is worth P(touch) (c + (1 - c) q): q is the expected quality of a grasp that touches, between 0 and 1,
and c (`TOUCH_VALUE`) the value of touching alone. Both parts are logistic models, learned during the run,
twice: on the features that a worker gives of a candidate, for ranking and threshold; and on the features of a
cell before it is tried, for the choice of cells. The worth of a cell is its possible gain: the touch if it
has none, and quality beyond its best, by the same formula for empty and weak cells. So none is closed by its
first touch.

Quality is the spec's `aim_for`: whether the grasp held (`hold`), its eta (`eta`), its Ferrari-Canny margin
(`margin`), or 1 for any touch (`touch`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.genes import MOST_CANDIDATES, NU_A, RANKING_GENES, STEEPEST_VALUE
from qdgrasp_assets.geometry.rotation import Floats, tangents, turned
from qdgrasp_coordinator.metrics.cells import PER_METRE
from qdgrasp_coordinator.metrics.grasp_quality import recorded_margins
from qdgrasp_coordinator.search.base import SearchSpace, keyed_generator
from qdgrasp_coordinator.search.frontier import ANYWHERE, EliteStore, Frontier, Places, outcome_ranks
from qdgrasp_coordinator.search.success_model import (
    NO_WEIGHTS,
    STARTS,
    LogisticRegression,
    ValueThreshold,
    first_model,
)
from qdgrasp_protocol.rows import Genomes, Layout, Outcome, Rows
from qdgrasp_protocol.spec import FirstWeights, RunSpec

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


WANTED = 0.5  # Value demanded of a cell's first candidates
LEAST_SHARE = 0.25  # Share of genomes below which less is demanded: 0.1 cost twice the genomes on the drill
GRADES = float(Outcome.HELD - Outcome.DROPPED)  # Outcomes between the worst and the best success
FULL_ETAS = {"paper": 0.3, "physical": 1.0}
"""Eta of quality 1 by base: of `paper`'s trials most are lost before the hand closes, so that 0.3 is rare."""
FULL_MARGIN = 0.1  # Ferrari-Canny margin of quality 1; of the Panda on cube and mug 99 in 100 are below 0.07
QUALITY_GRAIN = 1024
"""Qualities are whole multiples of 1 / GRAIN: the last bits of a margin hardly ever reach a genome."""

Qualities = Callable[[Rows], Floats]
"""The quality (n,) of successes (n,), 0 to 1."""


def quality_measure(spec: RunSpec, space: SearchSpace) -> Qualities:
    """Return the measure of a spec's objective."""
    if spec.aim_for == "eta":
        most = FULL_ETAS[spec.nominal_protocol] * spec.disturbances * spec.trial_count
        return lambda rows: np.minimum(rows["fitness"].astype(np.float64) / most, 1.0)
    if spec.aim_for == "touch":  # the first touch is worth all, and closes its cell
        return lambda rows: np.ones(len(rows))
    if spec.aim_for == "margin" and space.body is not None:
        body = space.body
        return lambda rows: _quantised_quality(recorded_margins(rows, body) / FULL_MARGIN)
    return lambda rows: (rows["outcome"] >= Outcome.HELD).astype(np.float64)


def _quantised_quality(values: Floats) -> Floats:
    quality: Floats = np.rint(QUALITY_GRAIN * np.clip(np.nan_to_num(values), 0.0, 1.0)) / QUALITY_GRAIN
    return quality


class ValueModel:
    """The models that rank candidates, by the features that the prior `valued` gives of a pose."""

    def __init__(self, first: FirstWeights = NO_WEIGHTS) -> None:
        self.touch = first_model("touch", first.touch, own_units=True)
        self.quality = first_model("quality", first.quality, own_units=True)

    def ranking(self, wanted: Floats) -> Floats:
        """Return weights of both models, and the value wanted of candidates: (n, w).

        All are zero before the first fit, unless the spec has weights of other runs.
        """
        weights = np.zeros((len(wanted), RANKING_GENES))
        if self.touch.weights.any():
            both = np.concatenate([self.touch.weights, self.quality.weights])
            weights[:, :-1] = np.clip(both, -STEEPEST_VALUE, STEEPEST_VALUE)
            weights[:, -1] = wanted
        return weights

    def learn(self, simulated: Rows, quality: Floats) -> None:
        """Learn from rows that were simulated, and the quality (n,) of those that are successes."""
        features = simulated["descriptor"][:, 3:].astype(np.float64)
        is_success = simulated["outcome"] >= Outcome.DROPPED
        self.touch.learn(features, is_success)
        self.quality.learn(features[is_success], quality[is_success])


FIRST_EXPLORING = 100  # Genomes that explore before any is aimed
EXPLORING_SHARE = 0.04
"""Approximate share of evaluations that explore later; of genomes less, as none of these is refused."""
ANYWHERE_GENOMES = 2000
"""Genomes after which half of the exploring ones aim anywhere if there is no success; before, fewer do."""
SYNERGY_REDRAW = 0.15  # The probability that a synergy is drawn anew
POSTURE_SIGMA = 0.05  # Standard deviation by which free joints move from their neighbour's, in genes


class ValueSearch:
    """Aims at cells whose best grasp may be beaten, empty ones included.

    Its prior chooses among candidates. Where overlaps count, a genome has one candidate, so that every pose
    that is tried counts.
    """

    _frontier: Frontier

    def __init__(self, spec: RunSpec, space: SearchSpace) -> None:
        first = spec.first_weights or NO_WEIGHTS
        self._spec = spec
        self._space = space
        self._counts_all = spec.overlaps == "count"
        self._within = space.distances if self._counts_all else ANYWHERE
        self._frontier = Frontier(space.box, space.distances[1], self._within, first)
        self._elites = EliteStore(self._frontier.size, space.approach_axis, posture_genes(space))
        self._threshold = ValueThreshold(WANTED, LEAST_SHARE)
        self._open: dict[int, Floats] = {}  # Features of the cells that generations not told yet aim at
        self._candidates = 1 if self._counts_all else MOST_CANDIDATES
        self._asked = 0
        self._qualities = quality_measure(spec, space)
        self._model = ValueModel(first)

    @property
    def models(self) -> dict[str, LogisticRegression]:
        """Its models, by their names in `FirstWeights`."""
        model, frontier = self._model, self._frontier
        each = (model.touch, model.quality, frontier.touch, frontier.quality)
        return dict(zip(STARTS, each, strict=True))

    def tell(self, generation: int, rows: Rows) -> None:
        """Learn from reached cells, dead ends and the features of simulated poses."""
        is_simulated = rows["outcome"] >= Outcome.MISSED
        is_success = rows["outcome"] >= Outcome.DROPPED
        is_told, quality = is_simulated | self._counts_all, np.zeros(len(rows))
        quality[is_success] = self._qualities(rows[is_success])
        self._learn_cells(generation, rows, is_told, quality)
        self._frontier.count_dead_ends(self._aimed_at(rows["genome"][~is_simulated]))
        self._succeed(rows[is_success], quality[is_success])
        self._model.learn(rows[is_simulated], quality[is_simulated])
        self._threshold.update(is_told)

    def _learn_cells(self, generation: int, rows: Rows, is_told: NDArray[np.bool_], quality: Floats) -> None:
        """Learn from a generation's tries at cells, those that count, with their quality (n,)."""
        features = self._open.pop(generation)
        told = is_told[: len(features)].nonzero()[0]
        is_success = rows["outcome"][told] >= Outcome.DROPPED
        self._frontier.learn_quality(features[told], is_success, quality[told])

    def _succeed(self, successes: Rows, quality: Floats) -> None:
        """Learn from successes of `quality` (n,); those outside the box are ignored."""
        places = self._frontier.places(successes["descriptor"][:, :3])
        (inside,) = np.nonzero(places >= 0)
        successes, places, quality = successes[inside], places[inside], quality[inside]
        self._frontier.add_grasps(places, successes["surface_point"].astype(np.float64), quality)
        is_graded = self._spec.aim_for == "hold"
        ranks = outcome_ranks(successes) if is_graded else Outcome.DROPPED + GRADES * quality
        self._offer(places, successes, quality, ranks)

    def _offer(self, places: Places, successes: Rows, quality: Floats, ranks: Floats) -> None:
        """Offer successes (n,) in cells `places` (n,) to the elites."""
        self._elites.offer(places, successes, ranks)

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
        return self._frontier.best(n, generator)

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
        preference = self._preference(options, self._frontier.centres(targets)[:, None], generator)
        parents: Places = options[np.arange(len(targets)), preference.argmax(axis=1)]
        return parents

    def _preference(self, options: Places, centres: Floats, generator: np.random.Generator) -> Floats:
        """Return the preference (n, ...) of elites for cells; at no wanted distance at most 0."""
        preference = self._elites.preference(options, generator)
        least, greatest = self._within
        distances = self._elites.distances(options, centres)
        is_near = (distances >= least) & (distances <= greatest)
        return np.where(is_near, preference, np.minimum(preference, 0.0))

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
            return np.zeros((len(wanted), RANKING_GENES))
        return self._model.ranking(wanted)

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
