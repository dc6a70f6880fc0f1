"""Grasps drawn of finished runs, evaluated again: in Bullet, and by trials with small errors.

A run's engine judges the grasps that its search learned to find there. Another engine, and trials with a
displaced object and other friction, say how much of that is the engine's. The grasps are drawn of the cells
that hold, one of each cell, so that a share of them is a share of these cells.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from benchmarks.physics.eta import Arrays, evaluated
from benchmarks.results.measure import Figures
from msgspec.structs import replace

from qdgrasp_assets.catalog import build_scene
from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.search.fixed_poses import as_given
from qdgrasp_coordinator.search.registry import prior_of
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Genomes, Outcome, Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.evaluator import Evaluator

DRAWN = 30
"""Grasps drawn of a run."""
TRIALS = 5
"""Trials of each for eta."""
OTHER_ENGINE = "bullet"


def drawn(rows: Rows, seed: int, number: int = DRAWN) -> Rows:
    """Draw as many grasps that hold as there are cells for, the first found in each cell, by a seed."""
    held = rows[rows["outcome"] == Outcome.HELD]
    _, first = np.unique(cells(held["base_to_object"][:, :3]), axis=0, return_index=True)
    places = np.random.default_rng(seed).permutation(np.sort(first))[:number]
    return held[np.sort(places)]


def drawn_figures(path: Path) -> Figures:
    """Evaluate drawn grasps of a finished run of `physical`: their number, shares held in Bullet, and eta."""
    folder = RunFolder(path)
    spec = folder.spec
    with folder.journal() as journal:
        rows = drawn(journal.rows(0, journal.count), spec.seed)
    if not len(rows):
        return {"drawn": 0, "drawn_in_bullet": None, "drawn_eta": None}
    genomes = as_given(folder.scene(), prior_of(spec), rows)

    in_bullet = _evaluated(replace(spec, engine=OTHER_ENGINE), genomes, [0])["outcome"] == Outcome.HELD
    trials = _evaluated(replace(spec, protocol="robust", base="physical"), genomes, range(1, TRIALS + 1))
    return {
        "drawn": len(rows),
        "drawn_in_bullet": float(in_bullet.mean()),
        "drawn_eta": float(trials["fitness"].mean()) / spec.disturbances,
    }


def _evaluated(spec: RunSpec, genomes: Genomes, trials: Iterable[int]) -> Arrays:
    with Evaluator(build_scene(spec)) as evaluator:
        return evaluated(evaluator, genomes, trials)
