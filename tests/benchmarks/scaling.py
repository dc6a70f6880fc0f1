"""From one process to two: evaluations per second on the wall, in turns alone and side by side."""

import multiprocessing
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing.connection import Connection
from typing import NamedTuple

from tests.benchmarks.lot import Lot
from tests.benchmarks.measure import ROUNDS, Figure, spread

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import layout
from qdgrasp_coordinator.bench.regimes import PRIOR, Regime, Regimes
from qdgrasp_coordinator.dispatching.pace import FIRST_ROWS
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.evaluate import Evaluator
from qdgrasp_worker.serving.child import SLICE

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


class Turn(NamedTuple):
    """What processes did side by side."""

    rate: float
    """Evaluations in a second of the clock on the wall."""
    cost: float
    """CPU seconds of an evaluation."""


def _lines(workers: list[Connection], regime: Regime, seconds: float) -> Iterator[Figure]:
    turns: dict[int, list[Turn]] = {1: [], PROCESSES: []}
    for _ in range(ROUNDS):
        for count, found in turns.items():
            found.append(_turn(workers[:count], regime, seconds / ROUNDS))
    for count, found in turns.items():
        name = f"{HAND} on {OBJECT}, {regime.value}, {count} process{'' if count == 1 else 'es'}"
        rates = tuple(turn.rate for turn in found)
        remark = "wall time" + (_gain(turns[1], found) if count > 1 else "")
        yield Figure(name, sum(rates) * seconds / ROUNDS, seconds, "wall", remark, rates)


def _turn(workers: list[Connection], regime: Regime, seconds: float) -> Turn:
    for worker in workers:
        worker.send((regime, seconds))
    rows, rates, cpu = zip(*(worker.recv() for worker in workers), strict=True)
    return Turn(sum(rates), sum(cpu) / sum(rows))


def _gain(alone: list[Turn], together: list[Turn]) -> str:
    rates, costs = zip(
        *((b.rate / a.rate, b.cost / a.cost) for a, b in zip(alone, together, strict=True)), strict=True
    )
    return f"; {spread(rates)} times one process, {spread(costs)} times its CPU time each"


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
            began, cpu, rows = time.perf_counter(), time.process_time(), 0
            while time.perf_counter() < began + seconds:
                rows += lot.one(BATCHES[regime])
            pipe.send((rows, rows / (time.perf_counter() - began), time.process_time() - cpu))
