"""The tally of a run: what its journal's rows add up to, and whether they make it complete."""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.counts.cells import cells, keys
from qdgrasp_coordinator.counts.goals import Goals, Pursuit, first
from qdgrasp_coordinator.counts.whole import taken
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import Overlaps, RunSpec

BARREN = 20
"""A run ends when so many generations in a row counted nothing,"""
BARREN_GENOMES = 1000
"""and so many genomes: a search that asks few at a time may have bad luck for twenty generations."""

BUDGET_ALONE = Goals()


def counted(rows: Rows, overlaps: Overlaps) -> NDArray[np.bool_]:
    """Which rows count as evaluations: (n,).

    "count": every nominal row, as every pose was given to the simulator or its filters (the paper's
    "evaluated samples"). "redraw": those that were simulated. Trials above 0 never count.
    """
    nominal: NDArray[np.bool_] = rows["trial"] == 0
    return nominal if overlaps == "count" else nominal & (rows["outcome"] >= Outcome.MISSED)


def successful(rows: Rows) -> NDArray[np.bool_]:
    """Which rows are nominal successes, what archives, coverage and figures count: (n,)."""
    found: NDArray[np.bool_] = (rows["trial"] == 0) & (rows["outcome"] >= Outcome.DROPPED)
    return found


def successes(rows: Rows) -> Rows:
    """The nominal successes among rows, in their order."""
    found: Rows = rows[successful(rows)]
    return found


class Tally:
    """Sums over the rows of a journal in its order; outcomes are those of nominal rows.

    Parameters
    ----------
    budget
        Counted evaluations after which the run is over.
    overlaps
        Whether overlaps count as evaluations.
    trials
        How many trials each success has.
    goals
        What ends the run before its budget is spent.
    """

    rows: int = 0
    evaluations: int = 0
    """Counted evaluations: what the budget limits."""
    proposals: int = 0
    """Poses that decoding screened."""
    trials: int = 0
    """Rows that are no nominal ones."""
    errors: int = 0
    """Rows on which the simulator failed three times, trials included."""

    def __init__(self, budget: int, overlaps: Overlaps, trials: int = 0, goals: Goals = BUDGET_ALONE) -> None:
        self.budget = budget
        self._overlaps = overlaps
        self._trials = trials
        self._barren = 0
        self._before = 0
        self._nominal = 0
        self._fruitful = 0  # nominal rows up to the last generation that counted something
        self._last: np.void | None = None  # the last nominal row
        self._trials_follow = False
        self._outcomes = [0] * len(Outcome)
        self._cells: set[int] = set()
        self._goals = goals
        self._pursuit = Pursuit(goals, self._cells)
        self.finished = self._ending()
        """Why the run is over, in words; None while it is not."""

    def count(self, rows: Rows) -> None:
        """Count the next rows."""
        if not len(rows):
            return
        self.rows += len(rows)
        self.errors += int(np.count_nonzero(rows["outcome"] == Outcome.ERROR))
        is_nominal = rows["trial"] == 0
        self._trials_follow = not is_nominal[-1]
        self._count_nominal(rows if is_nominal.all() else taken(rows, is_nominal))
        self.trials = self.rows - sum(self._outcomes)
        self.finished = self._ending()

    def _count_nominal(self, rows: Rows) -> None:
        if self._goals != BUDGET_ALONE:
            self._pursuit.count(rows, counted(rows, self._overlaps))
        outcomes = np.bincount(rows["outcome"], minlength=len(Outcome)).tolist()
        self._outcomes = [sum(pair) for pair in zip(self._outcomes, outcomes, strict=True)]
        self.evaluations += len(rows) if self._overlaps == "count" else sum(outcomes[Outcome.MISSED :])
        self.proposals += int(rows["proposals"].sum(dtype=np.int64))
        found = rows["outcome"] >= Outcome.DROPPED
        self._cells.update(keys(cells(rows["descriptor"][found, :3])).tolist())
        if len(rows):
            self._last = rows[-1]

    def end_generation(self) -> None:
        """Hear that the rows counted so far end a generation."""
        self._nominal = self.rows - self.trials
        self._barren += 1
        if self.evaluations > self._before:
            self._barren, self._before, self._fruitful = 0, self.evaluations, self._nominal
        self.finished = self._ending()

    @property
    def left(self) -> int:
        """Counted evaluations that the budget still allows."""
        return self.budget - self.evaluations

    @property
    def is_reached(self) -> bool:
        """Whether what ends the run has come: only trials may follow."""
        return self.left <= 0 or self._goal is not None

    def until_reached(self, rows: Rows) -> int:
        """How many of the next rows, nominal ones or trials, there are up to the one that ends the run.

        All, where it goes on behind them, or where it is reached and what follows are trials.
        """
        if self.is_reached or not len(rows) or rows["trial"][0] > 0:
            return len(rows)
        ends = [len(rows)]
        if self.left <= len(rows):
            ends.append(first(np.cumsum(counted(rows, self._overlaps)) >= self.left))
        if self._goals != BUDGET_ALONE:
            ends.append(self._pursuit.until_reached(rows, counted(rows, self._overlaps), self.successes))
        return min(ends)

    @property
    def _goal(self) -> str | None:
        return self._pursuit.reached(self.successes)

    def check_budget(self, spec: RunSpec, where: str = "evaluations") -> None:
        """Check that the journal of `spec`, which may have another budget, begins with the rows counted.

        Parameters
        ----------
        where
            What the budget is called in an error.

        Raises
        ------
        ImpossibleValue
            The rows go on behind that budget or a goal, or they end a generation early for the sake of other
            ones: what follows then are trials, where a greater budget has nominal rows first.
        """
        if self._last is None:
            return
        is_counted = bool(counted(self._last.reshape(1), self._overlaps)[0])
        least = self.evaluations + (not is_counted)
        if spec.evaluations < least:
            raise ImpossibleValue(where, spec.evaluations, f"at least {least}, which are recorded")
        self._pursuit.check(self.successes, bool(self._last["outcome"] >= Outcome.DROPPED))
        is_cut = self._trials_follow and self._last["index"] + 1 < spec.population
        if is_cut and spec.evaluations > least and self._goal is None:
            expected = f"{least}: trials end the generation there, and only whole generations can be extended"
            raise ImpossibleValue(where, spec.evaluations, expected)

    def _ending(self) -> str | None:
        if self.left <= 0 and not self._owed:
            return f"the budget of {self.budget} evaluations is spent"
        if self._goal is not None and not self._owed:
            return self._goal
        genomes = self._nominal - self._fruitful
        if self._barren >= BARREN and genomes >= BARREN_GENOMES:
            return f"the last {genomes} genomes, {self._barren} generations, counted no evaluation"
        return None

    @property
    def _owed(self) -> int:
        """Trials that successes so far still have before them."""
        return self._trials * self.successes - self.trials

    def _from(self, outcome: Outcome) -> int:
        return sum(self._outcomes[outcome:])

    @property
    def cells(self) -> int:
        """Distinct 1 cm cells with a success."""
        return len(self._cells)

    @property
    def outcomes(self) -> dict[str, int]:
        """How often nominal rows ended in each way, by the name of the `Outcome` in lower case."""
        return {outcome.name.lower(): self._outcomes[outcome] for outcome in Outcome}

    @property
    def dead_ends(self) -> int:
        """Rows for which decoding found no pose."""
        return self._outcomes[Outcome.DEAD_END]

    @property
    def overlaps(self) -> int:
        """Rows whose open hand overlapped the object."""
        return self._outcomes[Outcome.OVERLAP]

    @property
    def simulated(self) -> int:
        """Rows whose hand closed."""
        return self._from(Outcome.MISSED)

    @property
    def successes(self) -> int:
        """Rows with a finger on the object after closing."""
        return self._from(Outcome.DROPPED)

    @property
    def grasps(self) -> int:
        """Successes that survived a shake."""
        return self._from(Outcome.SHAKEN)

    @property
    def robust(self) -> int:
        """Successes that survived both shakes."""
        return self._from(Outcome.HELD)
