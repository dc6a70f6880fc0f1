"""Gain by weights of other runs for a search: `python -m benchmarks.warm_start --help`.

The search for value runs on each object with and without weights learned on the sources, less that object.
"""

import argparse
import json
import sys
from typing import Any

import msgspec
import numpy as np
from benchmarks.single_run import SingleRun, run

from qdgrasp_coordinator.scheduler.run_plan import full_spec, prepare_scene
from qdgrasp_coordinator.search.value_search import ValueSearch
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import FirstWeights, RunSpec
from qdgrasp_tools.campaign.warm_start import learned_weights, replayed_search

MILESTONES = (250, 500, 1000)
PARTS = {"nothing": (), "cells": ("cell_touch", "cell_quality"), "candidates": ("touch", "quality")}
PARTS |= {"all": PARTS["cells"] + PARTS["candidates"]}
"""Models whose weights are handed on."""


def asked_spec(asked: argparse.Namespace, thing: str, **values: int) -> RunSpec:
    return full_spec({"gripper": asked.gripper, "object": thing, "protocol": asked.protocol} | values)


def learned_search(asked: argparse.Namespace, thing: str) -> ValueSearch:
    """The search of a source, told all rows of its run."""
    spec = asked_spec(asked, thing, evaluations=asked.source_evaluations, seed=0)
    return replayed_search(spec, prepare_scene(spec), [run(spec).rows])


def figures(found: SingleRun) -> dict[str, Any]:
    """Cells, cells that hold and genomes after so many evaluations."""
    passed = [number for number in MILESTONES if number <= found.spec.evaluations]
    return {
        "evaluations": passed,
        "cells": found.history.cells().after(passed).tolist(),
        "cells_that_hold": found.history.cells(Outcome.HELD).after(passed).tolist(),
        "genomes": (1 + np.searchsorted(found.evaluations, passed)).tolist(),
        "cpu_seconds": round(found.evaluation_seconds + found.search_seconds, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.warm_start", description=__doc__)
    parser.add_argument("--gripper", default="panda")
    parser.add_argument("--protocol", default="physical")
    parser.add_argument("--sources", nargs="+", default=["ycb_rubiks_cube", "ycb_mug", "ycb_power_drill"])
    parser.add_argument("--source-evaluations", type=int, default=1500)
    parser.add_argument("--objects", nargs="+", default=["ycb_cracker_box", "ycb_bowl"])
    parser.add_argument("--evaluations", type=int, default=1000)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=["nothing", "all"])
    asked = parser.parse_args()
    searches = {thing: learned_search(asked, thing) for thing in asked.sources}
    for thing in asked.objects:
        learned = learned_weights([search for name, search in searches.items() if name != thing])
        for part in asked.parts:
            first = FirstWeights(**{name: getattr(learned, name) for name in PARTS[part]})
            for seed in asked.seeds:
                spec = asked_spec(asked, thing, evaluations=asked.evaluations, seed=seed)
                found = run(msgspec.structs.replace(spec, first_weights=first))
                line = {"object": thing, "handed_on": part, "seed": seed} | figures(found)
                sys.stdout.write(json.dumps(line) + "\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main()
