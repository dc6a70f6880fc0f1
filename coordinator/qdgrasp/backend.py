"""Backends: processes that carry out evaluations."""

import logging
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import structlog

from qdgrasp_coordinator.metrics.job_status import JobStatus
from qdgrasp_protocol.errors import ImpossibleValue, InputError
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.process import configure_logging
from qdgrasp_protocol.session import Credentials, Role, parse_endpoints
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.local.progress import ProgressDisplay
from qdgrasp_tools.local.supervisor import LocalSession, open_session

log = structlog.get_logger()
ROUTER_SECONDS = 10.0  # seconds to wait for a router, and for workers before a warning
Meeting: TypeAlias = tuple[ZenohBus, str]  # A session on the bus, and the endpoint where that is


@dataclass(frozen=True)
class Place:
    """Workers that evaluate: on this machine, at a router, or both."""

    workers: int | None = None
    """Worker processes that are started here; None: one per core, and none at a router."""
    connect: str | None = None
    """Endpoint of a router with other workers, such as "tcp/127.0.0.1:7447".

        None: this process is the router, on loopback.
    """
    job: str | None = None
    """The job's name on the bus; None: a unique one."""
    security: str | os.PathLike[str] | None = None
    """Folder of certificates for a router elsewhere; None: links are not encrypted.

        A coordinator's, for `workers` also a worker's, and for `optimise` a recorder's.
    """
    batch_size: int | None = None
    """Rows in a batch; None: measured. No result depends on it."""

    def __post_init__(self) -> None:
        for name, value, least in (("workers", self.workers, 0), ("batch_size", self.batch_size, 1)):
            if value is not None and value < least:
                raise ImpossibleValue(f"Place: {name}", value, f"a whole number, at least {least}")
        if self.job:
            Keys(self.job)
        if self.connect is not None:
            parse_endpoints(self.connect)
        if self.security and not self.connect:
            raise InputError(
                "Place: certificates are for the links to a router: name it with connect='tls/HOST:PORT', or "
                "leave security out."
            )

    @property
    def hands(self) -> int:
        """Number of workers that are started here."""
        if self.workers is not None:
            return self.workers
        return 0 if self.connect else len(os.sched_getaffinity(0))

    @property
    def proof(self) -> list[str]:
        """Credential flags of every process that is started here."""
        return ["--security", str(self.security)] if self.security else []

    def check_hands(self) -> None:
        """Raise InputError if no worker is started here and none can connect."""
        if not self.hands and self.connect is None:
            raise InputError(
                "Place(workers=0) has no workers: start some, or name a router that has some "
                "with connect='tcp/HOST:PORT'."
            )

    def meet(self) -> Meeting:
        """Open a session on the bus; also return its endpoint.

        Raises EndpointError if no router answers, or no port is free, and InputError as `check_process`.
        """
        check_process()
        if self.connect is None:
            return ZenohBus.embedded(None)
        credentials = Credentials.find(Path(self.security) if self.security else None, Role.COORDINATOR)
        return ZenohBus.connect(self.connect, ROUTER_SECONDS, None, credentials), self.connect


HERE = Place()  # All cores of this machine
_USERS: set[int] = set()  # Processes that have used the bus, here and before this process was forked


def check_process() -> None:
    """Raise InputError in a process that was forked after the bus was used, without its threads."""
    if _USERS and os.getpid() not in _USERS:
        raise InputError(
            "This process was forked from one that had used qdgrasp before, whose threads it does not have: "
            "start processes by spawn, as multiprocessing.get_context('spawn') does."
        )
    _USERS.add(os.getpid())


@contextmanager
def open_place(
    place: Place, logs: Path, shown: ProgressDisplay, job: str | None = None, meeting: Meeting | None = None
) -> Iterator[LocalSession]:
    """Open a place; leaving it ends the processes that were started, each with a log in `logs`.

    `job` is the job's name unless the place has one; None: a unique one. `meeting` is the result of the
    place's `meet`; None: it is called, and raises as it does.
    """
    if not structlog.is_configured():
        configure_logging("qdgrasp", level=logging.WARNING)
    name = place.job or job or f"python-{secrets.token_hex(4)}"
    with open_session(name, logs, shown, *(meeting or place.meet()), place.proof) as here:
        yield here


class SilentProgress:
    """A display that shows nothing, and logs process events and missing workers."""

    def __init__(self) -> None:
        self._has_warned = False

    def show(self, figures: JobStatus) -> None:
        """Warn once if no worker has joined in `ROUTER_SECONDS`."""
        if not (self._has_warned or figures.workers or figures.rate) and figures.seconds > ROUTER_SECONDS:
            self._has_warned = True
            self.say(f"job '{figures.job}' waits: no worker has come to it yet")

    def say(self, sentence: str) -> None:
        """Log an event."""
        log.warning(sentence)
