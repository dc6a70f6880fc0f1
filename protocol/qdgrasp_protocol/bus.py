"""The one interface to the outside: what qdgrasp needs of a message bus, and no more.

`zenoh_bus` carries it over Eclipse Zenoh, `local_bus` is its in-memory twin; one contract test class
runs over both. Callbacks come from threads of the bus: they put what they got on a queue and return.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import Enum


class Channel(Enum):
    """How a message travels (PROTOCOL.md, keys)."""

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
"""Answers a query; raising `Refused` becomes an error reply that carries the reason."""
TokenHandler = Callable[[str, bool], None]
"""Told a key and whether its token is alive (True) or gone (False)."""


class Bus(ABC):
    """One session on the bus. A context manager: leaving it closes the session and all it declared."""

    @abstractmethod
    def put(self, key: str, payload: bytes, *, encoding: str, channel: Channel = Channel.DATA) -> None:
        """Publish `payload` on `key`. Returns at once; while disconnected the message is lost."""

    @abstractmethod
    def subscribe(self, pattern: str, handler: SampleHandler) -> AbstractContextManager[None]:
        """Hear every message whose key matches `pattern` until the context ends."""

    @abstractmethod
    def answer(self, pattern: str, handler: QueryHandler) -> AbstractContextManager[None]:
        """Answer queries on `pattern` until the context ends; what the handler raises is the answer."""

    @abstractmethod
    def ask(self, key: str, payload: bytes = b"", *, parameters: str = "", timeout: float = 5.0) -> bytes:
        """Query `key` and return the first answer.

        Raises
        ------
        Refused
            The other side answered with a reason why not.
        NoReply
            Nobody answers there, or not within `timeout` seconds.
        """

    @abstractmethod
    def token(self, key: str) -> AbstractContextManager[None]:
        """Show that this session is alive under `key`, until the context ends or the session dies."""

    @abstractmethod
    def watch(self, pattern: str, handler: TokenHandler) -> AbstractContextManager[None]:
        """Hear of every token that matches `pattern`: those alive now, and then each change."""

    @abstractmethod
    def on_link(self, handler: Callable[[bool], None]) -> AbstractContextManager[None]:
        """Hear of each transport of this session that comes up (True) or goes down (False)."""

    @abstractmethod
    def close(self) -> None:
        """Close the session and everything it declared; closing twice is allowed."""

    def __enter__(self) -> "Bus":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
