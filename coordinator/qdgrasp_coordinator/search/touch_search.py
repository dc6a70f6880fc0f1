"""The search that aims at touch: at empty cells beside successes.

Retries: a second try in a cell whose grasp is weak takes the best grasp from around the cell. Its probability
to give a robust one is about the share of the cell's 26 neighbours that hold one, corrected by the results of
tries so far. A robust grasp in place of a weak one adds no cell: it counts `RETRY_VALUE` of one, and is tried
where that is more than the recent gain of an evaluation at the frontier. So a search with a rich frontier
makes no such try.
"""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_coordinator.search.aimed import AimedSearch
from qdgrasp_coordinator.search.archive import PositionBox
from qdgrasp_coordinator.search.base import SearchSpace
from qdgrasp_coordinator.search.frontier import (
    ANYWHERE,
    NEIGHBOURS,
    EliteStore,
    Frontier,
    Places,
    outcome_ranks,
    select_top,
)
from qdgrasp_coordinator.search.success_model import CandidateRanker, LogisticRegression, ValueThreshold
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import RunSpec

FIRST_WEIGHTS = (1.0, -5.0, 3.0, 2.0)
"""Weights of `features` before the first fit, approximately those of finished runs of all hands."""


class TouchFrontier(Frontier):
    """The empty cells beside successes."""

    def __init__(self, box: PositionBox, reach: float, within: tuple[float, float] = ANYWHERE) -> None:
        super().__init__(box, reach, within)
        self._model = LogisticRegression(FIRST_WEIGHTS)

    def add_successes(self, places: Places, contacts: Floats) -> None:
        """Record successes in `places` (n,), in any order and repeated, at `contacts` (n, 3) [m]."""
        new, first = np.unique(places, return_index=True)
        is_new = ~self.successful[new]
        new, contacts = new[is_new], contacts[first[is_new]]
        if not len(new):
            return
        self.successful[new] = True
        self._keep_distances(self.around(new), contacts)
        around = self.around(new).ravel()
        touched = np.unique(around[(self._neighbours[around] == 0) & self._inside[around]])
        np.add.at(self._neighbours, around, 1)
        edge = np.concatenate([self.edge, touched])
        self.edge = edge[~self.successful[edge]]

    def features(self, places: Places) -> Floats:
        """Return the features (n, 4) of cells (n,) beside successes, known before they are tried.

        The distance in units of the hand's reach, its square, the share of successful neighbours, and 1.
        """
        distances = self._distances[places].astype(np.float64) / self._reach
        shares = self._neighbours[places] / len(NEIGHBOURS)
        return np.stack([distances, distances * distances, shares, np.ones(len(places))], axis=1)

    def learn(self, features: Floats, successes: NDArray[np.bool_]) -> None:
        """Learn from tries in cells with such `features` (n, 4) when they were aimed at."""
        self._model.learn(features, successes)

    def worth(self, places: Places) -> Floats:
        """Return the estimated worth of a try in each of `places` (n,), 0 to 1."""
        return self._model.likely(self.features(places)) / (self.spent(places) + 1.0)


RETRY_VALUE = 1 / 3  # Worth of a robust grasp in place of a weak one, relative to a success in an empty cell
RETRY_SHARE = 0.5  # Most retries in a generation, as a share of the tries that count at the frontier
PRIOR_PROMISES = 20.0  # Promised and given robust grasps that are assumed before the first try
FADING = 0.9  # Weight of an older generation against the next in the frontier's recent success rate
NO_PROMISES = np.zeros(0)


class RetryBudget:
    """Tries for better grasps in cells whose grasp is not robust."""

    def __init__(self, frontier: Frontier, elites: EliteStore) -> None:
        self._frontier = frontier
        self._elites = elites
        self._robust = np.zeros(frontier.size, np.bool_)
        self._around = np.zeros(frontier.size, np.uint8)
        """Number of neighbours of each cell that hold a robust grasp."""
        self._open: dict[int, Floats] = {}
        """Shares of robust neighbours for each try of the generations that are not told yet."""
        self._promised = self._given = PRIOR_PROMISES
        self._tries, self._successes = 1.0, 1.0
        """Recent tries and successes at the frontier; they begin with one try that succeeded."""

    def ask(self, generation: int, generator: np.random.Generator) -> Places:
        """The weak cells to try in a generation."""
        weak, most = self._elites.weak, int(RETRY_SHARE * (1.0 - FADING) * self._tries)
        weak = select_top(weak, self.worth(weak), most, generator)
        tries: Places = weak[RETRY_VALUE * self.worth(weak) > self._successes / self._tries]
        self._open[generation] = self._shares(tries)
        return tries

    def asked(self, generation: int) -> int:
        """The number of tries in a generation that is not told yet."""
        return len(self._open.get(generation, NO_PROMISES))

    def tell(self, generation: int, fresh: NDArray[np.bool_], again: NDArray[np.bool_]) -> None:
        """Learn from the results of a generation.

        `fresh` (n,): which of the tries in empty cells that count succeeded. `again` (m, 2): of rows that
        begin with the retries, which count, and which are robust grasps.
        """
        promised = self._open.pop(generation, NO_PROMISES)
        counts, is_robust = again[: len(promised)].T
        self._promised += float(promised[counts].sum())
        self._given += float(np.count_nonzero(is_robust & counts))
        self._tries = FADING * self._tries + len(fresh)
        self._successes = FADING * self._successes + float(np.count_nonzero(fresh))

    def add_robust(self, places: Places) -> None:
        """Record robust grasps in `places` (n,), in any order and repeated."""
        new = np.unique(places[~self._robust[places]])
        self._robust[new] = True
        np.add.at(self._around, self._frontier.around(new).ravel(), 1)

    def worth(self, places: Places) -> Floats:
        """Return the probability of a robust grasp in each of `places` (n,), over tries so far."""
        tries = np.maximum(self._frontier.spent(places), 1.0)
        return self._shares(places) * (self._given / self._promised) / tries

    def _shares(self, places: Places) -> Floats:
        return self._around[places] / len(NEIGHBOURS)


WANTED = 0.8  # Probability of success demanded of a cell's first candidates
LEAST_SHARE = 0.1  # Share of genomes below which less is demanded


class TouchSearch(AimedSearch):
    """Aims at cells that hold no success; a cell's first touch closes it."""

    _frontier: TouchFrontier

    def __init__(self, spec: RunSpec, space: SearchSpace) -> None:
        super().__init__(spec, space, TouchFrontier, ValueThreshold(WANTED, LEAST_SHARE))
        self._ranker = CandidateRanker()
        self._retries = RetryBudget(self._frontier, self._elites)

    def tell(self, generation: int, rows: Rows) -> None:
        """Learn from reached cells, dead ends and the features of simulated poses."""
        is_simulated = rows["outcome"] >= Outcome.MISSED
        is_success = rows["outcome"] >= Outcome.DROPPED
        features = self._open.pop(generation)
        is_told, n = is_simulated | self._counts_all, len(features) - self._retries.asked(generation)
        fresh, again = is_told[:n], np.stack([is_told, rows["outcome"] >= Outcome.HELD], axis=1)[n:]
        self._frontier.learn(features[:n][fresh], is_success[:n][fresh])
        self._retries.tell(generation, is_success[:n][fresh], again)
        self._frontier.count_dead_ends(self._aimed_at(rows["genome"][~is_simulated]))
        self._succeed(rows[is_success])
        self._ranker.learn(rows[is_simulated])
        self._threshold.update(is_told)

    def _succeed(self, successes: Rows) -> None:
        """Learn from successes; those outside the box are ignored."""
        places = self._frontier.places(successes["descriptor"][:, :3])
        successes, places = successes[places >= 0], places[places >= 0]
        self._frontier.add_successes(places, successes["surface_point"].astype(np.float64))
        self._elites.offer(places, successes, outcome_ranks(successes))
        self._retries.add_robust(places[successes["outcome"] >= Outcome.HELD])

    def _choose_cells(self, generation: int, n: int, generator: np.random.Generator) -> Places:
        """Empty cells, then those to try again."""
        best = self._frontier.best(n, generator)
        retries = self._retries.ask(generation, generator)
        left = max(0, min(len(best), n - len(retries)))
        return np.concatenate([self._frontier.best(left, generator, best), retries])

    def _ranking(self, wanted: Floats) -> Floats:
        """Weights of a score of the candidates."""
        return self._ranker.wanting(wanted)
