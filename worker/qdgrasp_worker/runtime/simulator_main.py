"""The simulator's process: evaluates what its worker sends, and may die of it.

It holds Bullet and no session on the bus. Started as `python -m qdgrasp_worker.runtime.simulator_main`, with
the socket to its worker as standard input; whatever prints, prints to standard error.
"""

import socket
import sys
import time
from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np
from setproctitle import setproctitle

from qdgrasp_assets.scene import unpack_scene
from qdgrasp_protocol import messages
from qdgrasp_protocol.errors import InputError, MessageError
from qdgrasp_protocol.messages import Failure, shorten
from qdgrasp_protocol.rows import COLUMNS, RESULT, Rows, RowShape, pack, unpack
from qdgrasp_worker.evaluator import Evaluator, EvaluatorCache
from qdgrasp_worker.platform import platform
from qdgrasp_worker.runtime import process_limits
from qdgrasp_worker.runtime.simulator_messages import (
    BatchRejected,
    EvaluateRows,
    FramedSocket,
    PartialResult,
    SceneLoaded,
    SceneMissing,
    SimulatorCrashed,
    SimulatorMessage,
    SimulatorReady,
    SimulatorSettings,
    decode,
    encode,
)

ROWS_AT_ONCE = 16  # Rows evaluated at once; evaluation is pure, so slicing changes nothing
REPORT_INTERVAL = 0.1  # seconds between two parts of a batch, at least
WORK_COLUMNS = [column for column in COLUMNS if column.name in ("index", "trial", "genome")]
F = TypeVar("F", bound=SimulatorMessage)
LoadEvaluator = Callable[[bytes], Evaluator]
"""Makes an evaluator of a scene's bundle."""
ProbePlatform = Callable[[], dict[str, str]]
"""Finds out what decides the bits of results."""


class SimulatorMain:
    """Evaluates batches in their order.

    Parameters
    ----------
    row_seconds
        The CPU seconds that a slice of rows, or loading a scene, may take.
    load
        Makes evaluators.
    """

    def __init__(self, line: FramedSocket, row_seconds: float, load: LoadEvaluator) -> None:
        self._line = line
        self._row_seconds = row_seconds
        self._load = load
        self._worlds = EvaluatorCache()

    def answer(self, request: EvaluateRows) -> None:
        """Evaluate rows, and tell what they gave."""
        if request.bundle is None and request.scene not in self._worlds:
            self._say(SceneMissing())
            return
        try:
            self._evaluate(self._evaluator(request), request)
        except (InputError, MessageError) as error:
            self._say(BatchRejected(reason=str(error)))

    def _evaluator(self, request: EvaluateRows) -> Evaluator:
        def load() -> Evaluator:
            with process_limits.time_limit(self._row_seconds):
                return self._load(request.bundle or b"")

        evaluator = self._worlds.get(request.scene, load)
        if request.bundle is not None:
            self._say(SceneLoaded())
        return evaluator

    def _evaluate(self, evaluator: Evaluator, request: EvaluateRows) -> None:
        """Evaluate rows, slice by slice, and tell them at intervals."""
        shape = evaluator.shape(request.prior)
        rows = read_rows(request, shape)
        failures: list[Failure] = []
        told, told_at, began = 0, time.monotonic(), time.process_time()
        most = int(getattr(evaluator, "at_once", ROWS_AT_ONCE))  # one of somebody's own may want more
        for place in slices(request.n, 1 if request.is_careful else most):
            with process_limits.time_limit(self._row_seconds):
                found = evaluator.evaluate(request.prior, rows["genome"][place], rows["trial"][place])
            _copy_results(found.rows, rows[place])
            first = place.start - told
            failures += [Failure(row=first + row, reason=shorten(reason)) for row, reason in found.failures]
            now = time.monotonic()
            if request.is_careful or place.stop == request.n or now > told_at + REPORT_INTERVAL:
                ended = time.process_time()
                self._say(partial_result(rows[told : place.stop], shape, failures, ended - began))
                failures, told, told_at, began = [], place.stop, now, ended

    def _say(self, frame: SimulatorMessage) -> None:
        self._line.send(encode(frame))


def read_rows(request: EvaluateRows, shape: RowShape) -> Rows:
    """Rows with the keys and genomes of a request.

    Raises
    ------
    MessageError
        They are not of this shape.
    """
    if request.genes != shape.genes:
        raise MessageError(f"the batch has {request.genes} genes, this scene has {shape.genes}")
    return unpack(shape.empty(request.n), WORK_COLUMNS, request.columns, shape)


def partial_result(rows: Rows, shape: RowShape, failures: list[Failure], seconds: float) -> PartialResult:
    """What rows gave, and what that cost [CPU s]."""
    return PartialResult(
        n=len(rows),
        joints=shape.joints,
        descriptors=shape.descriptors,
        columns=pack(rows, RESULT),
        failures=failures,
        cpu_seconds=seconds,
    )


def slices(n: int, most: int) -> Iterator[slice]:
    """Cut n rows into pieces of at most `most`."""
    for start in range(0, n, most):
        yield slice(start, min(start + most, n))


def _copy_results(source: Rows, target: Rows) -> None:
    for column in RESULT:
        target[column.name] = np.asarray(source[column.name])


def load_scene(bundle: bytes) -> Evaluator:
    """The evaluator of a scene, which does not unfold without end."""
    messages.check_bundle(bundle)
    return Evaluator(unpack_scene(bundle))


def serve(line: FramedSocket, load: LoadEvaluator, probe: ProbePlatform) -> None:
    """Evaluate the probes, and then what comes, until the line ends."""
    settings = _receive(line, SimulatorSettings)
    if settings is None:
        return
    process_limits.limit_memory(settings.memory)
    process_limits.lower_priority(settings.nice)
    with process_limits.time_limit(process_limits.PROBE_SECONDS):
        found = probe()
    line.send(encode(SimulatorReady(platform=found)))
    child = SimulatorMain(line, settings.row_seconds, load)
    while (request := _receive(line, EvaluateRows)) is not None:
        child.answer(request)


def main(load: LoadEvaluator = load_scene, probe: ProbePlatform = platform) -> None:
    """Entry point of the simulator."""
    process_limits.end_with_parent_only()
    setproctitle("qdgrasp-simulator")
    line = FramedSocket(socket.socket(fileno=sys.stdin.fileno()))
    try:
        serve(line, load, probe)
    except (BrokenPipeError, ConnectionResetError):
        sys.exit(0)  # the worker is gone
    except Exception as error:  # noqa: BLE001  # whatever it is, the worker is told
        line.send(encode(SimulatorCrashed(reason=f"{type(error).__name__}: {error}")))
        sys.exit(1)


def _receive(line: FramedSocket, kind: type[F]) -> F | None:
    data = line.receive()
    if data is None:
        return None
    frame = decode(data)
    if not isinstance(frame, kind):
        raise MessageError(f"expected {kind.__name__}, got {type(frame).__name__}")
    return frame


if __name__ == "__main__":
    main()
