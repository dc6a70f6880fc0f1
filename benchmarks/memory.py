"""Memory of a worker's process: its growth with evaluations, and its size with eight scenes.

`python -m benchmarks.memory [--share S]`. Each course is followed in a process of its own; `--share`
takes that part of its evaluations.
"""

import argparse
import json
import multiprocessing
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from benchmarks.measure import Figure
from numpy.typing import NDArray
from tests.worker.genomes import encoded, facing

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import MOST_CANDIDATES, VALUED, layout
from qdgrasp_assets.scene import Scene, pack_scene, unpack_scene
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.evaluator import MAX_EVALUATORS, ROWS_AT_ONCE, Evaluator, EvaluatorCache

LOOKS = 20
"""Samples of memory in a course; the first fifth of it is warming up."""
BATCH = ROWS_AT_ONCE
MEGABYTE = 1 << 20
Genomes = NDArray[np.float32]
EIGHT = tuple(
    (gripper, thing)
    for gripper in ("panda", "allegro", "barrett", "shadow")
    for thing in ("mug", "power_drill")
)
"""Scenes, as many as a worker keeps."""


@dataclass(frozen=True)
class Course:
    """Evaluations of random genomes, one after the other."""

    gripper: str
    object: str
    prior: str
    evaluations: int

    @property
    def words(self) -> str:
        return f"{self.gripper} {self.object} {self.prior}, {self.evaluations:,} genomes"


COURSES = (
    Course("panda", "rubiks_cube", "contact", 100_000),
    Course("panda", "mug", VALUED, 3_000),
)


@dataclass(frozen=True)
class Found:
    """Memory of a process over time [MB]."""

    sizes: tuple[float, ...]
    """Resident memory at equal intervals."""
    peak: float

    @property
    def growth(self) -> float:
        """Growth from the end of warming up to the end."""
        return self.sizes[-1] - self.sizes[len(self.sizes) // 5]


def status(name: str) -> float:
    """A line of this process's status, such as VmRSS or VmHWM [MB]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    value = next(line for line in lines if line.startswith(name + ":"))
    return int(value.split()[1]) * 1024 / MEGABYTE


def follow(course: Course) -> Found:
    """Evaluate random genomes and look at the memory of this process."""
    scene = build_scene(RunSpec(gripper=course.gripper, object=course.object))
    sizes, random = [status("VmRSS")], np.random.default_rng(0)
    with Evaluator(scene) as evaluator:
        for _ in range(LOOKS):
            evaluate(evaluator, course.prior, course.evaluations // LOOKS, random)
            sizes.append(status("VmRSS"))
    return Found(tuple(sizes), status("VmHWM"))


def evaluate(evaluator: Evaluator, prior: str, number: int, random: np.random.Generator) -> None:
    """Evaluate so many random genomes."""
    for start in range(0, number, BATCH):
        n = min(BATCH, number - start)
        evaluator.evaluate(prior, DRAWN[prior](evaluator.scene, n, random), np.zeros(n, np.uint16))


def anywhere(scene: Scene, n: int, random: np.random.Generator) -> Genomes:
    """Genomes (n, d) of the prior contact."""
    return random.uniform(-1.0, 1.0, (n, len(layout(scene, "contact")))).astype(np.float32)


def above(scene: Scene, n: int, random: np.random.Generator) -> Genomes:
    """Genomes (n, d) of the prior valued, that look at the surface, of as many candidates as there may be."""
    seed = int(random.integers(1 << 32))
    values = facing(scene, n, candidates=MOST_CANDIDATES, looseness=1.0, seed=seed, prior=VALUED)
    return encoded(scene, values, VALUED)


DRAWN = {"contact": anywhere, VALUED: above}
"""Functions that draw genomes, by prior."""


def serve(scenes: tuple[tuple[str, str], ...] = EIGHT) -> Found:
    """Keep as many scenes as a worker does, and evaluate genomes of two priors on each."""
    random, sizes = np.random.default_rng(0), [status("VmRSS")]
    assert len(scenes) <= MAX_EVALUATORS
    with EvaluatorCache() as worlds:
        for gripper, thing in scenes:
            payload = pack_scene(build_scene(RunSpec(gripper=gripper, object=thing))).payload
            evaluator = worlds.get(
                f"{gripper} {thing}", lambda payload=payload: Evaluator(unpack_scene(payload))
            )
            for prior in ("contact", VALUED):
                evaluate(evaluator, prior, 2 * ROWS_AT_ONCE, random)
            sizes.append(status("VmRSS"))
    return Found(tuple(sizes), status("VmHWM"))


def apart(act: Callable[..., Found], *arguments: object) -> Found:
    """The result of a function in a new process."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(act, arguments)


def shortened(course: Course, share: float) -> Course:
    """The course with this share of its evaluations."""
    return Course(course.gripper, course.object, course.prior, int(course.evaluations * share))


def measure(seconds: float) -> list[Figure]:
    """Lines of `make bench`: the memory of a worker, counted in MB; `seconds` plays no role."""
    eight = apart(serve)
    name = f"memory of a worker with {len(EIGHT)} scenes"
    return [Figure(name, round(eight.peak), 1.0, "none", "MB at the peak, the overlap filter on")]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.memory", description=__doc__)
    parser.add_argument("--share", type=float, default=1.0)
    asked = parser.parse_args()
    found = {
        course.words: apart(follow, course) for course in (shortened(each, asked.share) for each in COURSES)
    }
    values = {
        name: {"growth": each.growth, "peak": each.peak, "sizes": each.sizes} for name, each in found.items()
    }
    eight = apart(serve)
    values[f"{len(EIGHT)} scenes"] = {"peak": eight.peak, "sizes": eight.sizes}
    sys.stdout.write(json.dumps(values, indent=1) + "\n")


if __name__ == "__main__":
    main()
