"""Workers: one that only pretends, and one of which all but the evaluator is real."""

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from queue import SimpleQueue

import numpy as np
from tests.common import PATIENCE
from tests.coordinator.scheduler.search_plans import SHAPE, evaluate
from tests.fakes.messages import join_message, put, result_message
from tests.fakes.recorder import JOB
from tests.fakes.service_thread import ServiceThread
from tests.worker.runtime import scripted_simulator

from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus, Sample
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Control, Failure, Joined, Result, Work, deflated
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.rows import COLUMNS, RESULT, Rows, pack, unpack
from qdgrasp_worker.runtime.service import Inbox, WorkerService
from qdgrasp_worker.runtime.simulator_supervisor import SimulatorClient, SimulatorSupervisor

WORK = [column for column in COLUMNS if column.name in ("index", "trial", "genome")]
GRACE = PATIENCE
"""Long, so that a busy machine finishes within it too."""


class FakeWorker:
    """A worker that joins, and answers each batch in the thread that brings it, or keeps it."""

    def __init__(
        self,
        bus: Bus,
        wid: str,
        *,
        answers: bool = True,
        evaluate: Callable[[Rows], Rows] = evaluate,
    ) -> None:
        self._evaluate = evaluate
        self._bus, self._keys, self._wid, self._answers = bus, Keys(JOB), wid, answers
        self._inbox: SimpleQueue[Sample | None] = SimpleQueue()
        self.runs: set[str] = set()
        self.rows = 0
        self.kept = threading.Event()
        self.controls: list[Control] = []

    @contextmanager
    def at_work(self) -> Iterator["FakeWorker"]:
        thread = threading.Thread(target=self._run)
        with ExitStack() as stack:
            stack.enter_context(self._bus.subscribe(self._keys.work(self._wid), self._inbox.put))
            stack.enter_context(self._bus.subscribe(self._keys.ctl(self._wid), self._take_control))
            stack.enter_context(self._bus.token(self._keys.worker_token(self._wid)))
            stack.enter_context(self._bus.watch(self._keys.coordinator_token(), self._on_coordinator))
            thread.start()
            try:
                yield self
            finally:
                self._inbox.put(None)
                thread.join()

    def _on_coordinator(self, _key: str, alive: bool) -> None:
        if alive:
            threading.Thread(target=self._join).start()

    def _take_control(self, sample: Sample) -> None:
        self.controls.append(messages.decode(sample.payload, Control))

    def _join(self) -> None:
        request = join_message(self._wid, host="here", pid=1)
        messages.decode(self._bus.ask(self._keys.join, messages.encode(request), timeout=PATIENCE), Joined)

    def _run(self) -> None:
        while (sample := self._inbox.get()) is not None:
            work = messages.decode(sample.payload, Work)
            self.runs.add(work.run)
            self.rows += work.n
            if self._answers:
                put(self._bus, self._keys.result(self._wid), self._result(work))
            else:
                self.kept.set()

    def _result(self, work: Work) -> Result:
        found = self._evaluate(unpack(SHAPE.empty(work.n), WORK, work.columns))
        failed = np.flatnonzero(found["outcome"] == 0).tolist()
        same = ("epoch", "run", "generation", "batch", "attempt", "n")
        return result_message(
            **{name: getattr(work, name) for name in same},
            wid=self._wid,
            joints=SHAPE.joints,
            columns=deflated(pack(found, RESULT)),
            cpu_seconds=0.001,
            failures=[Failure(row=row, reason="poison") for row in failed],
        )


class RunningWorker(ServiceThread):
    """A worker in a thread of its own, with simulators that act as genomes say."""

    def __init__(
        self,
        bus: Bus,
        job: str | None = None,
        grace: float = GRACE,
        command: list[str] = scripted_simulator.COMMAND,
    ) -> None:
        self.bus = bus
        self.simulators: list[SimulatorClient] = []
        self._inbox: Inbox = SimpleQueue()
        self._job, self._grace, self._command = job, grace, command
        super().__init__(self._work, Stop())

    def _start_simulator(self) -> SimulatorClient:
        limits = str(PATIENCE), "900000000", "0"
        self.simulators.append(SimulatorClient([*self._command, *limits], self._inbox.put))
        return self.simulators[-1]

    def _work(self) -> None:
        simulator = SimulatorSupervisor(self._start_simulator, row_seconds=PATIENCE, memory=900_000_000)
        place = {"job": self._job, "grace": self._grace}
        with simulator, self.bus:
            WorkerService(self.bus, self._stop, simulator, self._inbox, **place).run()
