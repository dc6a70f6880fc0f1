"""MuJoCo Warp on a device beside MuJoCo on all cores: `python -m benchmarks.physics.device cuda`.

Genomes are the first ones of the prior `contact`, drawn with seed 11, at which the Panda touches the object
in MuJoCo, so that each is simulated in both. Rates are of them: on the device over the wall time of batches
of several sizes, after a first one that compiles kernels and records graphs; in MuJoCo over the CPU time of
processes that all cores run at once. Objects are those of the tuning scenes.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from functools import partial
from statistics import median
from typing import Any

import numpy as np
from benchmarks.side_by_side import side_by_side
from numpy.typing import NDArray

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.device import Device
from qdgrasp_worker.engines.lockstep import BatchWorlds
from qdgrasp_worker.engines.warp_worlds import WarpEvaluator, device_entries
from qdgrasp_worker.evaluator import BatchEvaluator, Evaluator

OBJECTS = ("ycb_rubiks_cube", "ycb_mug", "ycb_power_drill")
PRIOR, SEED = "contact", 11
CHUNK = 1024
ROUNDS = 2
SETTLED = 3  # Components of the settled position


def scene_of(target: str, engine: str) -> Scene:
    """The scene of the Panda and an object in an engine."""
    return build_scene(RunSpec(gripper="panda", object=target, protocol="physical", engine=engine))  # type: ignore[arg-type]


def say(words: str) -> None:
    """Show progress."""
    print(f"{time.strftime('%X')} {words}", file=sys.stderr, flush=True)


def evaluated(evaluator: BatchEvaluator, genomes: NDArray[np.float32]) -> Rows:
    """The rows of genomes; a RuntimeError if one of them failed."""
    found = evaluator.evaluate(PRIOR, genomes, np.zeros(len(genomes), dtype=np.uint16))
    if found.failures:
        raise RuntimeError(f"{len(found.failures)} rows failed: {found.failures[0][1]}")
    return found.rows


def touching(target: str, chunk: int) -> tuple[Rows, float]:
    """The rows of a chunk of genomes that touch in MuJoCo, and the CPU seconds that they take alone."""
    scene = scene_of(target, "mujoco")
    random = np.random.default_rng([SEED, chunk])
    genomes = random.uniform(-1.0, 1.0, (CHUNK, len(layout(scene, PRIOR)))).astype(np.float32)
    with Evaluator(scene) as evaluator:
        outcomes = evaluated(evaluator, genomes)["outcome"]
        chosen = genomes[[Outcome(outcome).is_touched for outcome in outcomes.tolist()]]
        started = time.process_time()
        rows = evaluated(evaluator, chosen)
        return rows, time.process_time() - started


def touching_rows(target: str, n: int, processes: int) -> tuple[Rows, float]:
    """The first n rows that touch in MuJoCo, and how many of them a core evaluates in a second."""
    scene_of(target, "mujoco")  # builds the shapes once
    found: dict[int, tuple[Rows, float]] = {}
    while sum(len(rows) for rows, _ in found.values()) < n:
        chunks = range(len(found), len(found) + max(processes, 2))
        found |= dict(side_by_side(partial(touching, target), chunks, processes))
    rows = np.concatenate([found[chunk][0] for chunk in sorted(found)])
    return rows[:n], len(rows) / sum(seconds for _, seconds in found.values())


class Stopwatch:
    """Measures the wall time of `BatchWorlds.advance`, with the copies from and to the device."""

    def __init__(self, *worlds: BatchWorlds) -> None:
        self.seconds = 0.0
        for each in worlds:
            each.advance = partial(self._timed, each.advance)  # type: ignore[method-assign]

    def _timed(self, advance: Any, *arguments: Any) -> Any:
        started = time.perf_counter()
        result = advance(*arguments)
        self.seconds += time.perf_counter() - started
        return result


def figures(device: str, target: str, sizes: Sequence[int], processes: int) -> dict[str, Any]:
    """The figures of an object."""
    expected, core = touching_rows(target, max(sizes), processes)
    started = time.perf_counter()
    with WarpEvaluator(scene_of(target, "mujoco-warp"), Device(device, max(sizes))) as evaluator:
        row: dict[str, Any] = {"object": target, "a core in mujoco": core, "cores": processes}
        row |= device_entries(Device(device, max(sizes)))
        row["seconds to start"] = time.perf_counter() - started
        say(f"{target}: {core:.0f} a second on a core in mujoco, {len(expected)} rows that touch")
        watch = Stopwatch(evaluator._fixed, evaluator._free)
        found: dict[int, Rows] = {}
        for size in sizes:
            genomes = expected["genome"][:size]
            started = time.perf_counter()
            found[size] = evaluated(evaluator, genomes)
            row[f"{size}: first [s]"] = first = time.perf_counter() - started
            took, watch.seconds = [], 0.0
            for _ in range(ROUNDS):
                started = time.perf_counter()
                again = evaluated(evaluator, genomes)
                took.append(time.perf_counter() - started)
            row[f"{size}: a second"] = rate = size / median(took)
            row[f"{size}: share of stepping"] = watch.seconds / sum(took)
            row[f"{size}: evaluated again"] = agreement(found[size], again)
            say(f"{target}: {size} worlds, {first:.1f} s at first, then {rate:.0f} a second")
        whole = found[sizes[-1]]
        row["in other batches"] = {size: agreement(whole[:size], found[size]) for size in sizes[:-1]}
        row["again in mujoco"] = evaluator.redone
        row["buffers used"] = [worlds.buffers_used for worlds in (evaluator._fixed, evaluator._free)]  # type: ignore[attr-defined]
        row["buffers"] = evaluator.buffers
    return row | {"rows": len(expected), "as in mujoco": agreement(expected, whole)}


def agreement(expected: Rows, found: Rows) -> dict[str, Any]:
    """Shares of rows that are held, and with the same outcome, verdict and bits.

    `mm apart` are the median, the 90th percentile and the greatest of the distances [mm] between the settled
    objects of rows that both hold.
    """
    held = [rows["outcome"] == Outcome.HELD for rows in (expected, found)]
    both = held[0] & held[1]
    apart = 1e3 * np.linalg.norm(
        expected["settled"][both][:, :SETTLED].astype(float) - found["settled"][both][:, :SETTLED], axis=1
    )
    return {
        "held": [float(each.mean()) for each in held],
        "same outcome": float((expected["outcome"] == found["outcome"]).mean()),
        "same held": float((held[0] == held[1]).mean()),
        "same bits": float(np.mean([one == other for one, other in zip(expected, found, strict=True)])),
        "mm apart": [float(value) for value in np.percentile(apart, [50, 90, 100])] if both.any() else None,
    }


def main() -> None:
    """Print a line of JSON for each object, and progress on stderr."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("device", help="a device of warp: cuda, cpu")
    parser.add_argument("--objects", nargs="+", default=OBJECTS)
    parser.add_argument("--worlds", nargs="+", type=int, default=[64, 512, 4096])
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    asked = parser.parse_args()
    for target in asked.objects:
        found = figures(asked.device, target, sorted(asked.worlds), asked.processes)
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
