"""Runs whose rows were really evaluated, here and not by workers: random poses of a hand on an object."""

from pathlib import Path

import numpy as np
from tests.coordinator.recorded_runs import record

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.evaluator import Evaluator


def evaluated(path: Path, gripper: str, object_: str, n: int, prior: str = "contact") -> RunFolder:
    """A run of n random genomes of a prior."""
    scene = build_scene(RunSpec(gripper=gripper, object=object_))
    with Evaluator(scene) as evaluator:
        genes = evaluator.shape(prior).genes
        genomes = np.random.default_rng(0).uniform(-1, 1, (n, genes)).astype(np.float32)
        rows = evaluator.evaluate(prior, genomes, np.zeros(n, np.uint16)).rows
    rows["index"] = np.arange(n)
    return record(
        path, scene, rows, gripper=gripper, object=object_, mass=None, method=f"{prior}_rand", population=n
    )


def evaluate_given(scene: Scene, genomes: np.ndarray) -> Rows:
    """Rows of poses, evaluated as `qdgrasp evaluate` has them evaluated."""
    with Evaluator(scene) as evaluator:
        return evaluator.evaluate("given", genomes, np.zeros(len(genomes), np.uint16)).rows
