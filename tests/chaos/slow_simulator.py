"""A simulator that takes its time: CHAOS_PACE seconds for each row, besides what the evaluation takes."""

import os
import time

import numpy as np

from qdgrasp_protocol.rows import RowShape
from qdgrasp_worker.evaluator import ROWS_AT_ONCE, Evaluation, Evaluator
from qdgrasp_worker.runtime.simulator_main import load_scene, main

PACE = "CHAOS_PACE"


class Slow:
    """An evaluator whose results come later."""

    at_once = ROWS_AT_ONCE

    def __init__(self, evaluator: Evaluator, pace: float) -> None:
        self._evaluator = evaluator
        self._pace = pace

    def shape(self, prior: str) -> RowShape:
        return self._evaluator.shape(prior)

    def evaluate(self, prior: str, genomes: np.ndarray, trials: np.ndarray) -> Evaluation:
        time.sleep(self._pace * len(genomes))
        return self._evaluator.evaluate(prior, genomes, trials)

    def close(self) -> None:
        self._evaluator.close()


if __name__ == "__main__":
    main(load=lambda bundle: Slow(load_scene(bundle), float(os.environ[PACE])))
