"""What the commands share that ask, or tell, the coordinators on a bus."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.credentials import Credentials, Role
from qdgrasp_protocol.endpoint import home
from qdgrasp_protocol.zenoh_bus import ZenohBus

PATIENCE = 3.0  # seconds that a router may take to answer


@contextmanager
def session(
    connect: str, security: Path | None, role: Role = Role.ADMIN, wait: float = PATIENCE
) -> Iterator[Bus]:
    """A session at a router, for a question or two; a signal ends it, also while nobody answers.

    Parameters
    ----------
    wait
        Seconds that the router may take to answer.

    Raises
    ------
    EndpointError
        Nothing answers there.
    SecurityError
        The folder of certificates lacks those of the role.
    """
    credentials = Credentials.find(security, role)
    with ZenohBus.connect(connect, wait, credentials=credentials) as bus:
        yield bus


def nobody(endpoint: str) -> str:
    """What is said where there is no job."""
    return f"No job is at {endpoint}: the router answers, but no coordinator does."


def place(connect: str | None, security: Path | None) -> str:
    """The endpoint that was named, or the default one."""
    return connect or home(encrypted=security is not None).text
