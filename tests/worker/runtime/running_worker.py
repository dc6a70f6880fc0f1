"""A worker of which all but the evaluator is real, in a thread of its own."""

import signal
import threading
from queue import SimpleQueue

from tests.common import PATIENCE
from tests.worker.runtime import scripted_simulator

from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.process import Stop
from qdgrasp_worker.runtime.background_requests import SceneStore
from qdgrasp_worker.runtime.job_registry import RefusedByJob
from qdgrasp_worker.runtime.service import Inbox, WorkerService
from qdgrasp_worker.runtime.simulator_messages import SimulatorSettings
from qdgrasp_worker.runtime.simulator_supervisor import SimulatorClient, SimulatorSupervisor

GRACE = PATIENCE
"""Long: what is finished within it is not a matter of how busy this machine is."""


class RunningWorker:
    """A worker in a thread of its own."""

    def __init__(
        self,
        bus: Bus,
        job: str | None = None,
        grace: float = GRACE,
        command: list[str] = scripted_simulator.COMMAND,
    ) -> None:
        self.bus = bus
        self.stop = Stop()
        self.simulators: list[SimulatorClient] = []
        self.error: Exception | None = None
        self._inbox: Inbox = SimpleQueue()
        self._job = job
        self._grace = grace
        self._command = command
        self.thread = threading.Thread(target=self._work, daemon=True)
        self.thread.start()

    def leave(self, number: int = signal.SIGTERM) -> None:
        """Ask it to stop."""
        self.stop.set(number)

    def ended(self) -> bool:
        """Wait for its end."""
        self.thread.join(PATIENCE)
        return not self.thread.is_alive()

    def _start_simulator(self) -> SimulatorClient:
        settings = SimulatorSettings(row_seconds=PATIENCE, memory=900_000_000, nice=0)
        self.simulators.append(SimulatorClient(self._command, settings, self._inbox.put))
        return self.simulators[-1]

    def _work(self) -> None:
        simulator = SimulatorSupervisor(self._start_simulator, row_seconds=PATIENCE, memory=900_000_000)
        with simulator, self.bus:
            service = WorkerService(
                self.bus,
                self.stop,
                simulator,
                self._inbox,
                store=SceneStore(None),
                job=self._job,
                grace=self._grace,
            )
            try:
                service.run()
            except RefusedByJob as error:
                self.error = error
