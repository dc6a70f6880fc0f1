"""Plans of histories: their runs, failures, and the journal that follows."""

import hashlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from qdgrasp_coordinator.metrics.stop_criteria import StopCriteria
from qdgrasp_coordinator.scheduler.pipeline import Flight, Pipeline
from qdgrasp_coordinator.search.base import SearchAlgorithm
from qdgrasp_protocol.rows import Genomes, Outcome, Rows, RowShape
from qdgrasp_protocol.spec import Overlaps

SHAPE = RowShape(genes=4, joints=1)


class Chain:
    """A search whose every ask depends on every bit of all tells."""

    def __init__(self, population: int, seed: int) -> None:
        self._population = population
        self._told = hashlib.sha256(seed.to_bytes(8, "little"))

    def ask(self, generation: int) -> Genomes:
        digest = self._told.copy()
        digest.update(f"ask {generation}".encode())
        generator = np.random.default_rng(list(digest.digest()))
        return generator.uniform(-1, 1, (self._population, SHAPE.genes)).astype(np.float32)

    def tell(self, generation: int, rows: Rows) -> None:
        self._told.update(f"tell {generation}".encode() + rows.tobytes())


def evaluate(rows: Rows) -> Rows:
    """Return the rows with results, a function of genome and trial; about 4 % are poison."""
    found = rows.copy()
    genome = rows["genome"]
    share = ((genome[:, 0] + 1) / 2 + rows["trial"] * np.float32(0.37)) % 1
    found["outcome"] = np.searchsorted([0.04, 0.1, 0.5, 0.7, 0.75, 0.85, 0.95], share, side="right")
    found["fitness"] = np.maximum(found["outcome"].astype(np.float32) - Outcome.DROPPED, 0)
    found["proposals"] = 1
    found["descriptor"] = genome[:, 1:4] * np.float32(0.2)
    found["nu"] = genome[:, 1] * genome[:, 2]
    return np.where(found["outcome"] == Outcome.ERROR, rows, found)


@dataclass(frozen=True)
class Task:
    """A search and the evaluation of its genomes."""

    search: Callable[[int, int], SearchAlgorithm]
    """Makes the search from population and seed."""
    evaluate: Callable[[Rows], Rows]
    """Returns rows with results, a function of genome and trial; poison rows stay as they are."""
    shape: RowShape


def evaluate_in_few_cells(rows: Rows) -> Rows:
    """The same evaluation, with eight cells."""
    found = evaluate(rows)
    found["descriptor"] = np.sign(found["descriptor"]) * np.float32(0.01)
    return found


CHAIN = Task(Chain, evaluate, SHAPE)
FEW_CELLS = Task(Chain, evaluate_in_few_cells, SHAPE)


@dataclass(frozen=True)
class Plan:
    """A run in brief."""

    seed: int = 0
    population: int = 6
    evaluations: int = 32
    overlaps: Overlaps = "count"
    in_flight: int = 1
    most_in_flight: int = 0
    """Generations, where there become more."""
    trials: int = 0
    """Of each success."""
    successes: int | None = None
    no_new_cell: int | None = None
    grasps: int | None = None
    saturation: float | None = None
    window: int = 20
    """Simulated evaluations that the rate of new cells is counted over."""
    task: Task = CHAIN

    def __str__(self) -> str:
        """Return the fields that differ from the defaults, but for the task."""
        values = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "task"}
        defaults = vars(Plan())
        changed = [f"{name}={value}" for name, value in values.items() if value != defaults[name]]
        return " ".join(changed) or "plain"

    def pipeline(self) -> Pipeline:
        """A new pipeline of this run."""
        search = self.task.search(self.population, self.seed)
        budget = (self.evaluations, self.overlaps, self.flight)
        return Pipeline(search, self.task.shape, *budget, self.trials, self.goals)

    @property
    def goals(self) -> StopCriteria:
        """Its stop criteria besides the budget."""
        names = ("successes", "no_new_cell", "grasps", "saturation", "window")
        return StopCriteria(**{name: getattr(self, name) for name in names})

    @property
    def flight(self) -> Flight:
        """Generations in flight."""
        return Flight(self.in_flight, self.most_in_flight)


def reference(plan: Plan) -> bytes:
    """The journal of a plan without a bus: written from the contract, not with the pipeline."""
    task = plan.task
    search = task.search(plan.population, plan.seed)
    waiting = deque((g, search.ask(g)) for g in range(plan.in_flight))
    journal, barren, idle = [], 0, 0
    end = End(plan)
    while True:
        number, genomes = waiting.popleft()
        rows = task.evaluate(rows_of(number, genomes, task.shape))
        counts = rows["outcome"] >= (Outcome.MISSED if plan.overlaps == "redraw" else Outcome.ERROR)
        until = next((n for n, row in enumerate(rows) if end.comes_with(row, counts[n])), None)
        is_last = until is not None
        rows = rows[: until + 1] if is_last else rows
        found = rows[rows["outcome"] >= Outcome.DROPPED]
        trials = [trials_of(row, plan.trials, task) for row in found]
        journal.append(rows.tobytes())
        journal += [each.tobytes() for each in trials]
        barren, idle = (0, 0) if counts.any() else (barren + 1, idle + len(rows))
        if is_last or (barren >= 20 and idle >= 1000):
            return b"".join(journal)
        if plan.trials:
            is_success = rows["outcome"] >= Outcome.DROPPED
            rows["fitness"][is_success] = [each["fitness"].sum() for each in trials]
            rows["trial"][is_success] = plan.trials
        search.tell(number, rows)
        told, behind = number + 1, number + len(waiting)
        in_flight = max(plan.in_flight, min(plan.most_in_flight, plan.in_flight + told // 8))
        waiting.extend((g, search.ask(g)) for g in range(behind + 1, told + in_flight))


def _cell(row: np.void) -> tuple[int, ...]:
    return tuple(np.rint(np.float64(row["descriptor"][:3]) * 100).astype(int).tolist())


class End:
    """Tells if a run's end comes with its next nominal row."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._counted = self._found = self._fresh = 0
        self._cells: set[tuple[int, ...]] = set()
        self._grasps = 0
        self._niches: set[tuple[int, ...]] = set()
        self._new: list[bool] = []
        """For each simulated row, whether it found a cell with a grasp."""

    def comes_with(self, row: np.void, is_counted: np.bool_) -> bool:
        plan = self._plan
        self._counted += int(is_counted)
        self._take_grasp(row)
        if row["outcome"] >= Outcome.DROPPED:
            self._found += 1
            cell = _cell(row)
            if cell not in self._cells:
                self._cells.add(cell)
                self._fresh = self._counted
        return (
            self._counted == plan.evaluations
            or self._found == plan.successes
            or self._counted - self._fresh == plan.no_new_cell
            or self._grasps == plan.grasps
            or self._is_saturated
        )

    def _take_grasp(self, row: np.void) -> None:
        self._grasps += row["outcome"] >= Outcome.SHAKEN
        if row["outcome"] >= Outcome.MISSED:
            self._new.append(row["outcome"] >= Outcome.SHAKEN and _cell(row) not in self._niches)
            if self._new[-1]:
                self._niches.add(_cell(row))

    @property
    def _is_saturated(self) -> bool:
        plan, done = self._plan, len(self._new)
        if plan.saturation is None or done < plan.window or not self._niches:
            return False
        lately = (sum(self._new[-plan.window :]) + 1) / plan.window
        return bool(lately <= plan.saturation * len(self._niches) / done)


def trials_of(row: np.void, trials: int, task: Task) -> Rows:
    """The trials of a nominal row, evaluated."""
    rows = task.shape.empty(trials)
    rows["generation"], rows["index"], rows["genome"] = row["generation"], row["index"], row["genome"]
    rows["trial"] = np.arange(1, trials + 1)
    return task.evaluate(rows)


def rows_of(number: int, genomes: Genomes, shape: RowShape = SHAPE) -> Rows:
    """Rows of a whole generation, not evaluated."""
    rows = shape.empty(len(genomes))
    rows["generation"], rows["index"], rows["genome"] = number, np.arange(len(genomes)), genomes
    return rows


class Spy(Chain):
    """Notes in which order it is asked and told."""

    def __init__(self, population: int, seed: int = 0) -> None:
        super().__init__(population, seed)
        self.calls: list[str] = []

    def ask(self, generation: int) -> Genomes:
        self.calls.append(f"ask {generation}")
        return super().ask(generation)

    def tell(self, generation: int, rows: Rows) -> None:
        self.calls.append(f"tell {generation}")
        super().tell(generation, rows)


def asked(pipeline: Pipeline, task: Task = CHAIN) -> Rows:
    """All rows that may be asked now, evaluated."""
    parts = [SHAPE.empty(0)]
    while (generation := pipeline.ask()) is not None:
        rows = rows_of(generation.number, generation.genomes)
        rows["index"], rows["trial"] = generation.indices, generation.trials
        parts.append(task.evaluate(rows))
    return np.concatenate(parts)
