"""Runs made by hand, in memory, by their growth."""

from pathlib import Path
from typing import Any

import numpy as np

from qdgrasp_coordinator.metrics.reference_coverage import CoverageTarget
from qdgrasp_coordinator.metrics.success_metrics import Diversity, StepSeries
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.report.run_history import NU_BINS, RunHistory

NOTHING = StepSeries(np.zeros(0, np.int64), np.zeros(0, np.int64))
UNIFORM = Diversity(niches=0, grasp_niches=0, robust_niches=0, orientations=None, synergies=None)


def climb(*totals: int, every: int = 10) -> StepSeries:
    """A number that becomes each of `totals` in turn, every few evaluations."""
    return StepSeries(every * np.arange(1, len(totals) + 1), np.array(totals, dtype=np.int64))


def made(
    method: str, cells: StepSeries, seed: int = 0, evaluations: int = 100, **differing: Any
) -> RunHistory:
    """A history that is known for its cells alone; its scene has no reference set."""
    settings = {key: differing.pop(key) for key in list(differing) if key in RunSpec.__struct_fields__}
    values = {"gripper": "jaw", "object": "block"} | settings
    spec = RunSpec(**values, method=method, seed=seed, evaluations=100)
    fields: dict[str, Any] = {
        "path": Path(f"{method}-s{seed}"), "spec": spec, "target": CoverageTarget(why="no S_G"),
        "evaluations": evaluations, "complete": evaluations >= 100,
        "simulated": evaluations, "proposals": evaluations, "overlaps": 0, "dead_ends": 0,
        "successes": cells.end, "cells": cells,
        "robust_cells": NOTHING, "found": None, "robust_found": None, "published": None,
        "diversity": UNIFORM, "qd_score": 0.0,
        "nu": np.zeros(NU_BINS, np.int64), "near": 0, "eta": None, "cpu_seconds": 1.0,
    }  # fmt: skip
    return RunHistory(**fields | differing)
