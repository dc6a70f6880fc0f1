"""One run in this process, without bus, recorder and workers: `python -m benchmarks.single_run --help`."""

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics.reference_coverage import ReferenceLookup
from qdgrasp_coordinator.metrics.run_stats import evaluation_mask
from qdgrasp_coordinator.metrics.success_metrics import cell_growth, reference_growth
from qdgrasp_coordinator.metrics.successes import Successes, all_successes
from qdgrasp_coordinator.scheduler.pipeline import Pipeline
from qdgrasp_coordinator.scheduler.run_plan import full_spec, row_shape
from qdgrasp_coordinator.search.base import SearchAlgorithm, search_space
from qdgrasp_coordinator.search.registry import BuildSearch, method, prior_of
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import Genomes, Outcome, Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.evaluator import Evaluator

MILESTONES = (1000, 2000, 3000, 5000, 10_000, 20_000, 50_000)


@dataclass(frozen=True)
class SingleRun:
    """The rows of a run, and its cost."""

    spec: RunSpec
    scene: Scene
    rows: Rows
    """Rows in journal order."""
    evaluation_seconds: float
    """CPU time."""
    search_seconds: float
    """CPU time of all asks and tells."""

    @property
    def evaluations(self) -> NDArray[np.int64]:
        """(n,): counted evaluations up to each row, itself included."""
        return np.cumsum(evaluation_mask(self.rows, self.spec.overlaps))

    @property
    def successes(self) -> Successes:
        return all_successes(self.rows, overlaps=self.spec.overlaps)

    def coverage(self, evaluations: Sequence[int], least: Outcome = Outcome.DROPPED) -> NDArray[np.float64]:
        """The share of S_G, or of its robust cells, found with this outcome at least; NaN without a set."""
        known = ReferenceLookup().of(self.scene, self.spec.object).reference
        if known is None:
            return np.full(len(evaluations), np.nan)
        known = known.robust if least is Outcome.HELD else known
        return reference_growth(self.successes, known, least).after(evaluations) / len(known)

    def as_dict(self) -> dict[str, Any]:
        spent = int(self.evaluations[-1])
        passed = [number for number in MILESTONES if number < spent] + [spent]
        nominal = self.rows[self.rows["trial"] == 0]
        return {
            "gripper": self.spec.gripper,
            "object": self.spec.object,
            "method": self.spec.method,
            "aim_for": self.spec.aim_for,
            "overlaps": self.spec.overlaps,
            "protocol": self.spec.protocol,
            "seed": self.spec.seed,
            "evaluations": passed,
            "coverage": np.round(self.coverage(passed), 4).tolist(),
            "robust_coverage": np.round(self.coverage(passed, Outcome.HELD), 4).tolist(),
            "cells": cell_growth(self.successes).after(passed).tolist(),
            "cells_that_hold": cell_growth(self.successes, Outcome.HELD).after(passed).tolist(),
            "successes": len(self.successes.rows),
            "mean_fitness": round(float(self.successes.rows["fitness"].mean()), 3)
            if len(self.successes.rows)
            else 0,
            "genomes": len(nominal),
            "steps": int(nominal["steps"].sum(dtype=np.int64)),
            "evaluation_cpu_seconds": round(self.evaluation_seconds, 2),
            "search_microseconds_per_genome": round(1e6 * self.search_seconds / len(nominal), 1),
        }


class Meter:
    """Adds up CPU seconds of this process."""

    def __init__(self) -> None:
        self.seconds = 0.0

    @contextmanager
    def running(self) -> Iterator[None]:
        began = time.process_time()
        try:
            yield
        finally:
            self.seconds += time.process_time() - began


class TimedSearch:
    """A search whose CPU time is measured."""

    def __init__(self, search: SearchAlgorithm) -> None:
        self._search = search
        self.meter = Meter()

    def ask(self, generation: int) -> Genomes:
        with self.meter.running():
            return self._search.ask(generation)

    def tell(self, generation: int, rows: Rows) -> None:
        with self.meter.running():
            self._search.tell(generation, rows)


def run(spec: RunSpec, build: BuildSearch | None = None, *, shakes: bool = True) -> SingleRun:
    """Carry out a run.

    Parameters
    ----------
    spec
        Complete (`full_spec`).
    build
        Makes the search; None: the method's own. The prior is the method's.
    shakes
        False leaves the shakes out, and every success has fitness 0: coverage of success then costs a
        fraction, but a search that prefers robust grasps finds none.
    """
    prior = prior_of(spec)
    scene = build_scene(spec)
    search = TimedSearch((build or method(spec.method).build)(spec, search_space(scene, prior)))
    shape = row_shape(scene, prior)
    pipeline = Pipeline(search, shape, spec)
    with Evaluator(scene) as evaluator:
        if not shakes:
            evaluator._protocol = replace(evaluator._protocol, shakes=())
        rows, seconds = _evaluated(pipeline, evaluator, prior)
    return SingleRun(spec, scene, rows, seconds, search.meter.seconds)


def _evaluated(pipeline: Pipeline, evaluator: Evaluator, prior: str) -> tuple[Rows, float]:
    """The journal, and the CPU seconds of its evaluations."""
    meter, journal = Meter(), [evaluator.shape(prior).empty(0)]
    while (asked := pipeline.ask()) is not None:
        with meter.running():
            rows = evaluator.evaluate(prior, asked.genomes, asked.trials).rows
        rows["generation"], rows["index"] = asked.number, asked.indices
        journal.append(pipeline.settle(rows).rows)
    return np.concatenate(journal), meter.seconds


def arguments(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    """Add the options that choose the run."""
    parser.add_argument("--gripper", default="ref_panda_2f")
    parser.add_argument("--object", default="ycb_rubiks_cube")
    parser.add_argument("--method", default="portfolio")
    parser.add_argument("--evaluations", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--overlaps", choices=("count", "redraw"), help="as the method has it")
    parser.add_argument("--protocol", default="released")
    parser.add_argument("--engine", help="bullet unless said; two as in bullet,mujoco")
    return parser


def asked_spec(asked: argparse.Namespace) -> RunSpec:
    names = ("gripper", "object", "method", "evaluations", "seed", "overlaps", "protocol", "engine")
    values = {name: getattr(asked, name) for name in names}
    return full_spec({name: value for name, value in values.items() if value is not None})


def main() -> None:
    parser = arguments(argparse.ArgumentParser(prog="python -m benchmarks.single_run", description=__doc__))
    parser.add_argument("--no-shakes", action="store_true", help="look at successes alone, for a fraction")
    parser.add_argument("--rows", metavar="FILE", help="write the rows there, as .npy")
    asked = parser.parse_args()
    try:
        found = run(asked_spec(asked), shakes=not asked.no_shakes)
    except InputError as error:
        parser.error(str(error))
    if asked.rows:
        np.save(asked.rows, found.rows)
    sys.stdout.write(json.dumps(found.as_dict()) + "\n")


if __name__ == "__main__":
    main()
