"""Places: where evaluations are carried out, and the processes that are started there."""

import logging
import os
import secrets
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import structlog

from qdgrasp_coordinator.counts.figures import JobFigures
from qdgrasp_coordinator.watching.progress import Display
from qdgrasp_coordinator.watching.watch import Watch
from qdgrasp_coordinator.watching.workers import GRACE, hire_worker
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.credentials import Credentials, Role
from qdgrasp_protocol.crew import Crew
from qdgrasp_protocol.logs import speak
from qdgrasp_protocol.zenoh_bus import ZenohBus

log = structlog.get_logger()
PATIENCE = 10.0  # seconds that a router is waited for


@dataclass(frozen=True)
class Place:
    """Where evaluations are carried out: by workers of this machine, by those at a router, or by both."""

    workers: int | None = None
    """Worker processes that are started here; None: one per core, and none at a router."""
    connect: str | None = None
    """Endpoint of a router that runs already, such as "tcp/127.0.0.1:7447", where other workers are; None:
    this process is the router, on loopback."""
    job: str | None = None
    """The job's name on the bus; None: one that no other has."""
    security: str | os.PathLike[str] | None = None
    """Folder of certificates, of a coordinator and, for `workers`, of a worker; None: links are not
    encrypted."""
    batch_size: int | None = None
    """Rows in a batch; None: measured. No result depends on it."""

    @property
    def hands(self) -> int:
        """How many workers are started here."""
        if self.workers is not None:
            return self.workers
        return 0 if self.connect else len(os.sched_getaffinity(0))

    @property
    def proof(self) -> list[str]:
        """What every process that is started here is given."""
        return ["--security", str(self.security)] if self.security else []

    def meet(self) -> tuple[ZenohBus, str]:
        """A session on the bus, and where that is.

        Raises
        ------
        EndpointError
            No router answers, or no port is free.
        """
        if self.connect is None:
            return ZenohBus.embedded(None)
        credentials = Credentials.find(Path(self.security) if self.security else None, Role.COORDINATOR)
        return ZenohBus.connect(self.connect, PATIENCE, None, credentials), self.connect


HERE = Place()
"""This machine, all of it."""


@dataclass(frozen=True)
class Stage:
    """A place that is open: a session, and processes that are looked after."""

    bus: Bus
    endpoint: str
    job: str
    place: Place
    crew: Crew
    watch: Watch

    def hire_recorder(self, out: Path) -> None:
        """Start a recorder that writes to the folder of a job."""
        self.crew.hire("recorder", "qdgrasp_coordinator.cli.recorder", [*self.meeting, "--out", str(out)])

    def hire_workers(self) -> None:
        """Start the workers of this place."""
        for number in range(self.place.hands):
            hire_worker(self.crew, number, self.meeting)

    @property
    def meeting(self) -> list[str]:
        """Where processes meet, and what they show there."""
        return ["--connect", self.endpoint, "--job", self.job, *self.place.proof]


@contextmanager
def opened(place: Place, logs: Path, shown: Display, job: str | None = None) -> Iterator[Stage]:
    """Open a place; leaving it ends the processes that were started.

    Parameters
    ----------
    logs
        The folder in which each process has a log.
    job
        The job's name unless the place has one; None: one that no other has.

    Raises
    ------
    EndpointError
        No router answers, or no port is free.
    """
    if not structlog.is_configured():
        speak("qdgrasp", level=logging.WARNING)
    name = place.job or job or f"python-{secrets.token_hex(4)}"
    with ExitStack() as stack:
        bus, endpoint = place.meet()
        stack.enter_context(bus)
        crew = stack.enter_context(Crew(logs, GRACE))
        yield Stage(bus, endpoint, name, place, crew, Watch(crew, shown))


class Quiet:
    """A display that shows nothing, and only logs what happens to processes."""

    def show(self, figures: JobFigures) -> None:
        """Nobody looks."""

    def say(self, sentence: str) -> None:
        """Note what happened."""
        log.warning(sentence)
