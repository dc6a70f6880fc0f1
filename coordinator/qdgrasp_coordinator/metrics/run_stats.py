"""Counts over the rows of a run: totals, growth by generation, and whether it is complete.

All counts are a function of the journal's rows in their order, so that a replayed run has the same.
"""

from collections.abc import Iterable, Iterator
from typing import Annotated

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.arrays import take_rows
from qdgrasp_coordinator.metrics.cells import cell_keys, cells
from qdgrasp_coordinator.metrics.contact_niches import contact_niches
from qdgrasp_coordinator.metrics.stop_criteria import StopTracker, count_to_first
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import Overlaps, RunSpec
from qdgrasp_protocol.text import counted

CURVE_POINTS = 512  # The most points of a curve


def outcome_words(outcome: Outcome) -> str:
    """Return an outcome in lower-case words: "dead end"."""
    return outcome.name.lower().replace("_", " ")


class CurvePoint(Struct, frozen=True, array_like=True):
    """The counts of a run at the end of one of its generations; a list of six numbers in JSON."""

    evaluations: Annotated[int, "Counted evaluations."]
    steps: Annotated[int, "Simulated steps of physics."]
    successes: Annotated[int, "A finger touches the object after closing."]
    cells: Annotated[int, "Distinct 1 cm cells with a success."]
    robust: Annotated[int, "Successes that survived every disturbance."]
    contact_niches: Annotated[int, "Distinct contact niches in which a grasp holds."]


class GrowthCurve(Struct, frozen=True, kw_only=True):
    """Growth of a run's counts. JSON, with the answer on `rec/runs` about one run."""

    run: Annotated[str, "Its name in its job."]
    points: Annotated[
        list[CurvePoint],
        "At most 512, at evenly spaced generations: evaluations, steps, successes, cells, robust, niches.",
    ]


class CurveRecorder:
    """Keeps the counts of a run generation by generation, and thins them by halves.

    The curve is a function of the rows alone: a run that was replayed has the same one.
    """

    def __init__(self) -> None:
        self.points: list[CurvePoint] = []
        self._step = 1
        self._generations = 0

    def record(self, point: CurvePoint) -> None:
        """Record the counts at the end of the next generation."""
        self._generations += 1
        if self._generations % self._step == 0 and len(self.points) == CURVE_POINTS:
            self.points = self.points[1::2]
            self._step *= 2
        if self._generations % self._step == 0:
            self.points.append(point)


class RunTotals(Struct, frozen=True, kw_only=True):
    """Counts of a run or, summed, of a job; the first part of all structs that show them."""

    evaluations: Annotated[int, "Counted evaluations."]
    simulated: Annotated[int, "Genomes whose hand closed."]
    steps: Annotated[int, "Simulated steps of physics."]
    overlaps: Annotated[int, "Genomes whose open hand overlapped the object."]
    dead_ends: Annotated[int, "Genomes that stand for no pose."]
    successes: Annotated[int, "A finger touches the object after closing."]
    grasps: Annotated[int, "Successes that survived a disturbance: fitness 1 or more."]
    robust: Annotated[int, "Successes that survived every disturbance."]
    errors: Annotated[int, "Rows on which the simulator failed three times, trials included."]
    cells: Annotated[int, "Distinct 1 cm cells with a success; of a job their sum over its runs."]
    contact_niches: Annotated[
        int, "Distinct contact niches in which a grasp holds; of a job their sum over its runs."
    ]
    trials: Annotated[int, "Rows that are trials of successes; 0 where no protocol has them."]

    @property
    def found(self) -> str:
        """Number of successes, of cells and of contact niches, in words."""
        found = f"{counted(self.successes, 'success', 'successes')} in {counted(self.cells, 'cell')}"
        return f"{found}, {counted(self.contact_niches, 'contact niche')}"

    @property
    def screened(self) -> str:
        """The other counts beside evaluations, in words."""
        return (
            f"{self.simulated} simulated in {counted(self.steps, 'step')}, "
            f"{counted(self.overlaps, 'overlap')}, {counted(self.dead_ends, 'dead end')}"
        )

    @property
    def totals(self) -> "RunTotals":
        """These counts alone, without those that a derived struct adds."""
        return RunTotals(**{name: getattr(self, name) for name in TOTAL_NAMES})

    def __add__(self, other: "RunTotals") -> "RunTotals":
        return RunTotals(**{name: getattr(self, name) + getattr(other, name) for name in TOTAL_NAMES})


TOTAL_NAMES = RunTotals.__struct_fields__  # Names of all counts that are added up
NO_TOTALS = RunTotals(**dict.fromkeys(TOTAL_NAMES, 0))
BARREN = 20  # Generations in a row without a counted row after which a run may end (`BARREN_GENOMES`)
BARREN_GENOMES = 1000  # Least genomes in these generations: with few at a time, twenty may fail by chance


def evaluation_mask(rows: Rows, overlaps: Overlaps) -> NDArray[np.bool_]:
    """Flag the rows that count as evaluations: (n,).

    "count": every nominal row, as every pose was given to the simulator or its filters (the paper's
    "evaluated samples"). "redraw": those that were simulated. Trials above 0 never count.
    """
    nominal: NDArray[np.bool_] = rows["trial"] == 0
    return nominal if overlaps == "count" else nominal & (rows["outcome"] >= Outcome.MISSED)


class RunCounter:
    """Counts the rows of a journal in its order; outcomes are those of nominal rows.

    The run is over after its budget of counted evaluations, or when a goal is reached, once each success has
    its trials.
    """

    rows: int = 0
    evaluations: int = 0  # Counted ones, which the budget limits
    steps: int = 0  # Of nominal rows
    trials: int = 0
    errors: int = 0

    def __init__(self, spec: RunSpec) -> None:
        self.spec = spec
        self._barren = 0
        self._before = 0
        self._nominal = 0
        self._fruitful = 0  # nominal rows up to the last generation with a counted row
        self._last: np.void | None = None  # the last nominal row
        self._trials_follow = False
        self._outcomes = [0] * len(Outcome)
        self._cells: set[int] = set()
        self._contact_niches: set[int] = set()
        self._tracker = StopTracker(spec)
        self._curve = CurveRecorder()
        self.finished = self._ending()
        """Reason why the run is over, in words; None while it is not."""

    def count_block(self, block: Rows) -> None:
        """Count the next rows of a journal, and record where each generation ends.

        That of a program's own search ends where the next one begins, or the run is over.
        """
        for number in np.unique(block["generation"]):
            rows = block[block["generation"] == number]
            if self.spec.has_own_search and self._last is not None and self._last["generation"] < number:
                self.end_generation()
            self.count(rows)
            is_last = (rows["index"] == self.spec.population - 1) & (rows["trial"] == 0)
            if self.finished if self.spec.has_own_search else is_last.any():
                self.end_generation()

    def counting(self, blocks: Iterable[Rows]) -> Iterator[Rows]:
        """Yield the next rows of a journal, in blocks, each counted as it passes."""
        for block in blocks:
            self.count_block(block)
            yield block

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
        self._tracker.count(rows)
        outcomes = np.bincount(rows["outcome"], minlength=len(Outcome)).tolist()
        self._outcomes = [sum(pair) for pair in zip(self._outcomes, outcomes, strict=True)]
        self.evaluations += len(rows) if self.spec.overlaps == "count" else sum(outcomes[Outcome.MISSED :])
        self.steps += int(rows["steps"].sum(dtype=np.int64))
        found = rows["outcome"] >= Outcome.DROPPED
        self._cells.update(cell_keys(cells(rows["descriptor"][found, :3])).tolist())
        touches = contact_niches(take_rows(rows, rows["outcome"] == Outcome.HELD))
        self._contact_niches.update(touches[touches > 0].tolist())
        if len(rows):
            self._last = rows[-1]

    def end_generation(self) -> None:
        """Record that the rows counted so far end a generation."""
        self._nominal = self.rows - self.trials
        self._barren += 1
        if self.evaluations > self._before:
            self._barren, self._before, self._fruitful = 0, self.evaluations, self._nominal
        self.finished = self._ending()
        found = self.totals
        self._curve.record(CurvePoint(*(getattr(found, name) for name in CurvePoint.__struct_fields__)))

    def curve(self, run: str) -> GrowthCurve:
        """Return the growth of the counts so far, of the run of that name."""
        return GrowthCurve(run=run, points=list(self._curve.points))

    @property
    def totals(self) -> RunTotals:
        """The counts that are published; outcomes are those of nominal rows."""
        reached = np.cumsum(self._outcomes[::-1])[::-1].tolist()  # Rows with at least each outcome
        return RunTotals(
            evaluations=self.evaluations,
            simulated=reached[Outcome.MISSED],
            steps=self.steps,
            overlaps=self._outcomes[Outcome.OVERLAP],
            dead_ends=self._outcomes[Outcome.DEAD_END],
            successes=reached[Outcome.DROPPED],
            grasps=reached[Outcome.SHAKEN],
            robust=reached[Outcome.HELD],
            errors=self.errors,
            cells=len(self._cells),
            contact_niches=len(self._contact_niches),
            trials=self.trials,
        )

    @property
    def outcomes(self) -> dict[str, int]:
        """Number of nominal rows by outcome, under the `Outcome`'s name in lower case."""
        return {outcome.name.lower(): self._outcomes[outcome] for outcome in Outcome}

    @property
    def left(self) -> int:
        """Counted evaluations that the budget still allows."""
        return self.spec.evaluations - self.evaluations

    @property
    def trials_left(self) -> int:
        """Trials that the successes so far still get."""
        return max(0, self.spec.trial_count * sum(self._outcomes[Outcome.DROPPED :]) - self.trials)

    @property
    def is_reached(self) -> bool:
        """True if the budget or a goal is reached: only trials may follow."""
        return self.left <= 0 or self._tracker.reached is not None

    def rows_until_stop(self, rows: Rows) -> int:
        """Return how many of the next rows, nominal ones or trials, belong to the run.

        All, if the run goes on after them, or if it is reached and these are trials.
        """
        if self.is_reached or not len(rows) or rows["trial"][0] > 0:
            return len(rows)
        is_counted = evaluation_mask(rows, self.spec.overlaps)
        end = count_to_first(np.cumsum(is_counted) >= self.left)
        return min(end, self._tracker.rows_until_stop(rows))

    def check_budget(self, where: str = "evaluations") -> None:
        """Check that the rows counted begin a journal of this spec; they may be of another budget.

        Raises `ImpossibleValue`, which calls the budget `where`, if the rows go on after that budget or a
        goal, or if another budget or goal ended a generation early: then trials follow, where a greater
        budget has nominal rows first.
        """
        if self._last is None:
            return
        is_counted = bool(evaluation_mask(self._last.reshape(1), self.spec.overlaps)[0])
        least = self.evaluations + (not is_counted)
        if self.spec.evaluations < least:
            raise ImpossibleValue(where, self.spec.evaluations, f"at least {least}, which are recorded")
        if self._tracker.is_passed:
            name = "saturation" if self.spec.grasps is None else "grasps"
            raise ImpossibleValue(name, getattr(self.spec, name), "reached by the last row that is recorded")
        is_cut = self._trials_follow and self._last["index"] + 1 < self.spec.population
        if is_cut and self.spec.evaluations > least and self._tracker.reached is None:
            expected = f"{least}: trials end the generation there, and only whole generations can be extended"
            raise ImpossibleValue(where, self.spec.evaluations, expected)

    def _ending(self) -> str | None:
        if self.left <= 0 and not self.trials_left:
            return f"the budget of {self.spec.evaluations} evaluations is spent"
        if self._tracker.reached is not None and not self.trials_left:
            return self._tracker.reached
        genomes = self._nominal - self._fruitful
        if self._barren >= BARREN and genomes >= BARREN_GENOMES:
            return f"the last {genomes} genomes, {self._barren} generations, counted no evaluation"
        return None


def count_rows(spec: RunSpec, blocks: Iterable[Rows]) -> RunCounter:
    """Return the counter of a journal's rows, in their order, in blocks of any length."""
    counter = RunCounter(spec)
    for _ in counter.counting(blocks):
        pass
    return counter
