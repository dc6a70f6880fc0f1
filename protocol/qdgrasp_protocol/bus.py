"""The interface of the message bus, with the calls that qdgrasp needs.

`zenoh_bus` carries it over Eclipse Zenoh, `memory_bus` is its in-memory twin; one contract test class runs
over both. Callbacks come from threads of the bus: they put what they got on a queue and return.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import Enum
from typing import Any, Self

import structlog

from qdgrasp_protocol.errors import BusError, Faulty, NoReply, Refused

log = structlog.get_logger()


class Channel(Enum):
    """Delivery class of a message (docs/bus.md, keys)."""

    DATA = "data"
    """Reliable, blocks when the link is full."""
    CONTROL = "control"
    """Reliable, before DATA."""
    MONITOR = "monitor"
    """Best effort, dropped when the link is full, after everything else."""


@dataclass(frozen=True)
class Sample:
    """A message that arrived."""

    key: str
    payload: bytes
    encoding: str


@dataclass(frozen=True)
class Query:
    """A query that arrived."""

    key: str
    parameters: str
    """The part of the selector after the `?`: `"i=3"`."""
    payload: bytes


@dataclass(frozen=True)
class TokenChange:
    """A token that is watched appeared or vanished."""

    key: str
    alive: bool


@dataclass(frozen=True)
class LinkChange:
    """A transport of this session came up or went down."""

    up: bool


SampleHandler = Callable[[Sample], None]
QueryHandler = Callable[[Query], bytes]
"""Answers a query.

Raising `Refused` becomes an error reply that carries the reason, `NoReply` leaves the asker without an
answer; any other exception is an internal error: it is logged, and the asker gets its name as `Faulty`.
"""
ValuesHandler = Callable[[Query], Mapping[str, bytes]]
"""Answers a query, possibly a pattern, with values by key; raises as a `QueryHandler`."""
TokenHandler = Callable[[str, bool], None]  # Takes a key, and True if its token is alive, False if it is gone


class Declaration(AbstractContextManager[Any]):
    """Something a session declared: it holds from the call that made it until its context ends.

    `undo` takes it back; it is called once.
    """

    def __init__(self, undo: Callable[[], object] = lambda: None) -> None:
        self.undo = undo
        self.holds = True  # False once the context has ended: what arrives later is not delivered

    def __exit__(self, *_: object) -> None:
        if self.holds:
            self.holds = False
            self.undo()


class RingBuffer(Declaration, ABC):
    """The newest messages that are not taken yet: when it is full, the oldest gives way."""

    def __enter__(self) -> Self:
        return self

    @abstractmethod
    def take(self) -> list[Sample]:
        """Take all messages, oldest first, without waiting; empty once the context has ended."""


def reply_error(error: Exception, key: str) -> BusError:
    """Return the error that the asker gets for an exception in a query handler."""
    if isinstance(error, Refused | NoReply):
        return error
    log.error("a query was not answered", key=key, exc_info=error)
    return Faulty(f"internal error: {type(error).__name__}")


class Bus(ABC):
    """One session on the bus.

    A context manager: leaving it closes the session and all it declared. Keys are concrete; patterns may
    hold `*` (one chunk) and `**` (any number of chunks), which never match a chunk that begins with `@`.
    Messages of one session on one channel arrive in the order they were put. Exceptions of handlers are
    logged. Every call on a closed session raises `BusError`.
    """

    @abstractmethod
    def put(self, key: str, payload: bytes, *, encoding: str, channel: Channel = Channel.DATA) -> None:
        """Publish `payload` on `key`. Returns at once; while disconnected the message is lost."""

    @abstractmethod
    def subscribe(self, pattern: str, handler: SampleHandler) -> AbstractContextManager[None]:
        """Call `handler` with every message whose key matches `pattern` until the context ends."""

    @abstractmethod
    def ring(self, pattern: str, capacity: int) -> RingBuffer:
        """Keep the latest `capacity` messages whose key matches `pattern` until the context ends.

        For processes that only watch: no code of ours runs when a message comes, and a reader that stops
        reading holds up no other.
        """

    def answer(self, pattern: str, handler: QueryHandler) -> AbstractContextManager[None]:
        """Answer queries on `pattern` until the context ends, one at a time; see `QueryHandler`."""
        return self.answer_values(pattern, lambda query: {query.key: handler(query)})

    @abstractmethod
    def ask(self, key: str, payload: bytes = b"", *, parameters: str = "", timeout: float = 5.0) -> bytes:
        """Query `key` and return the first answer; it fails at once if there is no queryable.

        Refused if the other side gives a reason why not, NoReply if there is no answer within `timeout`
        seconds, and Faulty if the other side failed.
        """

    @abstractmethod
    def answer_values(self, pattern: str, handler: ValuesHandler) -> AbstractContextManager[None]:
        """Answer queries on `pattern`, which may be patterns too, with any number of values by key.

        Values whose keys do not match what was asked are left out.
        """

    @abstractmethod
    def ask_all(self, pattern: str, *, timeout: float = 2.0) -> dict[str, bytes]:
        """Query all keys that match `pattern`; returns the values that came in time, by key."""

    @abstractmethod
    def token(self, key: str) -> AbstractContextManager[None]:
        """Declare a liveliness token on `key`, until the context ends or the session dies."""

    @abstractmethod
    def watch(self, pattern: str, handler: TokenHandler) -> AbstractContextManager[None]:
        """Call `handler` for every token that matches `pattern`: those alive now, then each change.

        While the session is cut off, every token of others counts as gone.
        """

    @abstractmethod
    def on_link(self, handler: Callable[[bool], None]) -> AbstractContextManager[None]:
        """Call `handler` when this session loses its router (False) and when it is back (True).

        A session that is itself the router never loses it; clients that leave are not reported.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the session and everything it declared; closing twice is allowed."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class DropCounter:
    """Counter of dropped messages; the first, second, fourth, eighth ... is logged."""

    def __init__(self) -> None:
        self.count = 0

    def note(self, key: str, reason: object) -> None:
        """Count a dropped message, with the reason for the log."""
        self.count += 1
        if self.count & (self.count - 1) == 0:
            log.warning("dropped a message", key=key[:MAX_SHOWN_KEY], reason=str(reason), dropped=self.count)


MAX_SHOWN_KEY = 200  # The most characters of a key that are told
