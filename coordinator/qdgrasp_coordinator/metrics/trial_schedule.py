"""Sequential trials: few for each success, more while it may still be the best of its group.

A success has the trials of the first stage, and those of a later one where it is promoted. The rule is a
race: when a stage of a generation is complete, a success is promoted if the upper bound of its eta reaches
the best other estimate in its group (Maron and Moore 1993, "Hoeffding races"; the bounds are Wilson 1927's).
Groups are 1 cm cells, in which the best success of earlier generations competes too, or, where so many
finalists are wanted, all successes. All of it is a fold over journal rows in their order: by generation,
within it the nominal rows by index, then stage by stage the trials by (index, trial).
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.cells import cell_keys, cells
from qdgrasp_protocol.rows import SHAKES, Outcome, Rows
from qdgrasp_protocol.spec import RunSpec

Z = 1.64
"""Quantile of the bounds of eta: 95 in 100 etas are below the upper one (docs/robust.md: what it costs)."""
Floats = NDArray[np.float64]
Places = NDArray[np.int64]


@dataclass(frozen=True)
class TrialPlan:
    """Numbers of trials of the successes of a run."""

    stages: tuple[int, ...] = ()
    """Trials of a success after each stage, ascending; none: the protocol has no trials."""
    disturbances: int = SHAKES
    """Disturbances in each trial."""
    finalists: int | None = None
    """Number of best successes that are wanted; None: the best of each 1 cm cell."""

    @classmethod
    def of(cls, spec: RunSpec) -> Self:
        """Return the plan of a spec."""
        return cls(spec.stages, spec.disturbances, spec.finalists)

    @property
    def least(self) -> int:
        """Trials that every success has."""
        return self.stages[0] if self.stages else 0

    @property
    def most(self) -> int:
        """Trials of a success that was always promoted; scores are sums over so many."""
        return self.stages[-1] if self.stages else 0

    def scores(self, sums: NDArray[np.number], counts: NDArray[np.integer]) -> Floats:
        """Return the scores (n,) of sums over so many trials, on the scale of `most`."""
        return np.asarray(sums.astype(np.float64) * self.most / np.maximum(counts, 1))

    def eta(self, scores: NDArray[np.number]) -> Floats:
        """Return eta, 0 to 1, of scores (n,)."""
        return scores.astype(np.float64) / (self.disturbances * max(1, self.most))


NO_TRIALS = TrialPlan()


def eta_bounds(etas: Floats, counts: NDArray[np.integer]) -> tuple[Floats, Floats]:
    """Return the lower and upper bound (n,) of etas (n,) over so many trials (n,), at least 1.

    Wilson's interval for n draws of 0 or 1; a trial's share, between 0 and 1, varies no more than these.
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


class TrialSchedule:
    """Decides how many trials each success has, while a run's rows pass in journal order."""

    def __init__(self, plan: TrialPlan) -> None:
        self._plan = plan
        self._leaders: dict[int, float] = {}
        """By cell, the best estimate of the generations before."""
        self._elders = np.zeros(0)
        """Where finalists are wanted: the best estimates of the generations before, at most so many."""
        self._begin()

    def _begin(self) -> None:
        """Begin a generation that has no success yet."""
        self._indices, self._cells = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._sums, self._counts = np.zeros(0), np.zeros(0, np.int64)
        self._stage = 0
        self._members: Places = np.zeros(0, np.int64)  # Of these successes, those with trials in this stage
        self._done = 0  # Trials of this stage that have passed

    @property
    def is_complete(self) -> bool:
        """True if no success lacks a trial."""
        return not len(self._indices)

    @property
    def promoted(self) -> Places:
        """Indices (n,), ascending, of successes with trials in the later stage under way."""
        return self._indices[self._members] if self._stage else np.zeros(0, np.int64)

    def count(self, rows: Rows) -> None:
        """Take the next rows."""
        while len(rows) and self._plan.stages:
            is_trial = rows["trial"] > 0
            if not is_trial[0]:
                n = int(is_trial.argmax()) if is_trial.any() else len(rows)
                self._add_successes(rows[:n])
            elif (n := min(self._missing, len(rows))) == 0:
                return  # trials that this plan does not have
            else:
                self._add_trials(rows["fitness"][:n])
            rows = rows[n:]

    def _add_successes(self, nominal: Rows) -> None:
        found = nominal[nominal["outcome"] >= Outcome.DROPPED]
        self._indices = np.concatenate([self._indices, found["index"].astype(np.int64)])
        reached = cell_keys(cells(found["descriptor"][:, :3]))
        self._cells = np.concatenate([self._cells, reached])
        self._members = np.arange(len(self._indices))
        self._sums, self._counts = np.zeros(len(self._indices)), np.zeros(len(self._indices), np.int64)

    @property
    def _size(self) -> int:
        """Trials of a success in this stage."""
        stages = (0, *self._plan.stages)
        return stages[self._stage + 1] - stages[self._stage]

    @property
    def _missing(self) -> int:
        return self._size * len(self._members) - self._done

    def _add_trials(self, fitness: NDArray[np.float32]) -> None:
        places = (self._done + np.arange(len(fitness))) // self._size
        np.add.at(self._sums, self._members[places], fitness)
        self._done += len(fitness)
        if not self._missing:
            self._end_stage()

    def _end_stage(self) -> None:
        self._counts[self._members] = self._plan.stages[self._stage]
        self._stage, self._done = self._stage + 1, 0
        if self._stage < len(self._plan.stages):
            self._members = self._members[self._may_be_best()[self._members]]
            if len(self._members):
                return
        self._end_generation()

    @property
    def _etas(self) -> Floats:
        return self._plan.eta(self._plan.scores(self._sums, self._counts))

    def _may_be_best(self) -> NDArray[np.bool_]:
        """Flag the successes (n,) whose upper bound reaches the estimate that they compete with."""
        etas = self._etas
        rivals = self._rivals_in_cells(etas) if self._plan.finalists is None else self._last_finalist(etas)
        return np.asarray(eta_bounds(etas, self._counts)[1] >= rivals)

    def _rivals_in_cells(self, etas: Floats) -> Floats:
        """Return the best other estimate in the cell of each success: (n,).

        It is infinite where there is no other.
        """
        known: dict[int, list[float]] = {}
        for cell, value in zip(self._cells.tolist(), etas.tolist(), strict=True):
            elder = [self._leaders[cell]] if cell in self._leaders else []
            known.setdefault(cell, elder).append(value)
        best = {cell: (*sorted(values, reverse=True), np.inf)[:2] for cell, values in known.items()}
        pairs = np.array([best[cell] for cell in self._cells.tolist()])
        return np.where(etas == pairs[:, 0], pairs[:, 1], pairs[:, 0])

    def _last_finalist(self, etas: Floats) -> float:
        """Return the least estimate of as many best ones as are wanted; where there are fewer, none."""
        every = np.sort(np.concatenate([self._elders, etas]))
        wanted = self._plan.finalists or 0
        return float(every[-wanted]) if len(every) >= wanted else -np.inf

    def _end_generation(self) -> None:
        """Remember the best of a generation whose trials are complete."""
        etas = self._etas
        if self._plan.finalists is not None:
            self._elders = np.sort(np.concatenate([self._elders, etas]))[-self._plan.finalists :]
        else:
            for cell, value in zip(self._cells.tolist(), etas.tolist(), strict=True):
                self._leaders[cell] = max(value, self._leaders.get(cell, value))
        self._begin()
