"""What reaches the coordinator's one thread: callbacks of the bus and the opener put it here and return."""

from concurrent.futures import Future
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue

from qdgrasp_coordinator.serving.opener import News
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.messages import Join, Order


@dataclass(frozen=True)
class JoinRequest:
    """A worker asks to join and waits for the answer."""

    join: Join
    answer: Future[bytes] = field(default_factory=Future)


@dataclass(frozen=True)
class OrderRequest:
    """Somebody administers this job and waits for what happened, in words."""

    order: Order
    answer: Future[str] = field(default_factory=Future)


@dataclass(frozen=True)
class TokenChange:
    """A token of this job appeared or vanished."""

    key: str
    alive: bool


@dataclass(frozen=True)
class LinkChange:
    """A transport of this session came up or went down."""

    up: bool


@dataclass(frozen=True)
class Wake:
    """Look at the signals."""


Event = Sample | JoinRequest | OrderRequest | TokenChange | LinkChange | News | Wake


class Inbox:
    """Events in the order they came."""

    def __init__(self) -> None:
        self._queue: SimpleQueue[Event] = SimpleQueue()

    def put(self, event: Event) -> None:
        """Add an event; safe in a signal handler."""
        self._queue.put(event)

    def take(self, patience: float, most: int = 256) -> list[Event]:
        """What is there, waiting at most `patience` seconds for the first; at most `most` events."""
        events: list[Event] = []
        try:
            events.append(self._queue.get(timeout=max(0.0, patience)))
            while len(events) < most:
                events.append(self._queue.get_nowait())
        except Empty:
            pass
        return events
