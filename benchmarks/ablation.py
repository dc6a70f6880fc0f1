"""Gain by each part of the search that aims: `python -m benchmarks.ablation --help`.

One part is left out at a time; all else, seeds included, stays. Each finished run is a line of the file that
`--out` names, and is not carried out again: a stop costs at most one run.
"""

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import single_run
from benchmarks.measure import machine
from rich.console import Console
from rich.table import Table

from qdgrasp_assets.genes import FEATURES, VALUE_FEATURES
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_coordinator.scheduler.run_plan import full_spec
from qdgrasp_coordinator.search.aimed import AimedGrasps, AimedSearch
from qdgrasp_coordinator.search.base import SearchSpace, keyed_generator
from qdgrasp_coordinator.search.frontier import NEIGHBOURS, Places
from qdgrasp_coordinator.search.touch_search import TouchSearch
from qdgrasp_coordinator.search.value_search import ValueModel, ValueSearch
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.platform import EVALUATION
from qdgrasp_worker.syntax_digest import syntax_digest

LOOSE = 0.5


class WithoutSuccessThreshold(TouchSearch):
    """A genome's remaining candidates are simulated, likely or not."""

    def _weights(self, wanted: Floats) -> Floats:
        return super()._weights(np.zeros_like(wanted))


class WithoutLearnedRanking(TouchSearch):
    """Candidates are ranked by what is swept, and nothing is learned of them."""

    def _weights(self, wanted: Floats) -> Floats:
        return np.zeros_like(super()._weights(wanted))


class WithOneCandidate(TouchSearch):
    """One candidate of each genome; where overlaps are redrawn, by the next genome."""

    def __init__(self, spec: RunSpec, space: SearchSpace) -> None:
        super().__init__(spec, space)
        self._candidates = 1

    def _weights(self, wanted: Floats) -> Floats:
        return np.zeros_like(super()._weights(wanted))


class WithoutLearnedLikelihood(TouchSearch):
    """Cells by successful neighbours over tries, as if nothing were learned."""

    def __init__(self, spec: RunSpec, space: SearchSpace) -> None:
        super().__init__(spec, space)
        self._frontier._model.likely = lambda features: (1.0 + len(NEIGHBOURS) * features[:, 2]) / 27.0  # type: ignore[method-assign]


class WithAnyNeighbour(TouchSearch):
    """Any successful neighbour's grasp."""

    def _parents(self, targets: Places, generator: np.random.Generator) -> Places:
        options = self._frontier.block(targets)
        drawn = np.where(self._elites.ranks(options) < 0, -1.0, generator.random(options.shape))
        parents: Places = options[np.arange(len(targets)), drawn.argmax(axis=1)]
        return parents


class WithLooseGrasps(TouchSearch):
    """Every second candidate looks anywhere, with any roll."""

    def _aimed(self, targets: Places, generation: int) -> AimedGrasps:
        aims = super()._aimed(targets, generation)
        return replace(aims, looseness=np.full(len(aims), LOOSE))


class WithoutRetries(TouchSearch):
    """Weak grasps are not tried again."""

    def __init__(self, spec: RunSpec, space: SearchSpace) -> None:
        super().__init__(spec, space)
        self._retries.ask = lambda *_: np.zeros(0, np.intp)  # type: ignore[method-assign]


class WithExplorationOnly(TouchSearch):
    """Exploration alone, with the same candidates and the same ranking."""

    def _targets(self, generation: int) -> Places:
        return np.zeros(0, np.intp)


class WithAnyCell(TouchSearch):
    """Cells of the frontier at random, in place of second tries too."""

    def _targets(self, generation: int) -> Places:
        targets = super()._targets(generation)
        edge = self._frontier.edge
        generator = keyed_generator(self._spec.seed, "any cell", generation)
        return generator.choice(edge, min(len(targets), len(edge)), replace=False)


class PlainFeatureModel(ValueModel):
    """Nothing is learned of predicted contacts."""

    def learn(self, simulated: Rows, quality: Floats) -> None:
        simulated = simulated.copy()
        simulated["descriptor"][:, 3 + len(FEATURES) - 1 : -1] = 0.0
        super().learn(simulated, quality)


class TouchModel(ValueModel):
    """Candidates are ranked by P(touch) alone."""

    def ranking(self, wanted: Floats) -> Floats:
        weights = super().ranking(wanted)
        weights[:, len(VALUE_FEATURES) : -1] = 0.0
        return weights


class WithoutGripFeatures(ValueSearch):
    """Candidates are told apart by the five features that touch was ranked by."""

    def __init__(self, spec: RunSpec, space: SearchSpace) -> None:
        super().__init__(spec, space)
        self._model = PlainFeatureModel()


class WithoutCandidateQuality(ValueSearch):
    """Quality decides on cells alone."""

    def __init__(self, spec: RunSpec, space: SearchSpace) -> None:
        super().__init__(spec, space)
        self._model = TouchModel()


class WithoutCellQuality(ValueSearch):
    """Quality decides on candidates alone: all cells have the same."""

    def __init__(self, spec: RunSpec, space: SearchSpace) -> None:
        super().__init__(spec, space)
        self._frontier._quality.likely = lambda features: np.full(len(features), 0.5)  # type: ignore[method-assign]


class WithoutSecondTries(ValueSearch):
    """A cell's first touch closes it."""

    def _choose_cells(self, generation: int, n: int, generator: np.random.Generator) -> Places:
        edge = self._frontier.edge
        return self._frontier.best(n, generator, edge[~self._frontier.successful[edge]])


class WithoutValueThreshold(ValueSearch):
    """A genome's remaining candidates are simulated, of value or not."""

    def _weights(self, wanted: Floats) -> Floats:
        return super()._weights(np.zeros_like(wanted))


VARIANTS: dict[str, Callable[[RunSpec, SearchSpace], AimedSearch]] = {
    "hold": ValueSearch,
    "hold, five features": WithoutGripFeatures,
    "hold, candidates by touch": WithoutCandidateQuality,
    "hold, cells by touch": WithoutCellQuality,
    "hold, no second tries": WithoutSecondTries,
    "hold, no threshold": WithoutValueThreshold,
    "aimed": TouchSearch,
    "no threshold": WithoutSuccessThreshold,
    "no learned ranking": WithoutLearnedRanking,
    "one candidate": WithOneCandidate,
    "no learned likelihood": WithoutLearnedLikelihood,
    "any cell of the frontier": WithAnyCell,
    "any neighbour": WithAnyNeighbour,
    "loose grasps": WithLooseGrasps,
    "no second tries": WithoutRetries,
    "exploration alone": WithExplorationOnly,
}


class FinishedRuns:
    """Finished runs, in a file with a line of JSON for each.

    Parameters
    ----------
    path
        The file; it is begun where there is none.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        self._runs = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]

    def find(self, asked: dict[str, Any]) -> dict[str, Any] | None:
        """The finished run with these values; None if there is none."""
        return next((run for run in self._runs if run["asked"] == asked), None)

    def add(self, run: dict[str, Any]) -> None:
        """Add a run to the file."""
        self._runs.append(run)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(run) + "\n")


def measure(
    objects: Sequence[str],
    seeds: Sequence[int],
    names: Sequence[str],
    shakes: bool,
    finished: FinishedRuns,
    **values: Any,
) -> list[dict[str, Any]]:
    """Figures of each variant, object and seed; runs that are not finished are carried out."""
    found = []
    for name, thing, seed in product(names, objects, seeds):
        asked = values | {
            "variant": name,
            "object": thing,
            "seed": seed,
            "shakes": shakes,
            "code": syntax_digest(*EVALUATION, TouchSearch, ValueSearch),
        }
        run = finished.find(asked)
        if run is None:
            aim = "hold" if name.startswith("hold") else "touch"
            spec = full_spec(values | {"object": thing, "seed": seed, "method": "aimed", "aim_for": aim})
            ran = single_run.run(spec, VARIANTS[name], shakes=shakes)
            run = {"asked": asked, "variant": name} | ran.as_dict()
            finished.add(run)
        found.append(run)
        sys.stderr.write(f"{name}, {thing}, seed {seed}: {100 * run['coverage'][-1]:.1f} %\n")
    return found


def table(found: Sequence[dict[str, Any]]) -> Table:
    """Means over the seeds."""
    shown = Table(
        "object", "variant", "coverage, %", "less", "robust, %", "cells", "hold", "genomes", "CPU s"
    )
    pairs = dict.fromkeys((each["object"], each["variant"]) for each in found)
    whole = {
        (thing, first): _mean(found, thing, first, _last)
        for thing, variant in pairs
        for first in ("aimed", "hold")
        if variant == first
    }
    for thing, variant in pairs:
        coverage = _mean(found, thing, variant, _last)
        robust = _mean(found, thing, variant, lambda each: 100 * each["robust_coverage"][-1])
        genomes, seconds = (
            _mean(found, thing, variant, lambda each, key=key: each[key])
            for key in ("genomes", "evaluation_cpu_seconds")
        )
        cells, held = (
            _mean(found, thing, variant, lambda each, key=key: each[key][-1])
            for key in ("cells", "cells_that_hold")
        )
        first = thing, "hold" if variant.startswith("hold") else "aimed"
        less = f"{whole[first] - coverage:.1f}" if first in whole else "-"
        values = (
            f"{coverage:.1f}",
            less,
            f"{robust:.1f}",
            f"{cells:.0f}",
            f"{held:.0f}",
            f"{genomes:.0f}",
            f"{seconds:.0f}",
        )
        shown.add_row(thing, variant, *values)
    return shown


def _last(each: dict[str, Any]) -> float:
    return 100 * float(each["coverage"][-1])


def _mean(
    found: Sequence[dict[str, Any]], thing: str, variant: str, value: Callable[[dict[str, Any]], float]
) -> float:
    some = [value(each) for each in found if (each["object"], each["variant"]) == (thing, variant)]
    return float(np.mean(some))


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ablation", description=__doc__)
    parser.add_argument("--gripper", default="ref_panda_2f")
    parser.add_argument("--objects", nargs="+", default=["ycb_rubiks_cube", "ycb_mug"])
    parser.add_argument("--evaluations", type=int, default=3000)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1])
    parser.add_argument("--overlaps", choices=("count", "redraw"), default="redraw")
    parser.add_argument("--protocol", default="released")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    parser.add_argument("--no-shakes", action="store_true", help="look at successes alone, for a fraction")
    parser.add_argument("--out", type=Path, default=Path("runs/ablation.jsonl"), help="runs that are in")
    asked = parser.parse_args()
    values = {name: getattr(asked, name) for name in ("gripper", "evaluations", "overlaps", "protocol")}
    finished = FinishedRuns(asked.out)
    found = measure(asked.objects, asked.seeds, asked.variants, not asked.no_shakes, finished, **values)
    Console(stderr=True, width=120).print(table(found))
    sys.stdout.write(json.dumps({"machine": machine(), "runs": found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
