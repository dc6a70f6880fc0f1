"""Memory of a worker's process: its growth with evaluations, and its size with eight scenes.

`python -m benchmarks.memory [--share S]`. Each series is measured in a process of its own; `--share`
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

SAMPLES = 20
"""Samples of memory in a series; the first fifth of it is warming up."""
BATCH = ROWS_AT_ONCE
MEGABYTE = 1 << 20
Genomes = NDArray[np.float32]
EIGHT_SCENES = tuple(
    (gripper, thing)
    for gripper in ("panda", "allegro", "barrett", "shadow")
    for thing in ("mug", "power_drill")
)
"""Scenes, as many as a worker keeps."""


@dataclass(frozen=True)
class EvaluationSeries:
    """Evaluations of random genomes, one after the other."""

    gripper: str
    object: str
    prior: str
    evaluations: int

    @property
    def words(self) -> str:
        return f"{self.gripper} {self.object} {self.prior}, {self.evaluations:,} genomes"


SERIES = (
    EvaluationSeries("panda", "rubiks_cube", "contact", 100_000),
    EvaluationSeries("panda", "mug", VALUED, 3_000),
)


@dataclass(frozen=True)
class MemoryUse:
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


def measure_memory(series: EvaluationSeries) -> MemoryUse:
    """Evaluate random genomes and read the memory of this process."""
    scene = build_scene(RunSpec(gripper=series.gripper, object=series.object))
    sizes, random = [status("VmRSS")], np.random.default_rng(0)
    with Evaluator(scene) as evaluator:
        for _ in range(SAMPLES):
            evaluate(evaluator, series.prior, series.evaluations // SAMPLES, random)
            sizes.append(status("VmRSS"))
    return MemoryUse(tuple(sizes), status("VmHWM"))


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


def measure_scenes(scenes: tuple[tuple[str, str], ...] = EIGHT_SCENES) -> MemoryUse:
    """Keep as many scenes as a worker does, and evaluate genomes of two priors on each."""
    random, sizes = np.random.default_rng(0), [status("VmRSS")]
    assert len(scenes) <= MAX_EVALUATORS
    with EvaluatorCache() as evaluators:
        for gripper, thing in scenes:
            payload = pack_scene(build_scene(RunSpec(gripper=gripper, object=thing))).payload
            evaluator = evaluators.get(
                f"{gripper} {thing}", lambda payload=payload: Evaluator(unpack_scene(payload))
            )
            for prior in ("contact", VALUED):
                evaluate(evaluator, prior, 2 * ROWS_AT_ONCE, random)
            sizes.append(status("VmRSS"))
    return MemoryUse(tuple(sizes), status("VmHWM"))


def in_new_process(act: Callable[..., MemoryUse], *arguments: object) -> MemoryUse:
    """The result of a function in a new process."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(act, arguments)


def shortened(series: EvaluationSeries, share: float) -> EvaluationSeries:
    """The series with this share of its evaluations."""
    return EvaluationSeries(series.gripper, series.object, series.prior, int(series.evaluations * share))


def measure(seconds: float) -> list[Figure]:
    """Lines of `make bench`: the memory of a worker, counted in MB; `seconds` plays no role."""
    eight = in_new_process(measure_scenes)
    name = f"memory of a worker with {len(EIGHT_SCENES)} scenes"
    return [Figure(name, round(eight.peak), 1.0, "none", "MB at the peak, the overlap filter on")]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.memory", description=__doc__)
    parser.add_argument("--share", type=float, default=1.0)
    asked = parser.parse_args()
    found = {
        series.words: in_new_process(measure_memory, series)
        for series in (shortened(each, asked.share) for each in SERIES)
    }
    values = {
        name: {"growth": each.growth, "peak": each.peak, "sizes": each.sizes} for name, each in found.items()
    }
    eight = in_new_process(measure_scenes)
    values[f"{len(EIGHT_SCENES)} scenes"] = {"peak": eight.peak, "sizes": eight.sizes}
    sys.stdout.write(json.dumps(values, indent=1) + "\n")


if __name__ == "__main__":
    main()
