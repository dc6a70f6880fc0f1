"""The search that aims at value: at cells that may gain most, with the best candidates.

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
from functools import partial

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.genes import RANKING_GENES, STEEPEST_VALUE, TOUCH_VALUE, VALUE_FEATURES, VALUED
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_coordinator.metrics.grasp_quality import recorded_margins
from qdgrasp_coordinator.search.aimed import AimedSearch
from qdgrasp_coordinator.search.archive import PositionBox
from qdgrasp_coordinator.search.base import SearchSpace
from qdgrasp_coordinator.search.frontier import ANYWHERE, NEIGHBOURS, Frontier, Places, outcome_ranks
from qdgrasp_coordinator.search.success_model import WEIGHT_GRAIN, LogisticRegression, ValueThreshold
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import FirstWeights, RunSpec, Weights

FIRST_TOUCH_WEIGHTS = (1.0, -5.0, 3.0, 0.0, 1.0, 2.0)
"""Weights of a cell's features for P(touch) before the first fit."""
FIRST_QUALITY_WEIGHTS = (0.0, 0.0, 0.0, 3.0, -0.5, -1.0)
"""The same for the quality of a grasp that touches."""
STARTS = {
    "touch": (0.0,) * len(VALUE_FEATURES),
    "quality": (0.0,) * len(VALUE_FEATURES),
    "cell_touch": FIRST_TOUCH_WEIGHTS,
    "cell_quality": FIRST_QUALITY_WEIGHTS,
}
"""First weights of models, by their names in `FirstWeights`, where a spec has none for them."""
DOUBT_INTERVAL = 64
"""Examples between two fits of a model that begins with weights of other runs, which may mislead."""
WANTED = 0.5  # Value demanded of a cell's first candidates
LEAST_SHARE = 0.25  # Share of genomes below which less is demanded: 0.1 cost twice the genomes on the drill
GRADES = float(Outcome.HELD - Outcome.DROPPED)  # Outcomes between the worst and the best success
FULL_ETAS = {"paper": 0.3, "physical": 1.0}
"""Eta of quality 1 by base: of `paper`'s trials most are lost before the hand closes, so that 0.3 is rare."""
FULL_MARGIN = 0.1  # Ferrari-Canny margin of quality 1; of the Panda on cube and mug 99 in 100 are below 0.07
BLOCK = np.concatenate([NEIGHBOURS, np.zeros((1, 3), np.int64)])  # Steps to a cell's neighbours and itself
FULL_QUALITY = 0.9  # Quality from which a cell's possible gain is not worth a try
QUALITY_GRAIN = 1024
"""Qualities are whole multiples of 1 / GRAIN: the last bits of a margin hardly ever reach a genome."""

NO_WEIGHTS = FirstWeights()


def check_first_weights(spec: RunSpec) -> None:
    """Check that the weights which a spec begins with fit the models, in whole grains."""
    for name, weights in msgspec.structs.asdict(spec.first_weights or NO_WEIGHTS).items():
        key, n = f"first_weights.{name}", len(STARTS[name])
        if weights is not None and len(weights) != n:
            raise ImpossibleValue(key, f"{len(weights)} of them", f"{n} numbers, one for each feature")
        grains = WEIGHT_GRAIN * np.asarray(weights or (), np.float64)
        if not ((np.abs(grains) <= WEIGHT_GRAIN * STEEPEST_VALUE) & (grains == np.rint(grains))).all():
            expected = f"multiples of 1/{WEIGHT_GRAIN} from {-STEEPEST_VALUE:g} to {STEEPEST_VALUE:g}"
            raise ImpossibleValue(key, weights, expected)


def first_model(name: str, first: Weights | None, *, own_units: bool = False) -> LogisticRegression:
    """Return a model that begins with weights of other runs; None: with its own in `STARTS`."""
    if first is None:
        return LogisticRegression(STARTS[name], own_units=own_units)
    return LogisticRegression(first, own_units=own_units, interval=DOUBT_INTERVAL)


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


class ValueFrontier(Frontier):
    """Cells beside successes and those of successes, with the best quality of each."""

    def __init__(
        self,
        box: PositionBox,
        reach: float,
        within: tuple[float, float] = ANYWHERE,
        first: FirstWeights = NO_WEIGHTS,
    ) -> None:
        super().__init__(box, reach, within)
        self._touch = first_model("cell_touch", first.cell_touch)
        self._quality = first_model("cell_quality", first.cell_quality)
        self._best = np.zeros(self.size)
        self._best_around = np.zeros(self.size)
        self._is_known = np.zeros(self.size, np.bool_)

    def add_grasps(self, places: Places, contacts: Floats, quality: Floats) -> None:
        """Record successes in `places` (n,), repeated in any order, at `contacts` (n, 3) [m]."""
        new, first = np.unique(places, return_index=True)
        is_new = ~self.successful[new]
        self._open_cells(new[is_new], contacts[first[is_new]])
        before = self._best[new]
        np.maximum.at(self._best, places, quality)
        gain = self._best[new] - before
        np.add.at(self._best_around, self.around(new).ravel(), np.repeat(gain, len(NEIGHBOURS)))
        self.edge = self.edge[self._is_open(self.edge)]

    def _is_open(self, places: Places) -> NDArray[np.bool_]:
        """Return which of `places` (n,) may still gain something."""
        is_open: NDArray[np.bool_] = self._best[places] < FULL_QUALITY
        return is_open

    def _open_cells(self, new: Places, contacts: Floats) -> None:
        """Add distinct cells with their first success, and those around them, to the edge."""
        self.successful[new] = True
        around = self.around(new)
        np.add.at(self._neighbours, around.ravel(), 1)
        block = self.block(new)
        self._keep_distances(block, contacts)
        reached = block.ravel()
        fresh = np.unique(reached[~self._is_known[reached] & self._inside[reached]])
        self._is_known[fresh] = True
        self.edge = np.concatenate([self.edge, fresh])

    def features(self, places: Places) -> Floats:
        """Return the features (n, 6) of cells (n,), known before they are tried.

        The distance to the nearest contact point in units of the hand's reach, its square, the share of
        successful neighbours, the mean of the neighbours' best qualities, whether it has a success, and 1.
        """
        distances = np.minimum(self._distances[places].astype(np.float64) / self._reach, 2.0)
        return np.stack(
            [
                distances,
                distances * distances,
                self._neighbours[places] / len(NEIGHBOURS),
                self._best_around[places] / len(NEIGHBOURS),
                self.successful[places],
                np.ones(len(places)),
            ],
            axis=1,
        )

    def learn_quality(self, features: Floats, is_success: NDArray[np.bool_], quality: Floats) -> None:
        """Learn from tries in cells with such `features` (n, 6) when they were aimed at."""
        self._touch.learn(features, is_success)
        self._quality.learn(features[is_success], quality[is_success])

    def worth(self, places: Places) -> Floats:
        """Return the expected gain of a try in each of `places` (n,), over the tries spent there.

        A success of expected quality q raises a best of b by at most q (1 - b): exactly that, where a quality
        is 0 or 1.
        """
        features = self.features(places)
        touch = TOUCH_VALUE * (1.0 - features[:, 4])
        gain = self._quality.likely(features) * (1.0 - self._best[places])
        value = self._touch.likely(features) * (touch + (1.0 - TOUCH_VALUE) * gain)
        worth: Floats = value / (self.spent(places) + 1.0)
        return worth


class ValueModel:
    """The models that rank candidates, by the features that the prior `valued` gives of a pose."""

    def __init__(self, first: FirstWeights = NO_WEIGHTS) -> None:
        self._touch = first_model("touch", first.touch, own_units=True)
        self._quality = first_model("quality", first.quality, own_units=True)

    def ranking(self, wanted: Floats) -> Floats:
        """Return weights of both models, and the value wanted of candidates: (n, w).

        All are zero before the first fit, unless the spec has weights of other runs.
        """
        weights = np.zeros((len(wanted), RANKING_GENES[VALUED]))
        if self._touch.weights.any():
            both = np.concatenate([self._touch.weights, self._quality.weights])
            weights[:, :-1] = np.clip(both, -STEEPEST_VALUE, STEEPEST_VALUE)
            weights[:, -1] = wanted
        return weights

    def learn(self, simulated: Rows, quality: Floats) -> None:
        """Learn from rows that were simulated, and the quality (n,) of those that are successes."""
        features = simulated["descriptor"][:, 3:].astype(np.float64)
        is_success = simulated["outcome"] >= Outcome.DROPPED
        self._touch.learn(features, is_success)
        self._quality.learn(features[is_success], quality[is_success])


class ValueSearch(AimedSearch):
    """Aims at cells whose best grasp may be beaten, empty ones included."""

    _frontier: ValueFrontier

    def __init__(self, spec: RunSpec, space: SearchSpace) -> None:
        first = spec.first_weights or NO_WEIGHTS
        frontier = partial(ValueFrontier, first=first)
        super().__init__(spec, space, frontier, ValueThreshold(WANTED, LEAST_SHARE))
        self._qualities = quality_measure(spec, space)
        self._model = ValueModel(first)

    @property
    def models(self) -> dict[str, LogisticRegression]:
        """Its models, by their names in `FirstWeights`."""
        model, frontier = self._model, self._frontier
        each = (model._touch, model._quality, frontier._touch, frontier._quality)
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

    def _choose_cells(self, generation: int, n: int, generator: np.random.Generator) -> Places:
        """The open cells that are worth most."""
        return self._frontier.best(n, generator)

    def _ranking(self, wanted: Floats) -> Floats:
        """Weights of the models of value."""
        return self._model.ranking(wanted)
