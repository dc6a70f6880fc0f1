"""The search that fills cells with grasps of several kinds.

Hands in one cell may look elsewhere, be rolled, or close other fingers. A grasp's *kind* is its orientation
bin, with the diversity `posture` its synergy too; a cell and a kind are a niche. A cell stays open until it
holds a given number of kinds of full quality, and a new kind in it is worth as much as a new cell. The models
of cells learn the gain of a try: a touch of a known kind that is no better gains nothing. The tries in a cell
are weighed against its gains, so that its successes do not count against it.

The kind of a try is known before it is simulated, but for the scatter of its candidates: it follows from the
cell's middle, the contact point and the roll. So of the grasps in and around a cell, as they are and rolled
on, one is followed whose kind the cell does not hold yet; one more model chooses among them.
"""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.genes import TOUCH_VALUE
from qdgrasp_assets.geometry.rotation import Floats, conjugate, from_frame, multiply, tangents, turned
from qdgrasp_assets.scene import Vector
from qdgrasp_coordinator.metrics.cells import BINS, GenomeReader, clear_orientations, orientations
from qdgrasp_coordinator.search.base import PositionBox, SearchSpace, keyed_generator
from qdgrasp_coordinator.search.frontier import (
    ANYWHERE,
    FULL_QUALITY,
    NEIGHBOURS,
    EliteStore,
    Frontier,
    Places,
)
from qdgrasp_coordinator.search.success_model import (
    FIRST_QUALITY_WEIGHTS,
    FIRST_TOUCH_WEIGHTS,
    LogisticRegression,
)
from qdgrasp_coordinator.search.value_search import AimedGrasps, ValueSearch, directions, posture_genes
from qdgrasp_protocol.rows import NO_SYNERGY, Outcome, Rows
from qdgrasp_protocol.spec import RunSpec

Kinds = NDArray[np.int64]  # (n,): orientation bins, plus 60 times synergy labels from 0
Niches = NDArray[np.int64]  # (n,): niches of a store, from 0 in the order of discovery
MANY_KINDS = 8.0  # Unit of the numbers of kinds among features
FIRST_KIND_WEIGHTS = (0.0, 0.0)  # Weights of the features of kinds before the first fit
NO_NICHE = -1
FIRST_CAPACITY = 256  # Initial capacity for niches; it doubles as needed
PARENTS = 8  # Most grasps around a cell that may be followed there
TURNS = np.arange(12) * (np.pi / 6.0)  # Rolls by which a grasp is turned [rad]
FIRST_OPTION_WEIGHTS = (2.0, 0.5, 1.0, 0.5, 0.0, 0.0, 0.0, 1.0, -2.0)
"""Weights of the features of an option before the first fit."""


class NicheFrontier(Frontier):
    """Cells in and beside those of successes, open until they hold `most` full kinds."""

    def __init__(
        self, box: PositionBox, reach: float, within: tuple[float, float] = ANYWHERE, most: int | None = None
    ) -> None:
        super().__init__(box, reach, within)
        first = (FIRST_TOUCH_WEIGHTS, FIRST_QUALITY_WEIGHTS)
        self.touch, self.quality = (LogisticRegression((*each, *FIRST_KIND_WEIGHTS)) for each in first)
        self._most = most or np.inf
        self._full = np.zeros(self.size, np.int32)  # Kinds of full quality in each cell
        self._given = np.zeros(self.size)  # The worth of all kinds of each cell
        self._given_around = np.zeros(self.size)

    def _is_open(self, places: Places) -> NDArray[np.bool_]:
        is_open: NDArray[np.bool_] = self._full[places] < self._most
        return is_open

    def add_gains(self, places: Places, gains: Floats, full: Places) -> None:
        """Record gains (n,) of worth in cells `places` (n,), which may repeat.

        `full` (m,) are the cells among them that have a new kind of full quality.
        """
        np.add.at(self._given, places, gains)
        np.add.at(self._given_around, self.around(places).ravel(), np.repeat(gains, len(NEIGHBOURS)))
        np.add.at(self._full, full, 1)
        self.edge = self.edge[self._is_open(self.edge)]

    def features(self, places: Places) -> Floats:
        """Return the features (n, 8) of cells (n,), known before they are tried.

        Six are those of `Frontier`. Two are the worth of the kinds in the cell, and of those in a
        neighbour, in the mean, over `MANY_KINDS`.
        """
        here = self._given[places] / MANY_KINDS
        around = self._given_around[places] / (len(NEIGHBOURS) * MANY_KINDS)
        return np.concatenate([super().features(places), np.stack([here, around], axis=1)], axis=1)

    def worth(self, places: Places) -> Floats:
        """Return the expected gain of a try in each of `places` (n,), by its tries and gains."""
        features = self.features(places)
        gain = TOUCH_VALUE + (1.0 - TOUCH_VALUE) * self.quality.likely(features)
        rate = (self._given[places] + 1.0) / (self.spent(places) + 1.0)
        worth: Floats = self.touch.likely(features) * gain * np.minimum(rate, 1.0)
        return worth


class NicheStore(EliteStore):
    """The best success of each kind in each place.

    Elites are of niches: a place of `EliteStore` is a niche here.
    """

    def __init__(self, places: int, axis: Vector, posture: int) -> None:
        super().__init__(FIRST_CAPACITY, axis, posture)
        self._youngest = np.full(places, NO_NICHE, np.int64)  # A place's last niche, linked to the others
        self._niches = np.zeros(
            FIRST_CAPACITY, [("place", "i8"), ("kind", "i8"), ("elder", "i8"), ("best", "f8")]
        )
        self._n = 0

    def find(self, places: Places, kinds: Kinds) -> Niches:
        """Return the niches (n,) of kinds (n,) in `places` (n,), `NO_NICHE` for a new one."""
        found = self._youngest[places]
        while (other := (found != NO_NICHE) & (self._niches["kind"][found] != kinds)).any():
            found[other] = self._niches["elder"][found[other]]
        return found

    def make(self, places: Places, kinds: Kinds) -> Niches:
        """Return the niches (n,) of kinds (n,) in `places` (n,); new ones are added."""
        (missing,) = np.nonzero(self.find(places, kinds) == NO_NICHE)
        for place, kind in dict.fromkeys(zip(places[missing].tolist(), kinds[missing].tolist(), strict=True)):
            if self._n == len(self._niches):
                self._niches = np.concatenate([self._niches, np.zeros_like(self._niches)])
                self._kept = np.concatenate([self._kept, self._room(len(self._kept), self._kept.dtype)])
            self._niches[self._n] = place, kind, self._youngest[place], 0.0
            self._youngest[place], self._n = self._n, self._n + 1
        return self.find(places, kinds)

    def kinds(self, niches: Niches) -> Kinds:
        """Return the kinds of niches (n,)."""
        return self._niches["kind"][niches]

    def places(self, niches: Niches) -> Places:
        """Return the places of niches (n,)."""
        return self._niches["place"][niches]

    def best(self, niches: Niches) -> Floats:
        """Return the best quality of each of `niches` (n,); -1 for a new one."""
        return np.where(niches == NO_NICHE, -1.0, self._niches["best"][niches])

    def raise_best(self, niches: Niches, quality: Floats) -> None:
        """Record grasps of `quality` (n,) in `niches` (n,), which may repeat."""
        np.maximum.at(self._niches["best"], niches, quality)

    def among(self, places: Places) -> tuple[NDArray[np.intp], Niches]:
        """Return all niches (m,) of `places` (n, k), each with its row."""
        rows, niches = [np.zeros(0, np.intp)], [np.zeros(0, np.int64)]
        row = np.repeat(np.arange(len(places)), places.shape[1])
        found = self._youngest[places.ravel()]
        while (is_there := found != NO_NICHE).any():
            row, found = row[is_there], found[is_there]
            rows.append(row)
            niches.append(found)
            found = self._niches["elder"][found]
        return np.concatenate(rows), np.concatenate(niches)


class KindReader:
    """Reads the kind of grasps, recorded or proposed."""

    def __init__(self, spec: RunSpec, space: SearchSpace) -> None:
        self._synergies = GenomeReader(space.layout) if spec.diversity == "posture" else None
        self._genes = len(space.layout)
        axis = np.array([space.approach_axis])
        self._from_rest = conjugate(from_frame(*tangents(axis), axis))

    def of_rows(self, rows: Rows) -> Kinds:
        """Return the kind (n,) of each row's pose."""
        return orientations(rows["base_to_object"][:, 3:]) + self._synergy(rows["genome"])

    def of_aims(self, ways: Floats, rolls: Floats, postures: Floats) -> tuple[Kinds, Floats]:
        """Return the kinds (n,) of proposed grasps, and their clearance from their bins' borders.

        They look along unit `ways` (n, 3) with rolls (n,) [rad] and genes of posture (n, k).
        """
        frames = from_frame(*turned(*tangents(ways), rolls), ways)
        rotations = multiply(frames, np.broadcast_to(self._from_rest, frames.shape))
        bins, clearness = clear_orientations(rotations)
        genomes = np.zeros((len(ways), self._genes), np.float32)
        genomes[:, self._genes - postures.shape[1] :] = postures
        return bins + self._synergy(genomes), clearness

    def _synergy(self, genomes: NDArray[np.float32]) -> NDArray[np.int64] | int:
        """Return the numbers that synergies of genomes (n, d) add to their kinds."""
        return 0 if self._synergies is None else BINS * (self._synergies.labels(genomes) - NO_SYNERGY)


class NicheSearch(ValueSearch):
    """Aims at cells that lack kinds, with grasps of these kinds from around them."""

    _frontier: NicheFrontier
    _elites: NicheStore

    def __init__(self, spec: RunSpec, space: SearchSpace) -> None:
        super().__init__(spec, space)
        most = spec.grasps_per_cell
        self._frontier = NicheFrontier(space.box, space.distances[1], self._within, most)
        self._elites = NicheStore(self._frontier.size, space.approach_axis, posture_genes(space))
        self._kinds = KindReader(spec, space)
        self._followed: dict[int, Floats] = {}  # Features of the options taken in generations not told yet
        self._wanted: dict[int, Niches] = {}  # A number for the cell and kind of each of them
        self._choice = LogisticRegression(FIRST_OPTION_WEIGHTS)

    def _learn_cells(self, generation: int, rows: Rows, is_told: NDArray[np.bool_], quality: Floats) -> None:
        """Learn from the gains of tries: a new kind, or a better grasp of its kind."""
        features, options = self._open.pop(generation), self._followed.pop(generation)
        del self._wanted[generation]
        n = len(features)
        gains = self._gains(rows[:n], quality[:n])
        (told,) = np.nonzero(is_told[:n])
        self._frontier.learn_quality(features[told], gains[told] > 0.0, quality[told])
        self._choice.learn(options, gains)

    def _gains(self, rows: Rows, quality: Floats) -> Floats:
        """Return the worth (n,) of each of `rows` (n,) beyond the best of its kind in its cell."""
        places = self._frontier.places(rows["descriptor"][:, :3])
        is_success = (rows["outcome"] >= Outcome.DROPPED) & (places >= 0)
        gains = np.zeros(len(rows))
        best = self._elites.best(self._elites.find(places[is_success], self._kinds.of_rows(rows[is_success])))
        gains[is_success] = np.maximum(worth_of(quality[is_success]) - worth_of(best), 0.0)
        return gains

    def _offer(self, places: Places, successes: Rows, quality: Floats, ranks: Floats) -> None:
        niches = self._elites.make(places, self._kinds.of_rows(successes))
        new, first = np.unique(niches, return_index=True)
        is_begun = self._elites.ranks(new) < 0.0
        before = np.where(is_begun, 0.0, worth_of(self._elites.best(new)))
        was_full = self._elites.best(new) >= FULL_QUALITY
        self._elites.raise_best(niches, quality)
        self._elites.offer(niches, successes, ranks)
        after, cells = self._elites.best(new), places[first]
        self._frontier.add_gains(cells, worth_of(after) - before, cells[~was_full & (after >= FULL_QUALITY)])

    def _aimed(self, targets: Places, generation: int) -> AimedGrasps:
        """Return grasps from around the cells `targets`, of kinds that these do not hold yet."""
        generator = keyed_generator(self._spec.seed, "parents", generation)
        rows, parents = (np.repeat(each, len(TURNS)) for each in self._parents_around(targets, generator))
        turns = np.tile(TURNS, len(parents) // len(TURNS))
        centres, contacts = self._frontier.centres(targets), self._elites.points(parents)
        ways = directions(centres[rows], contacts)
        rolls = self._elites.rolls(parents, ways) + turns
        postures = self._varied(self._elites.postures(parents), generator)
        kinds, clearness = self._kinds.of_aims(ways, rolls, postures)
        best = self._elites.best(self._elites.find(targets[rows], kinds))
        features = self._option_features(targets, rows, parents, kinds, turns, clearness)
        wanted = kinds * self._frontier.size + targets[rows]
        is_asked = np.isin(wanted, [each for asked in self._wanted.values() for each in asked.tolist()])
        chance = np.sqrt(np.sqrt(generator.random(len(rows))))
        score = np.where(is_asked, 0.0, self._choice.likely(features) * (1.0 - worth_of(best)) * chance)
        order = np.lexsort((-score, rows))
        _, first = np.unique(rows[order], return_index=True)
        chosen = order[first]
        self._followed[generation], self._wanted[generation] = features[chosen], wanted[chosen]
        rolls, postures = rolls[chosen] % (2.0 * np.pi), postures[chosen]
        return AimedGrasps(centres, contacts[chosen], rolls, np.zeros(len(targets)), postures)

    def _parents_around(
        self, targets: Places, generator: np.random.Generator
    ) -> tuple[NDArray[np.intp], Niches]:
        """Return at most `PARENTS` niches (m,) in and around each target, with the target's row."""
        rows, niches = self._elites.among(self._frontier.block(targets))
        preference = self._preference(niches, self._frontier.centres(targets)[rows], generator)
        order = np.lexsort((-preference, rows))
        rows, niches = rows[order], niches[order]
        _, first, counts = np.unique(rows, return_index=True, return_counts=True)
        is_kept = np.arange(len(rows)) - np.repeat(first, counts) < PARENTS
        return rows[is_kept], niches[is_kept]

    def _option_features(
        self,
        targets: Places,
        rows: NDArray[np.intp],
        parents: Niches,
        kinds: Kinds,
        turns: Floats,
        clearness: Floats,
    ) -> Floats:
        """Return the features (m, 9) of options: parents (m,), turned, for targets[rows].

        The share of neighbours that hold the kind, at full quality; the quality of the parent; cosines of
        once, twice and four times the turn; whether the parent is in the cell itself; the distance from the
        cell to the contact point in units of the hand's reach; the kind's clearance; 1.
        """
        around, niches = self._elites.among(self._frontier.around(targets))
        is_full = self._elites.best(niches) >= FULL_QUALITY
        span = 1 + max(int(kinds.max(initial=0)), int(self._elites.kinds(niches).max(initial=0)))
        held = np.bincount(
            around[is_full] * span + self._elites.kinds(niches[is_full]), minlength=span * len(targets)
        )
        distances = self._elites.distances(parents, self._frontier.centres(targets)[rows])
        return np.stack(
            [
                held[rows * span + kinds] / len(NEIGHBOURS),
                self._elites.best(parents),
                np.cos(turns),
                np.cos(2.0 * turns),
                np.cos(4.0 * turns),
                self._elites.places(parents) == targets[rows],
                distances / self._space.distances[1],
                clearness,
                np.ones(len(rows)),
            ],
            axis=1,
        )


def worth_of(best: Floats) -> Floats:
    """Return the worth (n,) of grasps of quality `best` (n,); 0 for -1, no grasp."""
    worth: Floats = np.where(best < 0.0, 0.0, TOUCH_VALUE + (1.0 - TOUCH_VALUE) * best)
    return worth
