"""A simulator that takes its time: CHAOS_ROW_SECONDS seconds for each row, besides what the evaluation takes.

Where CHAOS_BAD names a kind of bad worker, it is one. Where CHAOS_FAILURES names a folder it also fails in
every way, once in each and never twice on the same row. The genome decides the way, which is noted there.
"""

import hashlib
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from qdgrasp_protocol.rows import RowShape
from qdgrasp_worker.evaluator import ROWS_AT_ONCE, Evaluation, Evaluator
from qdgrasp_worker.runtime.simulator_main import load_scene, main

ROW_SECONDS_VARIABLE = "CHAOS_ROW_SECONDS"
FAILURES_VARIABLE = "CHAOS_FAILURES"
ONE_IN = 4
"""One row in so many may fail."""


def hang() -> None:
    """Never return; the limit on the time of a row ends it."""
    while True:
        pass


def take_all_memory() -> None:
    """Ask for memory until there is none; the limit on memory ends it."""
    held = []
    while True:
        held.append(bytearray(b"x" * 50_000_000))


def be_killed() -> None:
    """End as a process that the kernel kills when memory is short."""
    os.kill(os.getpid(), signal.SIGKILL)


FAILURES: dict[str, Callable[[], None]] = {
    "abort": os.abort,
    "hang": hang,
    "take-all-memory": take_all_memory,
    "be-killed": be_killed,
}


class Slow:
    """An evaluator whose results come later."""

    at_once, weight = ROWS_AT_ONCE, 1

    def __init__(self, evaluator: Evaluator, row_seconds: float) -> None:
        self._evaluator = evaluator
        self._row_seconds = row_seconds

    def shape(self, prior: str) -> RowShape:
        return self._evaluator.shape(prior)

    def evaluate(self, prior: str, genomes: np.ndarray, trials: np.ndarray) -> Evaluation:
        time.sleep(self._row_seconds * len(genomes))
        return self._evaluator.evaluate(prior, genomes, trials)

    def close(self) -> None:
        self._evaluator.close()


class Failing(Slow):
    """An evaluator that fails where a genome wants it and has not had it yet."""

    def evaluate(self, prior: str, genomes: np.ndarray, trials: np.ndarray) -> Evaluation:
        for genome in genomes:
            fail_once(genome.tobytes())
        return super().evaluate(prior, genomes, trials)


def fail_once(genome: bytes) -> None:
    """Fail as a genome wants it, unless a process has failed that way before."""
    mark = hashlib.sha256(genome).digest()
    if mark[0] % ONE_IN:
        return
    name = list(FAILURES)[mark[1] % len(FAILURES)]
    try:
        (Path(os.environ[FAILURES_VARIABLE]) / name).touch(exist_ok=False)
    except FileExistsError:
        return
    FAILURES[name]()


class Sick(Slow):
    """An evaluator that fails on every row."""

    def evaluate(self, prior: str, genomes: np.ndarray, trials: np.ndarray) -> Evaluation:
        raise RuntimeError("the node is sick")


class Straggling(Slow):
    """An evaluator that takes a second for a row."""

    def evaluate(self, prior: str, genomes: np.ndarray, trials: np.ndarray) -> Evaluation:
        time.sleep(len(genomes))
        return super().evaluate(prior, genomes, trials)


class Silent(Slow):
    """An evaluator that never answers."""

    def evaluate(self, prior: str, genomes: np.ndarray, trials: np.ndarray) -> Evaluation:
        time.sleep(3600.0)
        return super().evaluate(prior, genomes, trials)


BAD = {"sick": Sick, "straggling": Straggling, "silent": Silent}
"""Evaluators of bad workers, by the name that stands in CHAOS_BAD."""


if __name__ == "__main__":
    kind = BAD.get(os.environ.get("CHAOS_BAD", ""), Failing if FAILURES_VARIABLE in os.environ else Slow)
    main(load=lambda bundle: kind(load_scene(bundle), float(os.environ[ROW_SECONDS_VARIABLE])))
