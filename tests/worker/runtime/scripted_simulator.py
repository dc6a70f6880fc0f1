"""A simulator whose evaluator acts as genomes say; its process, socket and limits are real.

`python -m tests.worker.runtime.scripted_simulator [LOG]`; LOG hears the number of every row that is begun.
Rows that wait do so until there is a file `count_block` beside LOG.
"""

import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.messages import Work
from qdgrasp_protocol.rows import RowShape
from qdgrasp_worker.evaluator import ROWS_AT_ONCE, Evaluation
from qdgrasp_worker.runtime.simulator_main import LIMITS, REPORT_INTERVAL, main

GENES = 2
COMMAND = [sys.executable, "-m", "tests.worker.runtime.scripted_simulator"]
SHAPE = RowShape(GENES, joints=2)
PLATFORM = {"simulator": "a stand-in"}
HELD: list[bytes | bytearray] = []


def hang() -> None:
    """Stay in one call, in which Python hears no signal."""
    sum(range(10**12))


def dawdle() -> None:
    """Take longer than the interval after which a simulator reports its results."""
    began = time.monotonic()
    while time.monotonic() < began + 2 * REPORT_INTERVAL:
        pass


def wait() -> None:
    """Take until the test wants it to go on."""
    while not go_on(Path(sys.argv[1])).exists():
        time.sleep(0.005)  # between two looks


def go_on(log: Path) -> Path:
    """The file that rows wait for, by the log of their simulator."""
    return log.with_name("go_on")


def sleep() -> None:
    while True:
        signal.pause()


def fail() -> None:
    raise ValueError("as the genome wants it")


def leak() -> None:
    HELD.append(bytearray(b"x" * 100_000_000))


def take_everything() -> None:
    """Ask for ever more, in pages that are not written: filling them would take CPU seconds."""
    while True:
        HELD.append(bytes(100_000_000))


DEEDS: list[Callable[[], object]] = [
    lambda: None,
    os.abort,
    hang,
    sleep,
    fail,
    leak,
    take_everything,
    lambda: os.kill(os.getpid(), signal.SIGKILL),
    lambda: os._exit(3),
    dawdle,
    wait,
]
"""By the second gene."""
NOTHING, ABORT, HANG, SLEEP, RAISE, LEAK, TAKE_EVERYTHING, BE_KILLED, EXIT, DAWDLE, WAIT = range(len(DEEDS))


def work(
    batch: int = 1, epoch: int = 1, join: int = 1, n: int = 1, scene: str = "0" * 64, **deeds: int
) -> Work:
    """A batch of n rows whose genomes hold their place, and the simulator's deed: `row_3=ABORT`."""
    genomes = np.zeros((n, GENES), dtype="<f4")
    genomes[:, 0] = np.arange(n)
    for row, deed in deeds.items():
        genomes[int(row.removeprefix("row_")), 1] = deed
    index = np.arange(n, dtype="<u4").tobytes()
    columns = {"index": index, "trial": bytes(2 * n), "genome": genomes.tobytes()}
    return Work(
        epoch=epoch,
        run="run",
        scene=scene,
        prior="contact",
        generation=0,
        batch=bytes([batch]) * 16,
        attempt=1,
        join=join,
        n=n,
        genes=GENES,
        columns=columns,
    )


class ScriptedEvaluator:
    """Its fitness is the first gene."""

    at_once, weight = ROWS_AT_ONCE, 1

    def __init__(self, bundle: bytes) -> None:
        match bundle:
            case b"no scene":
                raise AssetError("This is no scene.")
            case b"abort":
                os.abort()

    def close(self) -> None:
        """Nothing is open."""

    def shape(self, prior: str) -> RowShape:
        return SHAPE

    def evaluate(self, prior: str, genomes: np.ndarray, trials: np.ndarray) -> Evaluation:
        rows = SHAPE.empty(len(genomes))
        for row, (number, deed) in zip(rows, genomes, strict=True):
            for log in sys.argv[1:-LIMITS]:
                with Path(log).open("a") as file:
                    file.write(f"{number:.0f}\n")
            DEEDS[int(deed)]()
            row["fitness"] = number
        return Evaluation(rows, [(i, "odd") for i in range(len(rows)) if genomes[i, 0] == 13])


if __name__ == "__main__":
    main(load=ScriptedEvaluator, probe=lambda: PLATFORM)
