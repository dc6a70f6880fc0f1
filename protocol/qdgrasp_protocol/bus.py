"""The interface of the message bus, with the calls that qdgrasp needs.

`zenoh_bus` carries it over Eclipse Zenoh; one contract test class runs over that and the in-memory twin of
the tests. Callbacks come from threads of the bus: they put what they got on a queue and return. Scene bundles
are sent by their sha256, a query per chunk (docs/bus.md).
"""

import hashlib
import os
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Self

import structlog

from qdgrasp_protocol import messages
from qdgrasp_protocol.errors import BusError, Faulty, MessageError, NoReply, Refused
from qdgrasp_protocol.keys import last_chunk, parse_number
from qdgrasp_protocol.messages import Chunk, M
from qdgrasp_protocol.text import printable

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


def decode_sample(sample: Sample, kind: type[M]) -> M:
    """The message of `kind` in a sample; a MessageError if its encoding or content is another."""
    if sample.encoding != messages.encoding(kind):
        raise MessageError(
            f"expected {messages.encoding(kind)}, got {printable(sample.encoding, messages.MAX_REASON)}"
        )
    return messages.decode(sample.payload, kind)


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


class RingBuffer:
    """The newest messages that are not taken yet: when it is full, the oldest gives way."""

    def __init__(self, capacity: int) -> None:
        self._heard: deque[Sample] = deque(maxlen=capacity)

    def put(self, sample: Sample) -> None:
        """Add a message."""
        self._heard.append(sample)

    def take(self) -> list[Sample]:
        """Take all messages, oldest first, without waiting."""
        taken = []
        with suppress(IndexError):  # it is empty
            while True:
                taken.append(self._heard.popleft())
        return taken


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

    @contextmanager
    def ring(self, pattern: str, capacity: int) -> Iterator[RingBuffer]:
        """Keep the latest `capacity` messages whose key matches `pattern` until the context ends.

        For processes that only watch: a reader that stops reading holds up no other.
        """
        buffer = RingBuffer(capacity)
        with self.subscribe(pattern, buffer.put):
            yield buffer

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


CHUNK_SIZE = 512 << 10  # Bytes of a bundle in one answer


class TooLarge(MessageError):
    """A scene that is larger than one can be, by its number of chunks."""

    def __init__(self, total: int) -> None:
        super().__init__(f"the scene has {total} chunks, more than {messages.MAX_BUNDLE // CHUNK_SIZE}")


def answer_chunk(query: Query, payload: bytes, digest: str) -> bytes:
    """The chunk of a bundle that a query names by `i=<number>`; Refused if there is no such one."""
    if last_chunk(query.key) != digest:
        raise Refused("no such scene here")
    total, start = _place(query, len(payload))
    return messages.encode(Chunk(total=total, data=payload[start : start + CHUNK_SIZE]))


def answer_file_chunk(query: Query, path: Path) -> bytes:
    """The chunk of a file that a query names by `i=<number>`; Refused without one.

    The file may have changed: its sha256 is compared where it is fetched. Refused also without a file.
    """
    try:
        with path.open("rb") as file:
            total, start = _place(query, os.fstat(file.fileno()).st_size)
            file.seek(start)
            return messages.encode(Chunk(total=total, data=file.read(CHUNK_SIZE)))
    except OSError as error:
        raise Refused(f"the file {path.name} cannot be read: {error.strerror or error}") from None


def _place(query: Query, size: int) -> tuple[int, int]:
    """The number of chunks of so many bytes, and where the one that a query names begins."""
    total = max(1, -(-size // CHUNK_SIZE))
    place = parse_number(query.parameters.removeprefix("i="))
    if place is None or place >= total:
        raise Refused(f"chunk '{query.parameters[:20]}' is not one of {total}")
    return total, place * CHUNK_SIZE


def fetch_bundle(bus: Bus, key: str) -> bytes:
    """All bytes of a bundle, from the process that answers on `key`, which ends with its digest.

    NoReply or Refused if there is no such scene, TooLarge if it cannot be one, a MessageError if what came is
    not the scene of that digest.
    """
    first = messages.decode(bus.ask(key, parameters="i=0"), Chunk)
    if first.total * CHUNK_SIZE > messages.MAX_BUNDLE:
        raise TooLarge(first.total)
    rest = [messages.decode(bus.ask(key, parameters=f"i={i}"), Chunk).data for i in range(1, first.total)]
    payload = b"".join([first.data, *rest])
    if hashlib.sha256(payload).hexdigest() != last_chunk(key):
        raise MessageError(f"the scene that came is not {last_chunk(key)[:12]}")
    return payload
