"""A worker of which all but the evaluator is real, in a thread of its own."""

import signal
import threading
from queue import SimpleQueue

from tests.patience import PATIENCE
from tests.worker.serving import stand_in

from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_worker.serving.bundles import Bundles
from qdgrasp_worker.serving.events import Inbox
from qdgrasp_worker.serving.frames import Settings
from qdgrasp_worker.serving.memberships import RefusedByJob
from qdgrasp_worker.serving.service import WorkerService
from qdgrasp_worker.serving.simulator import Simulator
from qdgrasp_worker.serving.workshop import Workshop

GRACE = PATIENCE
"""Long: what is finished within it is not a matter of how busy this machine is."""


class Hired:
    """A worker in a thread of its own."""

    def __init__(
        self, bus: Bus, job: str | None = None, grace: float = GRACE, command: list[str] = stand_in.COMMAND
    ) -> None:
        self.bus = bus
        self.stop = Stop()
        self.simulators: list[Simulator] = []
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

    def _hire(self) -> Simulator:
        settings = Settings(row_seconds=PATIENCE, memory=900_000_000, nice=0)
        self.simulators.append(Simulator(self._command, settings, self._inbox.put))
        return self.simulators[-1]

    def _work(self) -> None:
        workshop = Workshop(self._hire, row_seconds=PATIENCE, memory=900_000_000)
        with workshop, self.bus:
            service = WorkerService(
                self.bus,
                self.stop,
                workshop,
                self._inbox,
                bundles=Bundles(None),
                job=self._job,
                grace=self._grace,
            )
            try:
                service.run()
            except RefusedByJob as error:
                self.error = error
