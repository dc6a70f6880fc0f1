"""Costs on this machine, as CPU time: `make bench`, or `python -m benchmarks`.

Arms that are compared take turns in this one process: read the figures as ratios.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from statistics import median
from time import perf_counter, process_time
from typing import NamedTuple

import numpy as np
from benchmarks.single_run import run
from rich.console import Console
from rich.table import Table

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import layout
from qdgrasp_coordinator.metrics.success_metrics import cell_growth
from qdgrasp_coordinator.scheduler.run_plan import full_spec
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import DEFAULT_METHOD, RunSpec
from qdgrasp_worker.evaluator import Evaluator

ROUNDS = 5
"""Times that each arm is measured, in turns."""
PRIOR = "contact"
SCENES = (
    ("panda", "rubiks_cube"),
    ("panda", "mug"),
    ("robotiq_2f", "mug"),
    ("barrett", "rubiks_cube"),
    ("allegro", "rubiks_cube"),
    ("shadow", "rubiks_cube"),
)
PROTOCOLS = (("paper", "bullet"), ("physical", "bullet"), ("physical", "mujoco"))
SEARCHES = (DEFAULT_METHOD, "antipodal_rand", "contact_me_scs")
COMMANDS = {
    "qdgrasp --help": ["--help"],
    "a run of four evaluations": ["run", "--object=mug", "--gripper=panda", "--evaluations=4", "--workers=1"],
}


class Line(NamedTuple):
    """A measured arm.

    Attributes
    ----------
    name
        The arm.
    milliseconds
        CPU milliseconds of one piece of its work in each round.
    remark
        What came of it.
    """

    name: str
    milliseconds: Sequence[float]
    remark: str = ""


def evaluations(rows: int) -> Iterator[Line]:
    """Measure random genomes of the prior `contact` on each scene, in each protocol and engine."""
    for gripper, thing in SCENES:
        scenes = [
            build_scene(RunSpec(gripper=gripper, object=thing, protocol=protocol, engine=engine))
            for protocol, engine in PROTOCOLS
        ]
        evaluators = [Evaluator(scene) for scene in scenes]
        times: list[list[float]] = [[] for _ in evaluators]
        touched = [0] * len(evaluators)
        random = np.random.default_rng(0)
        for _ in range(ROUNDS):
            genomes = random.uniform(-1, 1, (rows, len(layout(scenes[0], PRIOR)))).astype(np.float32)
            for number, evaluator in enumerate(evaluators):
                began = process_time()
                found = evaluator.evaluate(PRIOR, genomes, np.zeros(rows, np.uint16)).rows
                times[number].append(1000 * (process_time() - began) / rows)
                touched[number] += int((found["outcome"] >= Outcome.DROPPED).sum())
        for (protocol, engine), spent, touches in zip(PROTOCOLS, times, touched, strict=True):
            remark = f"{touches / rows / ROUNDS:.0%} touch"
            yield Line(f"an evaluation, {gripper} on {thing}, {protocol}, {engine}", spent, remark)
        for evaluator in evaluators:
            evaluator.close()


def searches(rows: int) -> Iterator[Line]:
    """Measure whole runs without bus and recorder: the search's share, and the cells that hold."""
    for name in SEARCHES:
        whole, shares, cells = [], [], []
        for seed in range(2):
            values = {"gripper": "panda", "object": "mug", "method": name, "seed": seed, "engine": "mujoco"}
            found = run(full_spec(values | {"protocol": "physical", "evaluations": 10 * rows}))
            seconds = found.evaluation_seconds + found.search_seconds
            whole.append(1000 * seconds / found.evaluations[-1])
            shares.append(found.search_seconds / seconds)
            cells.append(cell_growth(found.successes, Outcome.HELD).end / seconds)
        remark = f"{median(shares):.1%} in the search; {median(cells):.1f} cells that hold a CPU second"
        yield Line(f"an evaluation of a run, panda on mug, {name}", whole, remark)


def starts(_: int) -> Iterator[Line]:
    """Measure commands from their start to their end, with all their processes."""
    for name, arguments in COMMANDS.items():
        spent, walls = [], []
        for _round in range(3):
            with tempfile.TemporaryDirectory() as folder:
                before, began = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
                line = [sys.executable, "-m", "qdgrasp", *arguments]
                subprocess.run(line, cwd=folder, check=True, capture_output=True)
                after = resource.getrusage(resource.RUSAGE_CHILDREN)
                walls.append(perf_counter() - began)
                spent.append(1000 * (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime))
        yield Line(name, spent, f"{median(walls):.2f} s of wall time")


PARTS = {"evaluations": evaluations, "searches": searches, "starts": starts}


def main() -> None:
    parser = argparse.ArgumentParser("python -m benchmarks", description=__doc__)
    parser.add_argument("--only", action="append", choices=list(PARTS), help="a part; may be repeated")
    parser.add_argument("--rows", type=int, default=100, help="evaluations of each arm in a round")
    asked = parser.parse_args()
    console = Console(width=140)
    for part in asked.only or PARTS:
        table = Table(
            "what", "CPU ms", "fastest to slowest round", "remark", title=part, title_justify="left"
        )
        for line in PARTS[part](asked.rows):
            spent = line.milliseconds
            table.add_row(
                line.name, f"{median(spent):.2f}", f"{min(spent):.2f} to {max(spent):.2f}", line.remark
            )
        console.print(table)


if __name__ == "__main__":
    main()
