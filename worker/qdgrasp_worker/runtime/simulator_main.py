"""The simulator's process: evaluates its worker's batches, and may crash.

It holds the physics engines and no session on the bus. Started as `python -m
qdgrasp_worker.runtime.simulator_main`, with name and worlds of a device where there is one, then its limits
(CPU seconds of a row, or of a slice of rows; bytes of memory; niceness), and the pipe to its worker as
standard input; all prints go to standard error.
"""

import os
import sys
import time
from collections.abc import Callable
from functools import partial
from multiprocessing.connection import Connection

from setproctitle import setproctitle

from qdgrasp_assets.scene import unpack_scene
from qdgrasp_protocol import messages, process_limits
from qdgrasp_protocol.errors import InputError, MessageError
from qdgrasp_protocol.messages import Failure, shorten
from qdgrasp_protocol.rows import COLUMNS, RESULT, pack, unpack
from qdgrasp_protocol.spec import Device
from qdgrasp_worker.evaluator import BatchEvaluator, EvaluatorCache, make_evaluator
from qdgrasp_worker.platform import platform
from qdgrasp_worker.runtime.simulator_messages import (
    BatchRejected,
    EvaluateRows,
    MessageConnection,
    PartialResult,
    SceneLoaded,
    SceneMissing,
    SimulatorCrashed,
    SimulatorReady,
)

LIMITS = 3  # Number of arguments that are limits, the last ones
REPORT_INTERVAL = 0.1  # Seconds between two parts of a batch, at least
WORK_COLUMNS = [column for column in COLUMNS if column.name in ("index", "trial", "genome")]
LoadEvaluator = Callable[[bytes], BatchEvaluator]  # Makes an evaluator of a scene's bundle
ProbePlatform = Callable[[], dict[str, str]]  # Returns the platform, which decides the bits of results


class SimulatorMain:
    """Evaluates batches in their order, with evaluators that `load` makes.

    `row_seconds` are the CPU seconds that a slice of rows, or loading a scene, may take.
    """

    def __init__(self, connection: MessageConnection, row_seconds: float, load: LoadEvaluator) -> None:
        self._pipe = connection
        self._row_seconds = row_seconds
        self._load = load
        self._evaluators = EvaluatorCache()

    def evaluate(self, request: EvaluateRows) -> None:
        """Evaluate rows, and send their results."""
        if request.bundle is None and request.scene not in self._evaluators:
            self._pipe.send(SceneMissing())
            return
        try:
            self._evaluate_slices(self._evaluator(request), request)
        except (InputError, MessageError) as error:
            self._pipe.send(BatchRejected(reason=str(error)))

    def _evaluator(self, request: EvaluateRows) -> BatchEvaluator:
        def load() -> BatchEvaluator:
            with process_limits.time_limit(self._row_seconds):
                return self._load(request.bundle or b"")

        try:
            evaluator = self._evaluators.get(request.scene, load)
        except (InputError, MemoryError):
            if not len(self._evaluators):
                raise
            self._evaluators.close()  # memory may have been short, which engines report in other words
            evaluator = self._evaluators.get(request.scene, load)
        if request.bundle is not None:
            self._pipe.send(SceneLoaded())
        return evaluator

    def _evaluate_slices(self, evaluator: BatchEvaluator, request: EvaluateRows) -> None:
        shape = evaluator.shape(request.prior)
        if request.genes != shape.genes:
            raise MessageError(f"the batch has {request.genes} genes, this scene has {shape.genes}")
        rows = unpack(shape.empty(request.n), WORK_COLUMNS, request.columns)
        failures: list[Failure] = []
        sent, sent_at, began = 0, time.monotonic(), time.process_time()
        most = 1 if request.is_careful else evaluator.at_once
        for start in range(0, request.n, most):
            piece = slice(start, min(start + most, request.n))
            with process_limits.time_limit(self._row_seconds):
                found = evaluator.evaluate(request.prior, rows["genome"][piece], rows["trial"][piece])
            for column in RESULT:
                rows[column.name][piece] = found.rows[column.name]
            first = piece.start - sent
            failures += [Failure(row=first + row, reason=shorten(reason)) for row, reason in found.failures]
            now = time.monotonic()
            if request.is_careful or piece.stop == request.n or now > sent_at + REPORT_INTERVAL:
                ended, part = time.process_time(), rows[sent : piece.stop]
                result = PartialResult(
                    n=len(part),
                    joints=shape.joints,
                    contact_slots=shape.contact_slots,
                    columns=pack(part, RESULT),
                    failures=failures,
                    cpu_seconds=ended - began,
                )
                self._pipe.send(result)
                failures, sent, sent_at, began = [], piece.stop, now, ended


def load_scene(bundle: bytes, device: Device | None = None) -> BatchEvaluator:
    """Return the evaluator of a scene, whose bundle is checked for its unpacked size first."""
    messages.check_bundle(bundle)
    return make_evaluator(unpack_scene(bundle), device)


def serve(connection: MessageConnection, load: LoadEvaluator, probe: ProbePlatform) -> None:
    """Evaluate the probes, and then the batches that come, until the pipe is closed."""
    row_seconds, memory, nice = sys.argv[-LIMITS:]
    process_limits.limit_memory(int(memory))
    process_limits.lower_priority(int(nice))
    with process_limits.time_limit(max(process_limits.PROBE_SECONDS, float(row_seconds))):
        found = probe()
    connection.send(SimulatorReady(platform=found))
    simulator = SimulatorMain(connection, float(row_seconds), load)
    while (request := connection.receive()) is not None:
        if not isinstance(request, EvaluateRows):
            raise MessageError(f"expected rows to evaluate, got {type(request).__name__}")
        simulator.evaluate(request)


def main(load: LoadEvaluator = load_scene, probe: ProbePlatform = platform) -> None:
    """Entry point of the simulator."""
    process_limits.end_with_parent_only()
    setproctitle("qdgrasp-simulator")
    os.environ.setdefault("MUJOCO_GL", "disable")  # MuJoCo looks for a display else, in a process of its own
    connection = MessageConnection(Connection(sys.stdin.fileno()))
    try:
        serve(connection, load, probe)
    except (BrokenPipeError, ConnectionResetError):
        sys.exit(0)  # the worker is gone
    except Exception as error:  # noqa: BLE001  # any error is sent to the worker
        connection.send(SimulatorCrashed(reason=f"{type(error).__name__}: {error}"))
        sys.exit(1)


if __name__ == "__main__":
    asked = Device(sys.argv[1], int(sys.argv[2])) if sys.argv[1:-LIMITS] else None
    main(partial(load_scene, device=asked), partial(platform, asked))
