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
    """How a message travels (docs/bus.md, keys)."""

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
    """What stands behind the `?`: `"i=3"`."""
    payload: bytes


SampleHandler = Callable[[Sample], None]
QueryHandler = Callable[[Query], bytes]
"""Answers a query.

Raising `Refused` becomes an error reply that carries the reason, `NoReply` leaves the asker without an
answer; anything else is a fault of ours: it is logged, and the asker hears the error's name as `Faulty`.
"""
ValuesHandler = Callable[[Query], Mapping[str, bytes]]
"""Answers a query that may be a pattern, with values by their concrete keys; raises as a `QueryHandler`."""
TokenHandler = Callable[[str, bool], None]
"""Told a key and whether its token is alive (True) or gone (False)."""


class Declaration(AbstractContextManager[Any]):
    """Something a session declared: it holds from the call that made it until its context ends.

    Parameters
    ----------
    undo
        Takes it back; called once.
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
    """What was heard lately and is not taken yet: so many messages at most, the newest.

    Nobody waits for whoever reads it: where it is full, the eldest message gives way to the next.
    """

    def __enter__(self) -> Self:
        return self

    @abstractmethod
    def take(self) -> list[Sample]:
        """Take all that is there, eldest first, without waiting; nothing once the context has ended."""


def reply_error(error: Exception, key: str) -> BusError:
    """What the asker is told of an error in a query handler; `NoReply`: nothing."""
    if isinstance(error, Refused | NoReply):
        return error
    log.error("a query was not answered", key=key, exc_info=error)
    return Faulty(f"internal error: {type(error).__name__}")


class Bus(ABC):
    """One session on the bus. A context manager: leaving it closes the session and all it declared.

    Keys are concrete; patterns may hold `*` (one chunk) and `**` (any number of chunks), which never match
    a chunk that begins with `@`. Messages of one session on one channel arrive in the order they were put.
    What a handler raises is logged. Every call on a closed session raises `BusError`.
    """

    @abstractmethod
    def put(self, key: str, payload: bytes, *, encoding: str, channel: Channel = Channel.DATA) -> None:
        """Publish `payload` on `key`. Returns at once; while disconnected the message is lost."""

    @abstractmethod
    def subscribe(self, pattern: str, handler: SampleHandler) -> AbstractContextManager[None]:
        """Hear every message whose key matches `pattern` until the context ends."""

    @abstractmethod
    def ring(self, pattern: str, capacity: int) -> RingBuffer:
        """Keep the latest `capacity` messages whose key matches `pattern` until the context ends.

        For whoever only watches: no code of ours runs when a message comes, and a reader that stops reading
        holds nobody up.
        """

    @abstractmethod
    def answer(self, pattern: str, handler: QueryHandler) -> AbstractContextManager[None]:
        """Answer queries on `pattern` until the context ends, one at a time; see `QueryHandler`."""

    @abstractmethod
    def ask(self, key: str, payload: bytes = b"", *, parameters: str = "", timeout: float = 5.0) -> bytes:
        """Query `key` and return the first answer; where nobody answers on `key` it fails at once.

        Raises
        ------
        Refused
            The other side answered with a reason why not.
        NoReply
            Nobody answers there, or not within `timeout` seconds.
        Faulty
            The other side failed.
        """

    @abstractmethod
    def show(self, pattern: str, handler: ValuesHandler) -> AbstractContextManager[None]:
        """Answer queries on `pattern`, which may be patterns too, with any number of values, each by its key.

        Values whose keys do not match what was asked are left out.
        """

    @abstractmethod
    def ask_all(self, pattern: str, *, timeout: float = 2.0) -> dict[str, bytes]:
        """Query whatever matches `pattern`; gives all values that came within `timeout` seconds, by key."""

    @abstractmethod
    def token(self, key: str) -> AbstractContextManager[None]:
        """Show that this session is alive under `key`, until the context ends or the session dies."""

    @abstractmethod
    def watch(self, pattern: str, handler: TokenHandler) -> AbstractContextManager[None]:
        """Hear of every token that matches `pattern`: those alive now, and then each change.

        While the session is cut off, every token of others counts as gone.
        """

    @abstractmethod
    def on_link(self, handler: Callable[[bool], None]) -> AbstractContextManager[None]:
        """Hear when this session is cut off from the bus (False) and when it is back (True).

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
    """How many messages were dropped; the first, second, fourth, eighth ... is told of."""

    def __init__(self) -> None:
        self.count = 0

    def note(self, key: str, reason: object) -> None:
        """Count a message that is dropped for a reason."""
        self.count += 1
        if self.count & (self.count - 1) == 0:
            log.warning("dropped a message", key=key[:MAX_SHOWN_KEY], reason=str(reason), dropped=self.count)


MAX_SHOWN_KEY = 200  # The most characters of a key that are told
