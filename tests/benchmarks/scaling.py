"""From one process to two: evaluations per second on the wall, in turns alone and side by side."""

import multiprocessing
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing.connection import Connection

from tests.benchmarks.lot import Lot
from tests.benchmarks.measure import ROUNDS, Figure, spread

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import layout
from qdgrasp_coordinator.bench.regimes import PRIOR, Regime, Regimes
from qdgrasp_coordinator.pace import FIRST_ROWS
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.evaluate import Evaluator
from qdgrasp_worker.service import SLICE

HAND, OBJECT = "panda", "mug"
PROCESSES = 2
BATCHES = {Regime.ANYWHERE: SLICE, Regime.NEAR: FIRST_ROWS}
"""Rows that are evaluated at once: small against a turn."""


def measure(seconds: float) -> list[Figure]:
    with ExitStack() as stack:
        workers = [stack.enter_context(_process(number)) for number in range(PROCESSES)]
        for worker in workers:
            worker.recv()
        return [
            line for regime in (Regime.ANYWHERE, Regime.NEAR) for line in _lines(workers, regime, seconds)
        ]


def _lines(workers: list[Connection], regime: Regime, seconds: float) -> Iterator[Figure]:
    rates: dict[int, list[float]] = {1: [], PROCESSES: []}
    for _ in range(ROUNDS):
        for count, found in rates.items():
            for worker in workers[:count]:
                worker.send((regime, seconds / ROUNDS))
            found.append(sum(worker.recv() for worker in workers[:count]))
    gains = [both / alone for alone, both in zip(rates[1], rates[PROCESSES], strict=True)]
    for count, found in rates.items():
        name = f"{HAND} on {OBJECT}, {regime.value}, {count} process{'' if count == 1 else 'es'}"
        remark = "wall time" + (f"; {spread(gains)} times one process" if count > 1 else "")
        yield Figure(name, sum(found) * seconds / ROUNDS, seconds, "wall", remark, tuple(found))


@contextmanager
def _process(number: int) -> Iterator[Connection]:
    """A process that evaluates when it is told to; it ends with the block."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(there, number), daemon=True)
    process.start()
    try:
        there.close()  # so that its end is heard
        yield here
    finally:
        here.send(None)
        process.join()


def _serve(pipe: Connection, number: int) -> None:
    scene = build_scene(RunSpec(gripper=HAND, object=OBJECT))
    regimes = Regimes(layout(scene, PRIOR))
    with Evaluator(scene) as evaluator:
        lot = Lot(str(number), regimes, PRIOR, evaluator)
        while not regimes.has_looked:
            lot.skip(SLICE)
        pipe.send(None)
        while (asked := pipe.recv()) is not None:
            regime, seconds = asked
            regimes.turn(regime, SLICE)
            began, rows = time.perf_counter(), 0
            while time.perf_counter() < began + seconds:
                rows += lot.one(BATCHES[regime])
            pipe.send(rows / (time.perf_counter() - began))
