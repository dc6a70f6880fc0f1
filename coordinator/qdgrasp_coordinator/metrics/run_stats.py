"""Counts over the rows of a run: totals, growth by generation, and whether it is complete.

All of it is a function of the journal's rows in their order, so that a run that was replayed has the same
counts.
"""

from collections.abc import Iterable
from typing import Annotated, Protocol

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.arrays import take_rows
from qdgrasp_coordinator.metrics.cells import cell_keys, cells
from qdgrasp_coordinator.metrics.stop_criteria import StopCriteria, StopTracker, count_to_first
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.rows import Outcome, Rows, trial_count
from qdgrasp_protocol.spec import Overlaps, RunSpec
from qdgrasp_protocol.text import counted

CURVE_POINTS = 512  # The most points of a curve


class CurveCounts(Protocol):
    """The counts that a curve is made of."""

    @property
    def evaluations(self) -> int:
        """Counted evaluations."""

    @property
    def proposals(self) -> int:
        """Poses that decoding screened."""

    @property
    def successes(self) -> int:
        """Nominal successes."""

    @property
    def cells(self) -> int:
        """Distinct 1 cm cells with a success."""

    @property
    def robust(self) -> int:
        """Successes that survived both shakes."""


class CurvePoint(Struct, frozen=True, array_like=True):
    """The counts of a run at the end of one of its generations; a list of five numbers in JSON."""

    evaluations: Annotated[int, Meta(description="Counted evaluations.")]
    proposals: Annotated[int, Meta(description="Poses that decoding screened, simulated or not.")]
    successes: Annotated[int, Meta(description="A finger touches the object after closing.")]
    cells: Annotated[int, Meta(description="Distinct 1 cm cells with a success.")]
    robust: Annotated[int, Meta(description="Successes that survived both shakes: fitness 2.")]


class GrowthCurve(Struct, frozen=True, kw_only=True):
    """Growth of a run's counts. JSON, the answer to a query on `stat/curve/<run>`."""

    run: Annotated[str, Meta(description="Its name in its job.")]
    points: Annotated[
        list[CurvePoint],
        Meta(
            description="At most 512, at evenly spaced generations: "
            "evaluations, proposals, successes, cells, robust."
        ),
    ]


class CurveRecorder:
    """Notes the counts of a run generation by generation, and thins them by halves.

    A function of the rows alone: a run that was replayed has the same curve.
    """

    def __init__(self) -> None:
        self._points: list[CurvePoint] = []
        self._step = 1
        self._generations = 0

    def note(self, counts: CurveCounts) -> None:
        """Note the counts at the end of the next generation."""
        self._generations += 1
        if self._generations % self._step:
            return
        if len(self._points) == CURVE_POINTS:
            self._points = self._points[1::2]
            self._step *= 2
            if self._generations % self._step:
                return
        self._points.append(
            CurvePoint(counts.evaluations, counts.proposals, counts.successes, counts.cells, counts.robust)
        )

    def curve(self, run: str) -> GrowthCurve:
        """The curve so far of the run of that name."""
        return GrowthCurve(run=run, points=list(self._points))


BARREN = 20  # Generations in a row that counted nothing after which a run may end (`BARREN_GENOMES`)
BARREN_GENOMES = 1000  # Least genomes in these generations: with few at a time, bad luck may last for twenty

BUDGET_ALONE = StopCriteria()


def evaluation_mask(rows: Rows, overlaps: Overlaps) -> NDArray[np.bool_]:
    """Flag the rows that count as evaluations: (n,).

    "count": every nominal row, as every pose was given to the simulator or its filters (the paper's
    "evaluated samples"). "redraw": those that were simulated. Trials above 0 never count.
    """
    nominal: NDArray[np.bool_] = rows["trial"] == 0
    return nominal if overlaps == "count" else nominal & (rows["outcome"] >= Outcome.MISSED)


def success_mask(rows: Rows) -> NDArray[np.bool_]:
    """Flag the nominal successes, which archives, coverage and figures count: (n,)."""
    found: NDArray[np.bool_] = (rows["trial"] == 0) & (rows["outcome"] >= Outcome.DROPPED)
    return found


def successes(rows: Rows) -> Rows:
    """The nominal successes among rows, in their order."""
    found: Rows = rows[success_mask(rows)]
    return found


class RunCounter:
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
    """Rows that are trials."""
    errors: int = 0
    """Rows on which the simulator failed three times, trials included."""

    def __init__(
        self, budget: int, overlaps: Overlaps, trials: int = 0, goals: StopCriteria = BUDGET_ALONE
    ) -> None:
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
        self._pursuit = StopTracker(goals, self._cells)
        self.finished = self._ending()
        """Reason why the run is over, in words; None while it is not."""

    def count(self, rows: Rows) -> None:
        """Count the next rows."""
        if not len(rows):
            return
        self.rows += len(rows)
        self.errors += int(np.count_nonzero(rows["outcome"] == Outcome.ERROR))
        is_nominal = rows["trial"] == 0
        self._trials_follow = not is_nominal[-1]
        self._count_nominal(rows if is_nominal.all() else take_rows(rows, is_nominal))
        self.trials = self.rows - sum(self._outcomes)
        self.finished = self._ending()

    def _count_nominal(self, rows: Rows) -> None:
        if self._goals != BUDGET_ALONE:
            self._pursuit.count(rows, evaluation_mask(rows, self._overlaps))
        outcomes = np.bincount(rows["outcome"], minlength=len(Outcome)).tolist()
        self._outcomes = [sum(pair) for pair in zip(self._outcomes, outcomes, strict=True)]
        self.evaluations += len(rows) if self._overlaps == "count" else sum(outcomes[Outcome.MISSED :])
        self.proposals += int(rows["proposals"].sum(dtype=np.int64))
        found = rows["outcome"] >= Outcome.DROPPED
        self._cells.update(cell_keys(cells(rows["descriptor"][found, :3])).tolist())
        if len(rows):
            self._last = rows[-1]

    def end_generation(self) -> None:
        """Note that the rows counted so far end a generation."""
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
        """True if the budget or a goal is reached: only trials may follow."""
        return self.left <= 0 or self._goal is not None

    def until_reached(self, rows: Rows) -> int:
        """Count the next rows, nominal ones or trials, up to the one that ends the run.

        All, where it goes on behind them, or where it is reached and what follows are trials.
        """
        if self.is_reached or not len(rows) or rows["trial"][0] > 0:
            return len(rows)
        ends = [len(rows)]
        if self.left <= len(rows):
            ends.append(count_to_first(np.cumsum(evaluation_mask(rows, self._overlaps)) >= self.left))
        if self._goals != BUDGET_ALONE:
            ends.append(
                self._pursuit.until_reached(rows, evaluation_mask(rows, self._overlaps), self.successes)
            )
        return min(ends)

    @property
    def _goal(self) -> str | None:
        return self._pursuit.reached(self.successes)

    def check_budget(self, spec: RunSpec, where: str = "evaluations") -> None:
        """Check that the rows counted begin a journal of `spec`, which may have another budget.

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
        is_counted = bool(evaluation_mask(self._last.reshape(1), self._overlaps)[0])
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
        """Trials of the successes so far that have not been counted yet."""
        return self._trials * self.successes - self.trials

    def _from(self, outcome: Outcome) -> int:
        return sum(self._outcomes[outcome:])

    @property
    def cells(self) -> int:
        """Distinct 1 cm cells with a success."""
        return len(self._cells)

    @property
    def outcomes(self) -> dict[str, int]:
        """Number of nominal rows by outcome, under the `Outcome`'s name in lower case."""
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


class RunTotals(Struct, frozen=True, kw_only=True):
    """Counts of a run or, summed, of a job; the first part of all structs that show them."""

    evaluations: Annotated[int, Meta(description="Counted evaluations.")]
    simulated: Annotated[int, Meta(description="Genomes whose hand closed.")]
    proposals: Annotated[int, Meta(description="Poses that decoding screened, simulated or not.")]
    overlaps: Annotated[
        int,
        Meta(
            description="Genomes whose open hand overlapped the object; "
            "where a genome has candidates, all of them."
        ),
    ]
    dead_ends: Annotated[
        int, Meta(description="Genomes for which there was no pose, or none worth a simulation.")
    ]
    successes: Annotated[int, Meta(description="A finger touches the object after closing.")]
    grasps: Annotated[int, Meta(description="Successes that survived a shake: fitness 1 or more.")]
    robust: Annotated[int, Meta(description="Successes that survived both shakes: fitness 2.")]
    errors: Annotated[
        int, Meta(description="Rows on which the simulator failed three times, trials included.")
    ]
    cells: Annotated[
        int, Meta(description="Distinct 1 cm cells with a success; of a job their sum over its runs.")
    ]
    trials: Annotated[
        int, Meta(description="Rows that are trials of successes; 0 where no protocol has them.")
    ]

    @property
    def found(self) -> str:
        """Number of successes and of cells, in words."""
        return f"{counted(self.successes, 'success', 'successes')} in {counted(self.cells, 'cell')}"

    @property
    def screened(self) -> str:
        """The other counting, beside evaluations, in words: how much was screened for them."""
        return (
            f"{self.simulated} simulated of {counted(self.proposals, 'proposal')}, "
            f"{counted(self.overlaps, 'overlap')}, {counted(self.dead_ends, 'dead end')}"
        )

    def __add__(self, other: "RunTotals") -> "RunTotals":
        return RunTotals(**{name: getattr(self, name) + getattr(other, name) for name in TOTAL_NAMES})


TOTAL_NAMES = RunTotals.__struct_fields__  # Names of all counts that are added up
NO_TOTALS = RunTotals(**dict.fromkeys(TOTAL_NAMES, 0))


def run_totals(found: RunCounter | RunTotals) -> RunTotals:
    """Return the totals of one run."""
    return RunTotals(**{name: getattr(found, name) for name in TOTAL_NAMES})


def count_rows(spec: RunSpec, blocks: Iterable[Rows], trail: CurveRecorder | None = None) -> RunCounter:
    """Return the tally of a journal, in its order, in blocks of any length; `trail` notes it."""
    total = new_counter(spec)
    for block in blocks:
        count_block(total, spec, block, trail)
    return total


def new_counter(spec: RunSpec) -> RunCounter:
    """The tally of a journal that has no rows yet."""
    return RunCounter(spec.evaluations, spec.overlaps, trial_count(spec.protocol), StopCriteria.of(spec))


def count_block(total: RunCounter, spec: RunSpec, block: Rows, trail: CurveRecorder | None = None) -> None:
    """Count the next rows of a journal, and note where each generation ends."""
    for number in np.unique(block["generation"]):
        rows = block[block["generation"] == number]
        total.count(rows)
        if ((rows["index"] == spec.population - 1) & (rows["trial"] == 0)).any():
            total.end_generation()
            if trail is not None:
                trail.note(total)
