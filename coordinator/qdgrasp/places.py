"""Places: where evaluations are carried out."""

import logging
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import structlog

from qdgrasp_coordinator.counts.figures import JobFigures
from qdgrasp_coordinator.watching import stage
from qdgrasp_coordinator.watching.progress import Display
from qdgrasp_coordinator.watching.stage import Stage
from qdgrasp_protocol.credentials import Credentials, Role
from qdgrasp_protocol.errors import InputError
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
    """Folder of certificates for a router elsewhere: of a coordinator, for `workers` of a worker, and for
    `optimise` of a recorder; None: links are not encrypted."""
    batch_size: int | None = None
    """Rows in a batch; None: measured. No result depends on it."""

    def __post_init__(self) -> None:
        if self.security and not self.connect:
            raise InputError(
                "Place: certificates are for the links to a router: name it with connect='tls/HOST:PORT', or "
                "leave security out."
            )

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
    with stage.opened(name, logs, shown, *place.meet(), place.proof) as here:
        yield here


class Quiet:
    """A display that shows nothing, and only logs what happens to processes."""

    def show(self, figures: JobFigures) -> None:
        """Nobody looks."""

    def say(self, sentence: str) -> None:
        """Note what happened."""
        log.warning(sentence)
