"""Utilisation of 10 to 3000 workers, and the age of the state behind a genome: `make simulate-curves`."""

import csv
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, fields
from math import inf, isnan, nan
from pathlib import Path
from statistics import fmean

from benchmarks.scale.fleet_simulation import (
    ALONE,
    GENOMES,
    IN_CAMPAIGN,
    MANY,
    Figures,
    FleetSimulation,
    Task,
    WorkerProfile,
)
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qdgrasp_coordinator.scheduler.pipeline import Flight
from qdgrasp_tools.report.figure_grid import FAINT, INK, RULE

SIZES = (10, 30, 100, 300, 1000, 3000)
"""Workers."""
SETTLED, SETTLED_EACH, SETTLED_OF_ONE = 4000, 16, 16_000
"""Batches of a point of many runs, in all and more for each worker; of a point of one run that goes on."""
RUNS = 8  # Runs of a point of whole runs: a few slow rows decide how long one takes
FREEZING = 20.0
"""Duration of a point with workers that freeze [s]."""


@dataclass(frozen=True)
class Panel:
    """Lines that are compared."""

    name: str
    sizes: tuple[int, ...]


@dataclass(frozen=True)
class Line:
    """A line of a panel."""

    panel: Panel
    name: str
    task: Task
    profile: dict[str, float] = field(default_factory=dict)
    sizes: tuple[int, ...] = SIZES
    """Numbers of workers."""


ONE = Panel("one run", (10, 30, 100, 300, 1000))
MANY_RUNS = Panel("campaigns", (300, 1000, 3000))
PROFILES = Panel("worker profiles", (30, 100))
PANELS = (ONE, MANY_RUNS, PROFILES)


def _lines() -> Iterable[Line]:
    yield Line(ONE, "100 in flight", Task(genomes=GENOMES), sizes=(10, 30, 100, 300))
    yield Line(ONE, "100 to 1200, as runs have it", Task(genomes=GENOMES, flight=ALONE))
    yield Line(ONE, "1200 in flight", Task(flight=Flight(24)))
    yield Line(MANY_RUNS, "256 runs, 50 in flight", Task(256, flight=Flight(1)))
    yield Line(MANY_RUNS, "256 runs, 400, as campaigns have it", Task(256, flight=IN_CAMPAIGN))
    ends = Task(256, flight=IN_CAMPAIGN, genomes=2000, build=10.0)
    yield Line(MANY_RUNS, "of 2000 genomes, each after 10 s of building", ends)
    shares = Task(256, flight=IN_CAMPAIGN, shards=4)
    yield Line(MANY_RUNS, "four shares of 256 runs each", shares, sizes=(1000, 3000))
    alone, campaign = Task(flight=Flight(24)), Task(64, flight=IN_CAMPAIGN)
    profiles = {"alike": {}, "3 times apart": {"spread": 0.55}, "some freeze": {"freeze": 300.0}}
    for task, what in ((alone, "1 run"), (campaign, "64 runs")):
        for name, profile in profiles.items():
            yield Line(PROFILES, f"{what}: {name}", task, profile)


LINES = [*_lines()]


@dataclass(frozen=True)
class Point:
    """One line at one size."""

    panel: str
    line: str
    workers: int
    figures: Figures


def measure(line: Line, workers: int) -> Point:
    """A point: the mean of runs from beginning to end, or, where runs go on, the second half of its time."""
    task, profile = line.task, WorkerProfile(workers // line.task.shards, **line.profile)
    if task.runs == 1 and task.genomes < MANY:
        whole = [FleetSimulation(profile, task, seed).run(inf, MANY, since=0.0) for seed in range(RUNS)]
        figures = Figures(
            **{one.name: fmean(getattr(one_run, one.name) for one_run in whole) for one in fields(Figures)}
        )
    else:
        fleet = FleetSimulation(profile, task, seed=workers)
        some = SETTLED_OF_ONE if task.runs == 1 else SETTLED + SETTLED_EACH * profile.workers
        freezes = "freeze" in line.profile
        figures = fleet.run(FREEZING if freezes else inf, MANY if freezes else some)
    return Point(line.panel.name, line.name, workers, figures)


def points() -> Iterable[Point]:
    """All points, those of few workers first."""
    for size in SIZES:
        for line in LINES:
            if size in line.panel.sizes and size in line.sizes:
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
    """A number to four digits; empty where there is none."""
    return {
        name: ("" if isnan(value) else f"{value:.4g}") if isinstance(value, float) else value
        for name, value in row.items()
    }


TITLES = {
    "one run": "One run of the default method, by genomes in flight",
    "campaigns": "Campaigns: share of time that counts",
    "worker profiles": "1 run of 1200, and 64 runs, where workers differ or freeze",
    "age": "From the ask of a generation to its tell, one run",
}
LEGEND_PLACES = {
    "one run": "lower left",
    "campaigns": "lower left",
    "worker profiles": "lower left",
    "age": "upper right",
}
HUES = ("#0072b2", "#56b4e9", "#009e73", "#4d4d4d", "#e69f00", "#d55e00", "#cc79a7")
"""Colours of Okabe and Ito."""


def make(folder: Path) -> int:
    """Measure all points where the folder has no table of them, and draw them."""
    folder.mkdir(parents=True, exist_ok=True)
    table = folder / "curves.csv"
    if not table.exists():
        found, part = [], table.with_suffix(".part")
        for point in points():
            found.append(point)
            write(found, part)
        part.rename(table)
    draw(read(table)).savefig(folder / "curves.png", dpi=130)
    return 0


def draw(found: Sequence[Point]) -> Figure:
    """Four panels."""
    figure = Figure(figsize=(11, 7.6), layout="constrained")
    (one, age), (many, profiles) = figure.subplots(2, 2)
    _share(one, ONE, found)
    _age(age, found)
    _share(many, MANY_RUNS, found)
    _share(profiles, PROFILES, found)
    return figure


def _share(axes: Axes, panel: Panel, found: Sequence[Point]) -> None:
    _draw_lines(axes, panel, found, "utilisation", 100.0)
    axes.set_ylim(0, 103)
    axes.set_ylabel("share of the workers' time that counts [%]", color=FAINT)
    _style_axes(axes, panel.name)


def _age(axes: Axes, found: Sequence[Point]) -> None:
    _draw_lines(axes, ONE, found, "age", 1.0)
    axes.set_yscale("log")
    axes.set_ylabel("seconds", color=FAINT)
    _style_axes(axes, "age")


def _draw_lines(axes: Axes, panel: Panel, found: Sequence[Point], figure: str, scale: float) -> None:
    names = [line.name for line in LINES if line.panel == panel]
    for place, name in enumerate(names):
        of_line = [point for point in found if (point.panel, point.line) == (panel.name, name)]
        sizes = [point.workers for point in of_line]
        values = [scale * getattr(point.figures, figure) for point in of_line]
        is_second = panel == PROFILES and place >= len(names) // 2
        colour = HUES[place % (len(names) // 2)] if panel == PROFILES else HUES[place]
        axes.plot(sizes, values, "--" if is_second else "-", color=colour, marker="o", ms=3.5, label=name)


def _style_axes(axes: Axes, what: str) -> None:
    axes.set_xscale("log")
    axes.set_xlim(SIZES[0] * 0.85, SIZES[-1] * 1.18)
    axes.set_xticks(SIZES, [f"{size:,}".replace(",", " ") for size in SIZES])
    axes.minorticks_off()
    axes.set_xlabel("workers", color=FAINT)
    axes.set_title(TITLES[what], loc="left", fontsize=10.5, color=INK)
    axes.grid(color=RULE, lw=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=FAINT, labelsize=8.5)
    if what != "age":  # same lines as in the panel beside it
        axes.legend(loc=LEGEND_PLACES[what], frameon=False, fontsize=8, labelcolor=INK)


if __name__ == "__main__":
    sys.exit(make(Path(sys.argv[1])))
