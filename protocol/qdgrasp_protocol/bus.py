"""The interface of the message bus: all that qdgrasp needs of one, and no more.

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
    """Delivery and priority of a message (docs/bus.md, keys)."""

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
    """A question that arrived."""

    key: str
    parameters: str
    """The text behind the `?`: `"i=3"`."""
    payload: bytes


SampleHandler = Callable[[Sample], None]
QueryHandler = Callable[[Query], bytes]
"""Answers a query.

Raising `Refused` becomes an error reply that carries the reason, `NoReply` leaves the asker without an
answer; anything else is a fault of ours: it is logged, and the asker hears the error's name as `Faulty`.
"""
ValuesHandler = Callable[[Query], Mapping[str, bytes]]
"""Answers a query, perhaps a pattern, with values by key; raises as a `QueryHandler`."""
TokenHandler = Callable[[str, bool], None]
"""Takes a key, and True if its token is alive, False if it is gone."""


class Declaration(AbstractContextManager[Any]):
    """Something a session declared: it holds from the call that made it until its context ends.

    `undo` takes it back; it is called once.
    """

    def __init__(self, undo: Callable[[], object] = lambda: None) -> None:
        self.undo = undo
        self.holds = True
        """False from the moment the context ends: what still arrives then is not handed on."""

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
        """Take all that is there, eldest first, without waiting; nothing once the context has ended."""


def reply_error(error: Exception, key: str) -> BusError:
    """The error to send to the asker for an error in a query handler; `NoReply`: none is sent."""
    if isinstance(error, Refused | NoReply):
        return error
    log.error("a query was not answered", key=key, exc_info=error)
    return Faulty(f"internal error: {type(error).__name__}")


class Bus(ABC):
    """One session on the bus; a context manager that closes it with all that it declared.

    Keys are concrete; patterns may hold `*` (one chunk) and `**` (any number of chunks), which never match
    a chunk that begins with `@`. Messages of one session on one channel arrive in the order they were put.
    What a handler raises is logged. Every call on a closed session raises `BusError`.
    """

    @abstractmethod
    def put(self, key: str, payload: bytes, *, encoding: str, channel: Channel = Channel.DATA) -> None:
        """Publish `payload` on `key`. Returns at once; while disconnected the message is lost."""

    @abstractmethod
    def subscribe(self, pattern: str, handler: SampleHandler) -> AbstractContextManager[None]:
        """Pass every message whose key matches `pattern` to `handler` until the context ends."""

    @abstractmethod
    def ring(self, pattern: str, capacity: int) -> RingBuffer:
        """Keep the latest `capacity` messages whose key matches `pattern` until the context ends.

        For processes that only watch: no code of ours runs when a message comes, and a reader that stops
        reading holds up no other.
        """

    def answer(self, pattern: str, handler: QueryHandler) -> AbstractContextManager[None]:
        """Answer queries on `pattern` until the context ends, one at a time; see `QueryHandler`."""
        return self.show(pattern, lambda query: {query.key: handler(query)})

    @abstractmethod
    def ask(self, key: str, payload: bytes = b"", *, parameters: str = "", timeout: float = 5.0) -> bytes:
        """Query `key` and return the first answer; it fails at once if there is no queryable.

        Refused if the other side gives a reason why not, NoReply if there is no answer within `timeout`
        seconds, and Faulty if the other side failed.
        """

    @abstractmethod
    def show(self, pattern: str, handler: ValuesHandler) -> AbstractContextManager[None]:
        """Answer queries on `pattern`, perhaps patterns, with any number of values by key.

        Values whose keys do not match what was asked are left out.
        """

    @abstractmethod
    def ask_all(self, pattern: str, *, timeout: float = 2.0) -> dict[str, bytes]:
        """Query all that matches `pattern`; return the values that came in time [s], by key."""

    @abstractmethod
    def token(self, key: str) -> AbstractContextManager[None]:
        """Show that this session is alive under `key`, until the context ends or the session dies."""

    @abstractmethod
    def watch(self, pattern: str, handler: TokenHandler) -> AbstractContextManager[None]:
        """Report every token that matches `pattern`: those alive now, and then each change.

        While the session is cut off, every token of others counts as gone.
        """

    @abstractmethod
    def on_link(self, handler: Callable[[bool], None]) -> AbstractContextManager[None]:
        """Report when this session is cut off from the bus (False) and when it is back (True).

        A session that is itself the router is never cut off: a client that leaves it is no news here.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the session and everything it declared; closing twice is allowed."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class DropCounter:
    """Counts dropped messages; the first, second, fourth, eighth ... is logged."""

    def __init__(self) -> None:
        self.count = 0

    def note(self, key: str, reason: object) -> None:
        """Count a message that is dropped for a reason."""
        self.count += 1
        if self.count & (self.count - 1) == 0:
            log.warning("dropped a message", key=key[:MAX_SHOWN_KEY], reason=str(reason), dropped=self.count)


MAX_SHOWN_KEY = 200  # The most characters of a key that are told
