"""A lot: evaluations of one search in one world, perhaps beside the public code's of the same genomes."""

import numpy as np
from numpy.typing import NDArray
from tests.benchmarks.measure import Figure, Meter
from tests.benchmarks.naive import Naive
from tests.benchmarks.stages import Profile

from qdgrasp_coordinator.dispatching.pace import BATCH_SECONDS, FIRST_ROWS
from qdgrasp_coordinator.searches.search import Search
from qdgrasp_protocol.genome import Genomes
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows
from qdgrasp_worker.evaluate import Evaluator
from qdgrasp_worker.serving.child import SLICE

WATCHED = 0.5
"""Time under a watch, as a share of the time without."""
DRAWS = 400
"""How often the batches are drawn anew, for the interval. Few poses take most of the time, so that all of
them are taken together, not round by round."""


class Lot:
    """What one search asks, evaluated in batches as large as a worker would get them."""

    def __init__(
        self,
        name: str,
        search: Search,
        prior: str,
        evaluator: Evaluator,
        naive: Naive | None = None,
        first: int = 0,
    ) -> None:
        self.name = name
        self._search = search
        self._prior = prior
        self._evaluator = evaluator
        self._naive = naive
        self._generation = first
        self._waiting = np.zeros((0, 0), np.float32)
        self._told: list[Rows] = []
        self._outcomes: list[NDArray[np.uint8]] = []
        self._profile = Profile()
        self._rows: list[int] = []
        self._own: list[float] = []
        self._other: list[float] = []
        """Of each batch: its rows, and what they took [s]."""
        self._watched = 0.0

    def skip(self, rows: int) -> "Lot":
        """Evaluate some genomes that are not counted."""
        for _ in range(0, rows, FIRST_ROWS):
            self._evaluate(self._next(FIRST_ROWS))
        return self

    def one(self, rows: int) -> int:
        """Evaluate one batch of so many rows, or fewer; how many that were."""
        genomes = self._next(rows)
        self._evaluate(genomes)
        return len(genomes)

    def measured(self, seconds: float) -> Figure:
        """Measure it for so long, the naive path's time included; and half of it once more, under a watch."""
        self._outcomes.clear()
        while sum(self._own) + sum(self._other) < seconds:
            self._measure(self._next(self._batch))
        rows, own, other = (np.array(column) for column in (self._rows, self._own, self._other))
        some = np.random.default_rng(0).integers(len(rows), size=(DRAWS, len(rows)))
        rates, times = (column[some].sum(axis=1) / own[some].sum(axis=1) for column in (rows, other))
        return Figure(
            self.name,
            sum(self._rows),
            sum(self._own),
            remark=self._remark,
            rates=tuple(rates.tolist()),
            published=tuple(times.tolist()) if self._naive else (),
            stages=self._profile.stages(1e6 * sum(self._own) / sum(self._rows)),
        )

    def _measure(self, genomes: Genomes) -> None:
        """Evaluate a batch; the naive path, and now and then we under a watch, do the same."""
        own, other, watched = Meter(), Meter(), Meter()
        with own.running():
            self._evaluate(genomes)
        if self._naive:
            with other.running():
                self._naive.evaluate(self._prior, genomes)
        if self._watched < WATCHED * (sum(self._own) + own.seconds):
            with watched.running(), self._profile.watching(len(genomes)):
                self._evaluated(genomes)
        self._watched += watched.seconds
        for column, value in (
            (self._rows, len(genomes)),
            (self._own, own.seconds),
            (self._other, other.seconds),
        ):
            column.append(value)

    @property
    def _batch(self) -> int:
        """Rows that the coordinator would lease, as far as the worker evaluates them at once."""
        if not self._rows:
            return FIRST_ROWS
        return max(1, min(SLICE, int(BATCH_SECONDS * sum(self._rows) / sum(self._own))))

    def _next(self, rows: int) -> Genomes:
        """The next genomes, at most so many; the search hears of a generation that is complete."""
        if not len(self._waiting):
            self._tell()
            self._waiting = self._search.ask(self._generation)
        genomes, self._waiting = self._waiting[:rows], self._waiting[rows:]
        return genomes

    def _evaluate(self, genomes: Genomes) -> None:
        self._told.append(self._evaluated(genomes))
        self._outcomes.append(self._told[-1]["outcome"])

    def _evaluated(self, genomes: Genomes) -> Rows:
        return self._evaluator.evaluate(self._prior, genomes, np.zeros(len(genomes), np.uint16)).rows

    def _tell(self) -> None:
        """Tell the search of the generation that is complete, if one is."""
        if not self._told:
            return
        rows = np.concatenate(self._told)
        rows["generation"], rows["index"] = self._generation, np.arange(len(rows))
        self._search.tell(self._generation, rows)
        self._generation += 1
        self._told.clear()

    @property
    def _remark(self) -> str:
        outcomes = np.concatenate(self._outcomes)
        overlaps, successes = (outcomes == Outcome.OVERLAP).mean(), (outcomes >= Outcome.DROPPED).mean()
        return (
            f"{overlaps:.0%} overlaps, {successes:.0%} successes; {self._profile.steps_each:.0f} steps, "
            f"{self._profile.step_share:.0%} of the time"
        )
