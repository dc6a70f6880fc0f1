"""The successes of a run with their scores, and the order of grasps by quality.

Where the evaluation protocol has trials, the score of a success is the sum of their fitness; elsewhere it is
the nominal fitness. Over all disturbances it is eta, the estimated probability that the grasp transfers
(Huber et al. 2024, appendix B: 100 trials of two shakes, so it is the sum over 200; trials of `physical` have
six forces each). Trials after the hundredth are harder: they order grasps of equal eta.

Everything that looks at what a run found reads it by `find_successes`, in one pass over its journal.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_coordinator.metrics.arrays import join_rows, take_rows
from qdgrasp_coordinator.metrics.grasp_quality import object_motion
from qdgrasp_coordinator.metrics.run_stats import evaluation_mask
from qdgrasp_protocol.rows import SHAKES, TRIALS, Outcome, Rows
from qdgrasp_protocol.spec import Overlaps, RunSpec

ROBUST = Outcome.HELD - Outcome.DROPPED  # Survival of what is held, and its entry in reference sets

Z = 1.64
"""Quantile of the bounds of eta: 95 in 100 etas are above the lower one."""
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TrialPlan:
    """Trials of the successes of a run."""

    trials: int = 0
    """Trials of each success; 0: the protocol has none."""
    disturbances: int = SHAKES
    """Disturbances in each trial."""

    @classmethod
    def of(cls, spec: RunSpec) -> Self:
        """Return the plan of a spec."""
        return cls(spec.trial_count, spec.disturbances)

    @property
    def usual(self) -> int:
        """Trials that eta is of; those after them are the harder ones."""
        return min(self.trials, TRIALS)

    def eta(self, scores: NDArray[np.number]) -> Floats:
        """Return eta, 0 to 1, of scores (n,)."""
        return scores.astype(np.float64) / (self.disturbances * max(1, self.usual))


NO_TRIALS = TrialPlan()


def eta_bounds(etas: Floats, counts: NDArray[np.integer]) -> tuple[Floats, Floats]:
    """Return the lower and upper bound (n,) of etas (n,) over so many trials (n,), at least 1.

    Wilson's interval (1927) for n draws of 0 or 1; a trial's share varies no more than these.
    """
    n = counts.astype(np.float64)
    middle = etas + Z * Z / (2.0 * n)
    width = Z * np.sqrt(etas * (1.0 - etas) / n + Z * Z / (4.0 * n * n))
    scale = 1.0 + Z * Z / n
    # Of an eta of 0 or 1 rounding may put a bound on its other side.
    return np.minimum((middle - width) / scale, etas), np.maximum((middle + width) / scale, etas)


def eta_error(etas: Floats, counts: NDArray[np.integer]) -> Floats:
    """Return a bound of the standard error (n,) of etas (n,) over so many trials (n,).

    sqrt(eta (1 - eta) / (n - 1)): no share between 0 and 1 of that mean varies more. It is 0 where all trials
    agree, few or many. NaN for fewer than two.
    """
    n = np.where(counts > 1, counts, np.nan)
    return np.asarray(np.sqrt(etas * (1.0 - etas) / (n - 1.0)))


def survival(rows: Rows) -> NDArray[np.uint8]:
    """Return for successes (n,) 0: no disturbance was survived, 1: some were, 2: all."""
    return np.asarray(rows["outcome"] - np.uint8(Outcome.DROPPED))


COLUMNS = ("numbers", "evaluations", "scores", "trials", "eta_hard")  # Of successes, beside their rows


@dataclass(frozen=True)
class Successes:
    """Nominal rows of a run in journal order: its successes, or all of at least some outcome."""

    numbers: NDArray[np.int64]
    """(n,): their numbers in the journal."""
    rows: Rows
    """(n,): all columns."""
    evaluations: NDArray[np.int64]
    """(n,): counted evaluations so far, itself included."""
    scores: Floats
    """(n,): the fitness that a search is told; NaN while trials are missing."""
    trials: NDArray[np.int64]
    """(n,): their trials that are recorded, without the harder ones."""
    eta_hard: Floats
    """(n,): share of disturbances survived in the harder trials; NaN where there are none."""
    stop: int
    """Number of the row from which to read on: the first whose trials are missing, if there is one."""

    def __len__(self) -> int:
        return len(self.numbers)

    def __getitem__(self, chosen: Any) -> "Successes":
        """Return those at some places, given by any index of an array."""
        columns = {name: getattr(self, name)[chosen] for name in COLUMNS}
        return replace(self, rows=take_rows(self.rows, chosen), **columns)

    @property
    def scored(self) -> Rows:
        """The rows (m,) whose trials are all recorded, as the search is told them.

        Their `fitness` is the score, their `trial` the number of trials.
        """
        is_known = ~np.isnan(self.scores)
        rows = take_rows(self.rows, is_known)
        rows["fitness"], rows["trial"] = self.scores[is_known], self.trials[is_known]
        return rows


def join_successes(parts: Sequence[Successes]) -> Successes:
    """Join successes of one run, of one part at least, one behind the other."""
    if len(parts) == 1:
        return parts[0]
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in COLUMNS
    }
    return replace(parts[-1], rows=join_rows([part.rows for part in parts]), **columns)


def find_successes(
    blocks: Iterable[Rows],
    plan: TrialPlan = NO_TRIALS,
    overlaps: Overlaps = "count",
    *,
    least: Outcome = Outcome.DROPPED,
    first: int = 0,
) -> Iterator[Successes]:
    """Yield the nominal rows of at least an outcome, some at a time, with their scores.

    `blocks` are the rows of a journal in order, from number `first` on. A success is yielded once all of its
    trials have passed; at the end come those that lack some.
    """
    # A journal has the trials of successes in the order of these, and as many of each: so those of the n-th
    # success are the n-th piece of all trials. Trials of successes before `first` have lower genome numbers.
    waiting: Successes | None = None
    fitness = np.zeros(0, np.float32)  # Of the trials of those that wait
    number, counted = first, 0
    for block in blocks:
        evaluations = counted + np.cumsum(evaluation_mask(block, overlaps))
        places = np.flatnonzero((block["trial"] == 0) & (block["outcome"] >= least))
        found = _unscored(number + places, take_rows(block, places), evaluations[places])
        number, counted = number + len(block), int(evaluations.max(initial=counted))
        waiting = join_successes([waiting, found]) if waiting is not None and len(waiting) else found
        is_trial = block["trial"] > 0
        if first > 0 and is_trial.any():
            ours = waiting.rows[_is_success(waiting.rows)]
            is_trial &= genome_numbers(block) >= genome_numbers(ours)[0] if len(ours) else False
        fitness = np.concatenate([fitness, block["fitness"][is_trial]])
        n = len(fitness) // plan.trials if plan.trials else len(waiting)
        lacking = np.flatnonzero(_is_success(waiting.rows))[n:] if plan.trials else np.zeros(0, np.intp)
        end = int(lacking[0]) if len(lacking) else len(waiting)
        stop = int(waiting.numbers[end]) if len(lacking) else number
        yield _scored(waiting[:end], fitness, plan, stop)
        waiting, fitness = waiting[end:], fitness[n * plan.trials :]
    if waiting is not None and len(waiting):
        yield _scored(waiting, fitness, plan, int(waiting.numbers[0]))


def all_successes(
    rows: Rows, plan: TrialPlan = NO_TRIALS, overlaps: Overlaps = "count", least: Outcome = Outcome.DROPPED
) -> Successes:
    """Return those among all rows of a run in memory; see `find_successes`."""
    return join_successes(list(find_successes([rows], plan, overlaps, least=least)))


def _is_success(rows: Rows) -> NDArray[np.bool_]:
    return np.asarray(rows["outcome"] >= Outcome.DROPPED)


def _unscored(numbers: NDArray[np.int64], rows: Rows, evaluations: NDArray[np.int64]) -> Successes:
    zeros, unknown = np.zeros(len(rows)), np.full(len(rows), np.nan)
    return Successes(numbers, rows, evaluations, zeros, zeros.astype(np.int64), unknown, 0)


def _scored(found: Successes, fitness: NDArray[np.float32], plan: TrialPlan, stop: int) -> Successes:
    """Return rows with the scores of their trials' fitness, in order; what is no success has 0."""
    is_success, scores, trials = _is_success(found.rows), np.zeros(len(found)), found.trials.copy()
    if not plan.trials:
        scores[is_success] = found.rows["fitness"][is_success]
        return replace(found, scores=scores, stop=stop)
    n = int(np.count_nonzero(is_success))
    trials[is_success] = np.clip(len(fitness) - plan.trials * np.arange(n), 0, plan.usual)
    whole = min(n, len(fitness) // plan.trials)
    each = fitness[: whole * plan.trials].reshape(-1, plan.trials).astype(np.float64)
    places, hard = np.flatnonzero(is_success), found.eta_hard.copy()
    scores[places], scores[places[:whole]] = np.nan, each[:, : plan.usual].sum(axis=1)
    if plan.trials > plan.usual:
        hard[places[:whole]] = each[:, plan.usual :].mean(axis=1) / plan.disturbances
    return replace(found, scores=scores, trials=trials, eta_hard=hard, stop=stop)


def genome_numbers(rows: Rows) -> NDArray[np.uint64]:
    """One number for the genome of each row, ascending in the journal of one run: (n,)."""
    return np.asarray((rows["generation"].astype(np.uint64) << np.uint64(32)) | rows["index"])


def best_first(rows: Rows, scores: ArrayLike = 0.0, eta_hard: ArrayLike = np.nan) -> NDArray[np.int64]:
    """The places (n,) of nominal rows, the best first.

    By greater score (n,), then greater `eta_hard` (n,), greater fitness, less motion of the object while the
    hand closed, less penetration, more contacts, earlier row; what is not known is worse than any. The margin
    of contacts ranks no better than chance, and has no part (docs/results.md).
    """
    known, hard = (np.full(len(rows), np.nan_to_num(each, nan=-1.0)) for each in (scores, eta_hard))
    motion = np.nan_to_num(object_motion(rows)[:, 0], nan=np.inf)
    elder_last, contacts = (rows["index"], rows["generation"]), rows["contacts"].astype(np.int64)
    return np.lexsort((*elder_last, -contacts, rows["penetration"], motion, -rows["fitness"], -hard, -known))
