"""The benchmark at equal CPU: `python -m benchmarks.grasp_bench run`, and `... table` for table and figure.

All methods of a scene race in one process, the one that has spent the least CPU time goes next: a busy
machine slows all alike. `run` carries out the races of `grasp_bench_1/scenes.toml` that docs/results/runs.csv
lacks; `table` makes the figure and the part between the two marks of docs/results.md.
"""

import argparse
import csv
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from time import process_time

import matplotlib.pyplot as plt
import numpy as np
from benchmarks.grasp_bench_assets import OBJECTS, make_asset
from matplotlib.ticker import NullFormatter
from numpy.typing import NDArray
from scipy.stats import bootstrap

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.geometry.object_surface import ObjectSurface
from qdgrasp_coordinator.metrics.cells import cell_keys, cells
from qdgrasp_coordinator.metrics.contact_niches import contact_niches
from qdgrasp_coordinator.scheduler.run_plan import full_spec
from qdgrasp_coordinator.search.base import search_space
from qdgrasp_coordinator.search.registry import method, prior_of
from qdgrasp_protocol.errors import JawNeeded
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.evaluator import ROWS_AT_ONCE, Evaluator

ROOT = Path(__file__).resolve().parents[1]
PLAN = tomllib.loads((Path(__file__).parent / "grasp_bench_1" / "scenes.toml").read_text())
TABLE, FIGURE, PAGE = (
    ROOT / "docs" / name for name in ("results/runs.csv", "results/at-equal-cpu.png", "results.md")
)
MARKS = "<!-- made by python -m benchmarks.grasp_bench table -->", "<!-- end -->"
DEFAULT = "portfolio"
GROUPS = {
    "tuning": "tuning, two fingers",
    "jaws": "held out, two fingers",
    "fingers": "held out, more fingers",
}
SECONDS = (4, 8, 15, 30, 60)
"""CPU seconds after which a method's finds are counted."""
SHOWN = (15, 60)
COUNTS = {"cells": "cells that hold", "contacts": "contact niches that hold"}
KEY = ("gripper", "object", "method", "seed")
COLUMNS = (*KEY, "evaluations", *(f"{count}_{n}s" for count in COUNTS for n in SECONDS))

Row = dict[str, str]
"""A line of the table of runs."""


def read_table(file: Path = TABLE) -> dict[tuple[str, ...], Row]:
    """Return the lines of the table of runs by key."""
    with file.open(encoding="utf-8", newline="") as lines:
        return {tuple(row[name] for name in KEY): row for row in csv.DictReader(lines)}


def write_table(rows: Mapping[tuple[str, ...], Row], file: Path = TABLE) -> None:
    """Write the table of runs, sorted by key."""
    with file.open("w", encoding="utf-8", newline="") as out:
        writer = csv.DictWriter(out, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(row for _, row in sorted(rows.items()))


class Racer:
    """A method in a race: its search, and what it found by the CPU time that it spent."""

    def __init__(self, spec: RunSpec, evaluator: Evaluator) -> None:
        self.spec, self._evaluator = spec, evaluator
        self._prior = prior_of(spec)
        began = process_time()
        self._search = method(spec.method).build(spec, search_space(evaluator.scene, self._prior))
        if self._prior == "antipodal":  # each of its workers finds these, or a search does itself
            _ = ObjectSurface(evaluator.scene).opposites
        self.seconds = process_time() - began
        self._generation = 0
        self._held = [np.zeros((0, 3), np.uint64)]  # Cell, contact niche and hundredth of a second of each
        self.evaluations = 0

    def step(self) -> None:
        """Evaluate the next generation."""
        began = process_time()
        genomes, parts = self._search.ask(self._generation), []
        for start in range(0, len(genomes), ROWS_AT_ONCE):
            some = genomes[start : start + ROWS_AT_ONCE]
            rows = self._evaluator.evaluate(self._prior, some, np.zeros(len(some), np.uint16)).rows
            rows["generation"], rows["index"] = self._generation, start + np.arange(len(some))
            self._count(rows, self.seconds + process_time() - began)
            parts.append(rows)
        self._search.tell(self._generation, np.concatenate(parts))
        self._generation += 1
        self.seconds += process_time() - began

    def _count(self, rows: NDArray[np.void], seconds: float) -> None:
        self.evaluations += int(np.count_nonzero(rows["outcome"] >= Outcome.MISSED))
        held = rows[rows["outcome"] == Outcome.HELD]
        keys = cell_keys(cells(held["base_to_object"][:, :3])).astype(np.uint64)
        when = np.full(len(held), round(100 * seconds), np.uint64)
        self._held.append(np.column_stack([keys, contact_niches(held), when]))

    def line(self) -> Row:
        """Return its line of the table."""
        held = np.concatenate(self._held)
        found = {
            f"{count}_{n}s": str(len(np.unique(held[held[:, 2] <= 100 * n, place])))
            for place, count in enumerate(COUNTS)
            for n in SECONDS
        }
        spec = self.spec
        thing = f"grasp-bench-1/{Path(spec.object).name}" if "/" in spec.object else spec.object
        values = (spec.gripper, thing, spec.method, str(spec.seed), str(self.evaluations))
        return dict(zip((*KEY, "evaluations"), values, strict=True)) | found


def race(gripper: str, thing: str, seed: int, home: Path) -> list[Row]:
    """Let all methods of a scene run for the same CPU time; return their lines."""
    values = {"gripper": gripper, "object": thing, "seed": seed, "surface_seed": seed, "engine": "mujoco"}
    values |= {"protocol": "physical", "overlaps": "redraw", "evaluations": 10**6}
    if thing.startswith("grasp-bench-1/"):
        file = home / Path(thing).name
        if not file.exists():
            make_asset(file)
        values |= {"object": str(file), "mass": OBJECTS[file.stem].mass}
    with Evaluator(build_scene(full_spec(values))) as evaluator:
        racers = []
        for name, more in PLAN["methods"].items():
            try:
                racers.append(Racer(full_spec(values | {"method": name} | more), evaluator))
            except JawNeeded:
                continue  # this prior is not for such a hand
        for racer in racers:  # what all need once, such as the distances that a closing hand covers
            racer.step()
            racer.__init__(racer.spec, evaluator)  # type: ignore[misc]
        while running := [racer for racer in racers if racer.seconds < SECONDS[-1]]:
            min(running, key=lambda racer: racer.seconds).step()
    return [racer.line() for racer in racers]


def run(wanted: str, most_seeds: int, *, only_list: bool) -> None:
    """Carry out the races that the table lacks, one seed of all scenes after another."""
    scenes = [tuple(scene) for group in GROUPS for scene in PLAN[group]]
    *_, last = PLAN["methods"]  # of all hands; races with fewer methods are carried out again
    known = {
        (row["gripper"], row["object"], row["seed"]) for row in read_table().values() if row["method"] == last
    }
    missing = [
        (*scene, seed)
        for seed in PLAN["seeds"][:most_seeds]
        for scene in scenes
        if (*scene, str(seed)) not in known and wanted in "-".join((*scene, f"s{seed}"))
    ]
    print(*("-".join((*scene, f"s{seed}")) for *scene, seed in missing), sep="\n")
    for gripper, thing, seed in () if only_list else missing:
        with tempfile.TemporaryDirectory() as home:
            lines = race(gripper, thing, seed, Path(home))
        table = read_table() | {tuple(line[name] for name in KEY): line for line in lines}
        write_table(table)
        print(*(", ".join(f"{key} {value}" for key, value in line.items()) for line in lines), sep="\n")


def medians(rows: Sequence[Row], column: str) -> dict[str, float]:
    """Return the median over seeds of a column, by method."""
    found: dict[str, list[float]] = {}
    for row in rows:
        found.setdefault(row["method"], []).append(float(row[column]))
    return {name: float(np.median(values)) for name, values in found.items()}


def ratio(rows: Sequence[Row], column: str, other: str | None = None) -> float:
    """Return the default over another method of a scene, or over the best other; NaN: it is not there.

    Counts are taken plus one, so that a method that found nothing has a ratio.
    """
    values = medians(rows, column)
    ours = values.pop(DEFAULT, np.nan)
    rest = [value for name, value in values.items() if other in (None, name)]
    return (ours + 1) / (max(rest) + 1) if rest else np.nan


def mean_words(ratios: NDArray[np.float64]) -> str:
    """Return the geometric mean of ratios with its 95 % interval over scenes, from three scenes on."""
    ratios = np.log(ratios[~np.isnan(ratios)])
    if not len(ratios):
        return ""
    mean = f"{np.exp(ratios.mean()):.2f}"
    if len(ratios) < 3:
        return mean
    interval = bootstrap((ratios,), np.mean, rng=np.random.default_rng(0), method="percentile")
    low, high = np.exp(interval.confidence_interval)
    return f"{mean} ({low:.2f} to {high:.2f})"


def scenes_of(group: str) -> dict[tuple[str, str], list[Row]]:
    """Return the lines of a group's scenes that are in, by scene."""
    found: dict[tuple[str, str], list[Row]] = {}
    for row in read_table().values():
        if [row["gripper"], row["object"]] in PLAN[group]:
            found.setdefault((row["gripper"], row["object"]), []).append(row)
    return found


def table_lines() -> Iterator[str]:
    """Yield the table in Markdown: the default over each other method, then each scene."""
    columns = [(count, n) for n in SHOWN for count in COUNTS]
    yield "| scenes | the default over | " + " | ".join(f"{COUNTS[c]}, {n} CPU s" for c, n in columns) + " |"
    yield "|---|---|" + "---:|" * len(columns)
    for group, words in GROUPS.items():
        scenes = scenes_of(group)
        others = [name for name in PLAN["methods"] if name != DEFAULT]
        for name in [*others, None]:
            cells_ = [
                np.array([ratio(rows, f"{count}_{n}s", name) for rows in scenes.values()])
                for count, n in columns
            ]
            if any(len(each) and not np.isnan(each).all() for each in cells_):
                label = f"`{name}`" if name else "**the best other of each scene**"
                yield f"| {words} | {label} | " + " | ".join(map(mean_words, cells_)) + " |"
        for (hand, thing), rows in scenes.items():
            found = [
                f"{medians(rows, f'{c}_{n}s')[DEFAULT]:.0f}, {ratio(rows, f'{c}_{n}s'):.2f}"
                for c, n in columns
            ]
            seeds = len({row["seed"] for row in rows})
            yield (
                f"| {hand} on {Path(thing).stem} ({seeds}) | count, over the best other | "
                + " | ".join(found)
                + " |"
            )


def draw(file: Path = FIGURE) -> None:
    """Draw both counts over CPU seconds: geometric means over scenes of medians over seeds."""
    groups = {words: scenes for group, words in GROUPS.items() if (scenes := scenes_of(group))}
    size = (1 + 3.3 * len(groups), 6.5)
    figure, panels = plt.subplots(2, len(groups), figsize=size, layout="constrained", squeeze=False)
    names = list(PLAN["methods"])
    for (words, scenes), column in zip(groups.items(), panels.T, strict=True):
        for (count, label), panel in zip(COUNTS.items(), column, strict=True):
            for place, name in enumerate(names):
                have = [rows for rows in scenes.values() if any(row["method"] == name for row in rows)]
                means = [
                    np.exp(np.mean([np.log(medians(rows, f"{count}_{n}s")[name] + 1) for rows in have]))
                    for n in SECONDS
                    if have
                ]
                if means:
                    colour = plt.get_cmap("tab10")(place)
                    panel.plot(SECONDS, means, "o-", markersize=3, color=colour, label=name)
            panel.set(xscale="log", yscale="log", title=f"{words}: {len(scenes)} scenes")
            panel.set(xlabel="CPU seconds", ylabel=label, xticks=SECONDS, xticklabels=SECONDS)
            panel.xaxis.set_minor_formatter(NullFormatter())
            panel.spines[["top", "right"]].set_visible(False)
    for panel in panels[0]:
        if panel.lines:
            panel.legend(fontsize=7, frameon=False)
    figure.savefig(file, dpi=110)
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
    running = commands.add_parser("run", help="carry out the missing races; can be stopped and run again")
    running.add_argument("--scene", default="", help="only races with this in their name: panda-ycb_bowl-s1")
    running.add_argument("--seeds", type=int, default=len(PLAN["seeds"]), help="only so many seeds of each")
    running.add_argument("--list", action="store_true", help="print their names, and do nothing")
    commands.add_parser("table", help="make the table and the figure of docs/results.md from runs.csv")
    asked = parser.parse_args()
    if asked.command == "table":
        write_page()
    else:
        run(asked.scene, asked.seeds, only_list=asked.list)
    return 0


if __name__ == "__main__":
    sys.exit(main())
