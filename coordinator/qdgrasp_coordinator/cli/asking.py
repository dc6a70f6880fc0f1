"""What the commands share that ask, or tell, the coordinators on a bus."""

from collections.abc import Iterator
from contextlib import contextmanager

from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.lifetime import lifetime
from qdgrasp_protocol.zenoh_bus import ZenohBus

PATIENCE = 3.0  # seconds that a router may take to answer


@contextmanager
def session(title: str, connect: str) -> Iterator[Bus]:
    """A session at a router, for a question or two.

    Raises
    ------
    EndpointError
        Nothing answers there.
    """
    with lifetime(title) as stop, ZenohBus.connect(connect, PATIENCE, stop) as bus:
        yield bus
