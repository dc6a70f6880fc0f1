"""The frozen benchmark: `python -m benchmarks.grasp_bench run`, and `... table` for its table and figure.

Scenes, methods, seeds and budgets are those of `benchmarks/grasp_bench_1`. Constants of searches are chosen
on the scenes of `tuning.toml` alone. `run` carries out the runs that docs/results/runs.csv lacks; `table`
makes the figure and the part between the two marks of docs/results.md.
"""

import argparse
import csv
import hashlib
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import tomli_w
from benchmarks.grasp_bench_assets import FILES, NAME, asset_name, located, make_asset
from matplotlib.ticker import NullFormatter
from numpy.typing import NDArray
from scipy.stats import bootstrap

from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.metrics.run_stats import evaluation_mask
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import RunSpec, to_values
from qdgrasp_tools.campaign.campaign_file import read_campaign

ROOT = Path(__file__).resolve().parents[1]
CAMPAIGNS = [Path(__file__).parent / "grasp_bench_1" / f"{name}.toml" for name in ("held_out", "tuning")]
TABLE, FIGURE, PAGE = (
    ROOT / "docs" / name for name in ("results/runs.csv", "results/cells-that-hold.png", "results.md")
)
MARKS = "<!-- made by python -m benchmarks.grasp_bench table -->", "<!-- end -->"
DEFAULT = "aimed"
TUNING = {("panda", thing) for thing in ("ycb_rubiks_cube", "ycb_mug", "ycb_power_drill")}
JAWS = ("panda", "robotiq_2f", "xarm", "pr2")
EVALUATIONS = {"500": 500, "1k": 1000, "2k": 2000, "5k": 5000}
"""Counted evaluations after which cells are counted, by the end of their column's name."""
SECONDS = {f"{n}s": n for n in (5, 7, 10, 14, 20, 28, 40, 56, 80)}
"""CPU seconds of the workers, likewise."""
SHOWN = ("5s", "14s", "28s", "500", "1k", "end")
"""The work after which the table compares."""
KEY = ("gripper", "object", "method", "population", "seed", "budget")
COLUMNS = (
    *KEY, "version", "code", "journal", "evaluations", "cells", "niches_that_hold", "cpu_seconds",
    "cells_that_hold", *(f"after_{name}" for name in (*EVALUATIONS, *SECONDS)),
)  # fmt: skip

Row = dict[str, str]
"""A line of the table of runs."""


def key(spec: RunSpec) -> tuple[str, ...]:
    """Return the values of `KEY` of a run; the population is that of MAP-Elites, empty for other methods."""
    population = spec.population if spec.method.endswith("me_scs") else ""
    names = (asset_name(name) or name for name in (spec.gripper, spec.object))
    return (*names, spec.method, str(population or ""), str(spec.seed), str(spec.evaluations))


def read_table(file: Path = TABLE) -> dict[tuple[str, ...], Row]:
    """Return the lines of the table of runs by key."""
    with file.open(encoding="utf-8", newline="") as lines:
        return {tuple(row[name] for name in KEY): row for row in csv.DictReader(lines)}


def write_table(table: Mapping[tuple[str, ...], Row], file: Path = TABLE) -> None:
    """Write the table of runs, sorted by key."""

    def place(item: tuple[tuple[str, ...], Row]) -> tuple[object, ...]:
        *names, population, seed, budget = item[0]
        return (*names, int(population or 0), int(budget), int(seed))

    with file.open("w", encoding="utf-8", newline="") as out:
        writer = csv.DictWriter(out, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(row for _, row in sorted(table.items(), key=place))


def measured(folder: RunFolder) -> Row:
    """Return the line of a finished run, from its journal."""
    spec = folder.spec
    with folder.journal() as journal:
        parts = list(journal.slices())
        origin = {"version": journal.package, "code": f"evaluation {journal.platform['evaluation']}"}
    rows = np.concatenate([part.rows for part in parts])
    origin["journal"] = hashlib.sha256(rows.tobytes()).hexdigest()[:16]
    spent = np.cumsum(evaluation_mask(rows, spec.overlaps))
    seconds = np.cumsum(np.concatenate([np.full(len(part), part.cpu_seconds / len(part)) for part in parts]))
    places = cells(rows["base_to_object"][:, :3])

    def found(least: Outcome, stop: int) -> int:
        return len(np.unique(places[:stop][rows["outcome"][:stop] >= least], axis=0))

    stops = {name: int(np.searchsorted(spent, n)) + 1 for name, n in EVALUATIONS.items() if n <= spent[-1]}
    stops |= {name: int(np.searchsorted(seconds, n)) + 1 for name, n in SECONDS.items() if n <= seconds[-1]}
    return {
        **dict(zip(KEY, key(spec), strict=True)),
        **origin,
        "evaluations": str(spent[-1]),
        "cells": str(found(Outcome.DROPPED, len(rows))),
        "niches_that_hold": "",
        "cpu_seconds": f"{seconds[-1]:.5g}",
        "cells_that_hold": str(found(Outcome.HELD, len(rows))),
        **{f"after_{name}": str(found(Outcome.HELD, stop)) for name, stop in stops.items()},
    }


def missing(wanted: str) -> dict[str, RunSpec]:
    """Return the runs of the benchmark that the table lacks and whose name has `wanted` in it."""
    table = read_table()
    return {
        name: spec
        for file in CAMPAIGNS
        for name, spec in read_campaign(file, here=False).runs.items()
        if wanted in name and key(spec) not in table
    }


def run(home: Path, wanted: str, *, only_list: bool) -> int:
    """Carry out missing runs as a campaign below `home`, and add each finished one to the table."""
    runs = missing(wanted)
    print(f"{len(runs)} runs are missing, {sum(spec.evaluations for spec in runs.values()):,} evaluations.")
    if only_list or not runs:
        print(*runs, sep="\n")
        return 0
    for file in FILES:
        if any(file in (Path(spec.gripper).name, Path(spec.object).name) for spec in runs.values()):
            make_asset(home / NAME / file)
    crosses = [_cross(spec, home) for spec in runs.values()]
    source = home / "missing.toml"
    source.write_text(tomli_w.dumps({"cross": crosses}), encoding="utf-8")
    command = [sys.executable, "-m", "qdgrasp", "campaign", str(source), "--out", str(home / "missing")]
    ended = subprocess.run(command, check=False).returncode
    table = read_table()
    for path in sorted((home / "missing" / "runs").iterdir()):
        folder = RunFolder(path)
        if folder.spec.evaluations <= _evaluations(folder):
            row = measured(folder)
            table[tuple(row[name] for name in KEY)] = row
    write_table(table)
    return ended


def _cross(spec: RunSpec, home: Path) -> dict[str, Any]:
    values = to_values(spec)
    return values | {name: located(values[name], home) for name in ("gripper", "object")}


def _evaluations(folder: RunFolder) -> int:
    with folder.journal() as journal:
        return int(evaluation_mask(journal.rows(0, journal.count), folder.spec.overlaps).sum())


@dataclass(frozen=True)
class Arm:
    """The runs of one method on one scene.

    Attributes
    ----------
    method
        The method; MAP-Elites with its population.
    scene
        Hand and object.
    rows
        Its runs, one a seed.
    """

    method: str
    scene: tuple[str, str]
    rows: tuple[Row, ...]

    def hold(self, work: str) -> float:
        """Return the median over runs of cells that hold after some work; NaN where a run had less."""
        name = "cells_that_hold" if work == "end" else f"after_{work}"
        return float(np.median([float(row.get(name) or "nan") for row in self.rows]))

    @cached_property
    def seconds(self) -> float:
        """CPU seconds of a run, median."""
        return float(np.median([float(row["cpu_seconds"]) for row in self.rows]))


GROUPS: dict[str, Callable[[tuple[str, str]], bool]] = {
    "held out, two fingers": lambda scene: scene not in TUNING and scene[0] in JAWS,
    "held out, more fingers": lambda scene: scene not in TUNING and scene[0] not in JAWS,
    "tuning, two fingers": lambda scene: scene in TUNING,
}


def arms(least: int = 5) -> dict[tuple[str, str], dict[str, Arm]]:
    """Return the arms of each scene by method, of those with `least` seeds."""
    found: dict[tuple[str, str], dict[str, list[Row]]] = {}
    for row in read_table().values():
        name = row["method"] + (f", population {row['population']}" if row["population"] else "")
        found.setdefault((row["gripper"], row["object"]), {}).setdefault(name, []).append(row)
    return {
        scene: {name: Arm(name, scene, tuple(rows)) for name, rows in methods.items() if len(rows) >= least}
        for scene, methods in found.items()
    }


def log_ratios(
    scenes: Sequence[Mapping[str, Arm]], other: str | None, work: str
) -> tuple[NDArray[np.float64], int]:
    """Return log(cells of the default / of the other method) for each scene, and how many are below 0.

    `other` None is the method with the most cells of each scene. Cells are counted plus one, so that a
    method which found nothing has a ratio. Scenes where a run did less work are left out.
    """
    ratios = []
    for methods in scenes:
        rest = [arm for name, arm in methods.items() if name != DEFAULT and other in (None, name)]
        if DEFAULT not in methods or not rest:
            continue
        values = [arm.hold(work) for arm in rest]
        ours = methods[DEFAULT].hold(work)
        if not np.isnan([ours, *values]).any():
            ratios.append(np.log((ours + 1) / (max(values) + 1)))
    found = np.array(ratios)
    return found, int((found < 0).sum())


def ratio_words(ratios: NDArray[np.float64]) -> str:
    """Return the geometric mean of ratios with its 95 % interval over scenes, from three scenes on."""
    if not len(ratios):
        return ""
    mean = f"{np.exp(ratios.mean()):.2f}"
    if len(ratios) < 3:
        return mean
    interval = bootstrap((ratios,), np.mean, rng=np.random.default_rng(0), method="percentile")
    low, high = np.exp(interval.confidence_interval)
    return f"{mean} ({low:.2f} to {high:.2f})"


def table_lines() -> Iterator[str]:
    """Yield the lines of the table in Markdown: the default over each other method, after equal work."""
    words = [f"{name.removesuffix('s')} CPU s" if name.endswith("s") else name for name in SHOWN]
    words = [f"{word} evaluations" if word in EVALUATIONS else word for word in words]
    head = ["scenes", "the default over", "runs", "cells that hold", "CPU s", *words]
    yield "| " + " | ".join(head) + " |"
    yield "|---|---|" + "---:|" * (len(head) - 2)
    for group, has in GROUPS.items():
        scenes = [methods for scene, methods in arms().items() if has(scene) and DEFAULT in methods]
        methods = sorted({name for one in scenes for name in one} - {DEFAULT})
        yield _line(group, f"(`{DEFAULT}` itself)", [one[DEFAULT] for one in scenes], ["1"] * len(SHOWN))
        for name in methods:
            ratios = [ratio_words(log_ratios(scenes, name, work)[0]) for work in SHOWN]
            yield _line(group, f"`{name}`", [one[name] for one in scenes if name in one], ratios)
        best = [log_ratios(scenes, None, work) for work in SHOWN]
        counts = [
            f"**{ratio_words(found)}**; behind on {n} of {len(found)}" if len(found) else ""
            for found, n in best
        ]
        yield _line(group, "**the best other of each scene**", [], counts)


def _line(group: str, name: str, known: Sequence[Arm], ratios: Sequence[str]) -> str:
    sums = ["", "", ""]
    if known:
        hold, seconds = (
            np.mean([arm.hold("end") for arm in known]),
            np.mean([arm.seconds for arm in known]),
        )
        sums = [str(sum(len(arm.rows) for arm in known)), f"{hold:.0f}", f"{seconds:.0f}"]
    return "| " + " | ".join([group, name, *sums, *ratios]) + " |"


def draw(file: Path = FIGURE) -> None:
    """Draw cells that hold over CPU seconds: medians over runs, geometric means over a group's scenes."""
    figure, panels = plt.subplots(1, len(GROUPS), figsize=(11, 3.8), layout="constrained")
    methods = sorted({name for one in arms().values() for name in one})
    colours = {name: plt.get_cmap("tab10")(number % 10) for number, name in enumerate(methods)}
    for panel, (group, has) in zip(panels, GROUPS.items(), strict=True):
        scenes = [methods for scene, methods in arms().items() if has(scene) and DEFAULT in methods]
        for name in methods:
            here = [one[name] for one in scenes if name in one]
            points = [
                (SECONDS[work], np.exp(np.log(values).mean()))
                for work in SECONDS
                if here and not np.isnan(values := np.array([arm.hold(work) + 1 for arm in here])).any()
            ]
            if points:
                panel.plot(*zip(*points, strict=True), "o-", markersize=3, color=colours[name], label=name)
        panel.set(xscale="log", yscale="log", title=f"{group}: {len(scenes)} scenes", xlabel="CPU seconds")
        panel.set_xticks([5, 10, 20, 40, 80], ["5", "10", "20", "40", "80"])
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_minor_formatter(NullFormatter())
        panel.spines[["top", "right"]].set_visible(False)
        panel.legend(fontsize=7, frameon=False)
    panels[0].set_ylabel("1 cm cells with a grasp that holds")
    figure.savefig(file, dpi=130)
    plt.close(figure)


def write_page() -> None:
    """Write the table between the marks of the page, and the figure."""
    before, rest = PAGE.read_text(encoding="utf-8").split(MARKS[0])
    behind = rest.split(MARKS[1])[1]
    part = "\n".join(["", "", *table_lines(), "", ""])
    PAGE.write_text(f"{before}{MARKS[0]}{part}{MARKS[1]}{behind}", encoding="utf-8")
    draw()


def main() -> int:
    parser = argparse.ArgumentParser("python -m benchmarks.grasp_bench", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    running = commands.add_parser("run", help="carry out the missing runs; can be stopped and run again")
    running.add_argument("--cell", default="", help="only runs with this in their name: panda-ycb_bowl")
    running.add_argument("--home", type=Path, default=ROOT / "runs" / "grasp-bench", help="their folder")
    running.add_argument("--list", action="store_true", help="print their names, and do nothing")
    commands.add_parser("table", help="make the table and the figure of docs/results.md from runs.csv")
    asked = parser.parse_args()
    if asked.command == "table":
        write_page()
        return 0
    asked.home.mkdir(parents=True, exist_ok=True)
    return run(asked.home, asked.cell, only_list=asked.list)


if __name__ == "__main__":
    sys.exit(main())
