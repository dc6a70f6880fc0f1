"""Plans of histories: their runs, failures, and the journal that follows."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any
from unittest.mock import patch

import numpy as np

from qdgrasp_coordinator.metrics import stop_criteria
from qdgrasp_coordinator.scheduler.pipeline import Pipeline
from qdgrasp_coordinator.search.base import SearchAlgorithm
from qdgrasp_protocol.rows import Genomes, Outcome, Rows, RowShape
from qdgrasp_protocol.spec import Overlaps, RunSpec

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
    found["steps"] = 1
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
        return self.pipeline_of(self.task.search(self.population, self.seed))

    def pipeline_of(self, search: SearchAlgorithm) -> Pipeline:
        """A new pipeline of this run with a search."""
        with patch.object(stop_criteria, "WINDOW", self.window):
            return Pipeline(search, self.task.shape, self.spec)

    @property
    def spec(self) -> RunSpec:
        """Its spec, as far as its pipeline reads it."""
        return brief_spec(
            **{name: getattr(self, name) for name in ("seed", "population", "evaluations", "overlaps")},
            generations_in_flight=self.in_flight,
            in_flight=self.most_in_flight * self.population,
            trials=self.trials,
            grasps=self.grasps,
            saturation=self.saturation,
        )


def brief_spec(**values: Any) -> RunSpec:
    """A spec of some values, not checked."""
    return RunSpec(gripper="hand", object="thing", **values)


def reference(plan: Plan) -> bytes:
    """The journal of a plan whose rows arrive in the order in which they were asked."""
    pipeline, journal = plan.pipeline(), []
    while pipeline.finished is None:
        journal.append(pipeline.settle(asked(pipeline, plan.task)).rows.tobytes())
    return b"".join(journal)


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
    parts = [task.shape.empty(0)]
    while (generation := pipeline.ask()) is not None:
        rows = rows_of(generation.number, generation.genomes, task.shape)
        rows["index"], rows["trial"] = generation.indices, generation.trials
        parts.append(task.evaluate(rows))
    return np.concatenate(parts)
