"""A simulator that evaluates the rows of plans, and that some rows end."""

import os
import sys

import numpy as np
from tests.coordinator.scheduler.search_plans import SHAPE, evaluate

from qdgrasp_protocol.rows import Outcome, RowShape
from qdgrasp_worker.evaluator import ROWS_AT_ONCE, Evaluation
from qdgrasp_worker.runtime.simulator_main import main

COMMAND = [sys.executable, "-m", "tests.worker.runtime.crashing_simulator"]
PLATFORM = {"simulator": "a formula"}


def fail() -> None:
    raise RuntimeError("poison")


ENDS = (os.abort, fail, lambda: os._exit(1))


class CrashingEvaluator:
    """A pure function of genome and trial; on poison the process ends, one way or the other."""

    at_once, weight = ROWS_AT_ONCE, 1

    def __init__(self, bundle: bytes) -> None:
        """Every scene is alike."""

    def close(self) -> None:
        """Nothing is open."""

    def shape(self, prior: str) -> RowShape:
        return SHAPE

    def evaluate(self, prior: str, genomes: np.ndarray, trials: np.ndarray) -> Evaluation:
        rows = SHAPE.empty(len(genomes))
        rows["genome"], rows["trial"] = genomes, trials
        found = evaluate(rows)
        for row in found[found["outcome"] == Outcome.ERROR]:
            ENDS[row["genome"].tobytes()[0] % len(ENDS)]()
        return Evaluation(found, [])


if __name__ == "__main__":
    main(load=CrashingEvaluator, probe=lambda: PLATFORM)
