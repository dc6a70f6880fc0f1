"""Curves: how busy 10 to 10 000 workers are kept, and how old the state is that a genome was made from."""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from math import isnan, nan
from pathlib import Path

from tests.simulation.fleet import Crew, Figures, Fleet, Task

SIZES = (10, 30, 100, 300, 1000, 3000, 10_000)
"""Workers."""
TURNS = 8
"""Generations that a point takes, roughly; the second half counts."""


@dataclass(frozen=True)
class Panel:
    """Lines that are compared."""

    name: str
    sizes: tuple[int, ...]
    seconds: float
    """What a point takes at least."""
    most: int
    """Batches that a point takes at most, beside two for each worker."""


@dataclass(frozen=True)
class Line:
    """A line of a panel."""

    panel: Panel
    name: str
    task: Task
    crew: dict[str, float]


RUNS = Panel("runs", SIZES, 1.0, 10_000)
BATCHES = Panel("batches", (100, 1000, 10_000), 1.0, 10_000)
CREWS = Panel("crews", (10, 100, 1000), 40.0, 15_000)
PANELS = (RUNS, BATCHES, CREWS)


def _runs() -> Iterable[Line]:
    for population, in_flight in ((500, 1), (500, 2), (500, 4), (4096, 1)):
        yield Line(RUNS, f"1 run, {in_flight} x {population}", Task(1, population, in_flight), {})
    for runs in (16, 64, 256):
        yield Line(RUNS, f"{runs} runs, 1 x 500", Task(runs), {})


def _batches() -> Iterable[Line]:
    for size in (None, 1, 16, 64):
        name = "as measured" if size is None else "1 row" if size == 1 else f"{size} rows"
        yield Line(BATCHES, name, Task(64, batch_size=size), {})


def _crews() -> Iterable[Line]:
    crews = {"alike": {}, "3 times apart": {"spread": 0.55}, "some freeze": {"freeze": 300.0}}
    for task, what in ((Task(1, 500, 2), "1 run"), (Task(64), "64 runs")):
        for name, crew in crews.items():
            yield Line(CREWS, f"{what}: {name}", task, crew)


LINES = [*_runs(), *_batches(), *_crews()]


@dataclass(frozen=True)
class Point:
    """One line at one size."""

    panel: str
    line: str
    workers: int
    figures: Figures


def measure(line: Line, workers: int) -> Point:
    """A point, over so long that every run is at its usual work."""
    task, crew = line.task, Crew(workers, **line.crew)
    work = task.runs * task.population * task.in_flight * crew.row_seconds
    seconds = max(TURNS * work / workers, line.panel.seconds)
    figures = Fleet(crew, task, seed=workers).play(seconds, line.panel.most + 2 * workers)
    return Point(line.panel.name, line.name, workers, figures)


def points() -> Iterable[Point]:
    """All points, those of few workers first."""
    for size in SIZES:
        for line in LINES:
            if size in line.panel.sizes:
                yield measure(line, size)


def write(points: Sequence[Point], file: Path) -> None:
    """The points as a table."""
    with file.open("w", newline="") as out:
        rows = [{"panel": p.panel, "line": p.line, "workers": p.workers} | asdict(p.figures) for p in points]
        table = csv.DictWriter(out, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows([_rounded(row) for row in rows])


def read(file: Path) -> list[Point]:
    """The points of a table."""
    with file.open(newline="") as lines:
        return [
            Point(
                row.pop("panel"),
                row.pop("line"),
                int(row.pop("workers")),
                Figures(**{name: float(value or nan) for name, value in row.items()}),
            )
            for row in csv.DictReader(lines)
        ]


def _rounded(row: dict[str, object]) -> dict[str, object]:
    """Four digits; nothing where nothing was seen."""
    return {
        name: ("" if isnan(value) else f"{value:.4g}") if isinstance(value, float) else value
        for name, value in row.items()
    }
