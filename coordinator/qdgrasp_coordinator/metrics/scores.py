"""Scores of successes over their trials, and the order of grasps from the best to the worst.

Where the evaluation protocol has trials, the score of a success is the sum of their fitness; elsewhere it is
the nominal fitness. Over all disturbances it is eta, the estimated probability that the grasp transfers
(Huber et al. 2024, appendix B: 100 trials of two shakes, so it is the sum over 200; trials of `physical` have
six forces each).
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.scene import SceneObject
from qdgrasp_coordinator.metrics.arrays import join_rows, take_rows
from qdgrasp_coordinator.metrics.grasp_quality import recorded_margins
from qdgrasp_coordinator.metrics.run_stats import success_mask, successes
from qdgrasp_protocol.rows import SHAKES, Outcome, Rows
from qdgrasp_protocol.spec import RunSpec

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

    def eta(self, scores: NDArray[np.number]) -> Floats:
        """Return eta, 0 to 1, of scores (n,)."""
        return scores.astype(np.float64) / (self.disturbances * max(1, self.trials))


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


class TrialSums:
    """Sums up the trials of each success while the blocks of a journal pass in order."""

    # A journal has the trials of successes in the order of these, and as many of each: so the trials of the
    # n-th success of a run are the n-th piece of all its trials.

    def __init__(self, plan: TrialPlan) -> None:
        self._trials = plan.trials
        self._waiting: Rows | None = None  # Successes whose trials are not all there, in journal order
        self._fitness = np.zeros(0, np.float32)  # Of the trials of the first of them

    def take(self, rows: Rows) -> Rows:
        """Return the nominal successes (n,) whose last trial is among these rows, in journal order.

        Their `fitness` is the score, their `trial` the number of trials. Where the protocol has no trials
        they are those among the rows, with their fitness.
        """
        found = successes(rows)
        if not self._trials:
            return found
        every = found if self._waiting is None else join_rows([self._waiting, found])
        fitness = np.concatenate([self._fitness, rows["fitness"][rows["trial"] > 0]])
        n = len(fitness) // self._trials
        scored, self._waiting = take_rows(every, np.s_[:n]), take_rows(every, np.s_[n:])
        scored["fitness"], scored["trial"] = _sums(fitness, self._trials), self._trials
        self._fitness = fitness[n * self._trials :]
        return scored


def _sums(fitness: NDArray[np.float32], trials: int) -> Floats:
    """Return the sums over each whole piece of so many trials: (n,)."""
    n = len(fitness) // trials
    return np.asarray(fitness[: n * trials].reshape(n, trials).sum(axis=1, dtype=np.float64))


def scored_successes(blocks: Iterable[Rows], plan: TrialPlan) -> Iterator[Rows]:
    """The scored successes of a journal, some at a time; see `TrialSums.take`."""
    return map(TrialSums(plan).take, blocks)


def known_scores(rows: Rows, plan: TrialPlan) -> tuple[Floats, NDArray[np.int64]]:
    """Return scores and numbers of trials of the nominal successes among rows: (n,).

    The rows are consecutive ones of a journal that may begin anywhere. NaN where trials are missing among
    them. Where the protocol has no trials, scores are fitness, and trials 0.
    """
    found = successes(rows)
    if not plan.trials or not len(found):
        return found["fitness"].astype(np.float64), np.zeros(len(found), np.int64)
    # Trials of successes before these have lower numbers.
    is_trial = (rows["trial"] > 0) & (genome_numbers(rows) >= genome_numbers(found)[0])
    fitness, scores = rows["fitness"][is_trial], np.full(len(found), np.nan)
    sums = _sums(fitness, plan.trials)
    scores[: len(sums)] = sums
    return scores, np.clip(len(fitness) - plan.trials * np.arange(len(found)), 0, plan.trials)


def nominal_scores(journal: Rows, plan: TrialPlan) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return scores and numbers of trials of the nominal rows of a journal: (n,).

    Both are 0 for what is no success.
    """
    is_success = success_mask(journal)[journal["trial"] == 0]
    scores, counts = np.zeros(len(is_success)), np.zeros(len(is_success), np.int64)
    found, counts[is_success] = known_scores(journal, plan)
    scores[is_success] = np.nan_to_num(found)
    return scores, counts


def genome_numbers(rows: Rows) -> NDArray[np.uint64]:
    """One number for the genome of each row, ascending in the journal of one run: (n,)."""
    numbers: NDArray[np.uint64] = (rows["generation"].astype(np.uint64) << np.uint64(32)) | rows["index"]
    return numbers


def best_first(
    rows: Rows, body: SceneObject, most: int, scores: NDArray[np.floating] | None = None
) -> NDArray[np.int64]:
    """The places (n,) of nominal rows on an object; the first `most` are the best ones.

    One row is better than another with a greater score (n,); of equals with a greater fitness; of equals with
    a greater margin, which says more of a grasp than its penetration (docs/coverage.md, "Margin of a grasp");
    of equals with less penetration; of equals with more contacts; of equals the earlier one in the journal. A
    score or margin that is not known is worse than any. Margins take some milliseconds each: they are
    computed where they decide.
    """
    known = np.zeros(len(rows)) if scores is None else np.nan_to_num(scores, nan=-1.0)
    order, margins = np.lexsort((-rows["fitness"], -known)), np.full(len(rows), -1.0)
    if len(rows):
        last = order[min(most, len(rows)) - 1]
        ahead = (known > known[last]) | ((known == known[last]) & (rows["fitness"] >= rows["fitness"][last]))
        margins[ahead] = np.nan_to_num(recorded_margins(rows[ahead], body), nan=-1.0)
    elder_last, contacts = (rows["index"], rows["generation"]), rows["contacts"].astype(np.int64)
    return np.lexsort((*elder_last, -contacts, rows["penetration"], -margins, -rows["fitness"], -known))
