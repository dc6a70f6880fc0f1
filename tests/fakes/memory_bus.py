"""The in-memory twin of the bus, with links that can be cut.

A message is delivered in the thread that puts it, before `put` returns, to subscribers in the order they
subscribed: one thread that acts sees everything in one order. A query is answered in a thread of its own,
so that its time-out holds.
"""

import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future, wait
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any, Literal

import structlog

from qdgrasp_protocol.bus import (
    Bus,
    Channel,
    Declaration,
    Query,
    Sample,
    SampleHandler,
    TokenHandler,
    ValuesHandler,
    reply_error,
)
from qdgrasp_protocol.errors import BusError, NoReply
from qdgrasp_protocol.keys import matches

log = structlog.get_logger()


Kind = Literal["subscriber", "queryable", "token", "watcher"]


@dataclass(eq=False)
class Registration:
    """A declaration of a session on a pattern."""

    session: "MemoryBus"
    kind: Kind
    pattern: str
    handler: Callable[..., Any] = print
    """Of a subscriber, a queryable, which answers one query at a time, or a watcher of tokens."""
    lock: threading.Lock = field(default_factory=threading.Lock)
    alive: list[str] = field(default_factory=list)
    """Tokens that a watcher was told to be alive."""


class MemoryNetwork:
    """Declarations and locks shared by the sessions of one process."""

    def __init__(self) -> None:
        self._lock = threading.RLock()  # held while tokens are told, so that all hear of them in one order
        self._entries: list[Registration] = []

    def session(self) -> "MemoryBus":
        """Open a session."""
        return MemoryBus(self)

    def add(self, entry: Registration) -> Declaration:
        """Add an entry until its declaration ends."""
        with self._lock:
            self._entries.append(entry)
            self.report_tokens()
        return Declaration(lambda: self.remove(lambda other: other is entry))

    def remove(self, is_over: Callable[[Registration], bool]) -> None:
        """Remove entries."""
        with self._lock:
            self._entries = [entry for entry in self._entries if not is_over(entry)]
            self.report_tokens()

    def visible(self, kind: Kind, session: "MemoryBus") -> list[Registration]:
        """Return the entries of a kind that `session` can reach."""
        with self._lock:
            return [e for e in self._entries if e.kind == kind and session.reaches(e.session)]

    def report_tokens(self) -> None:
        """Report to every watcher how the tokens that it can see have changed."""
        with self._lock:
            for watcher in [e for e in self._entries if e.kind == "watcher"]:
                tokens = [token.pattern for token in self.visible("token", watcher.session)]
                before, now = watcher.alive, [key for key in tokens if matches(watcher.pattern, key)]
                watcher.alive = now
                for key in dict.fromkeys([*before, *now]):
                    if (key in before) != (key in now):
                        _call(watcher.handler, key, key in now)


class MemoryBus(Bus):
    """A session of a `MemoryNetwork`."""

    def __init__(self, network: MemoryNetwork) -> None:
        self._network = network
        self._links: list[Callable[[bool], None]] = []
        self._is_open = True
        self._is_cut = False

    def reaches(self, other: "MemoryBus") -> bool:
        """Return whether two sessions are connected."""
        return self is other or not (self._is_cut or other._is_cut)

    def disconnect(self) -> None:
        """Break the link to all others; messages put meanwhile are lost."""
        self._set_cut(True)

    def reconnect(self) -> None:
        """Restore the link; tokens appear again."""
        self._set_cut(False)

    def put(self, key: str, payload: bytes, *, encoding: str, channel: Channel = Channel.DATA) -> None:
        """Deliver a message to every subscriber before this call returns."""
        sample = Sample(key, bytes(payload), encoding)
        for subscriber in self._visible("subscriber"):
            if matches(subscriber.pattern, key):
                _call(subscriber.handler, sample)

    def subscribe(self, pattern: str, handler: SampleHandler) -> AbstractContextManager[None]:
        """Subscribe to messages."""
        return self._declare("subscriber", pattern, handler)

    def answer_values(self, pattern: str, handler: ValuesHandler) -> AbstractContextManager[None]:
        """Answer queries with values."""
        return self._declare("queryable", pattern, handler)

    def ask(self, key: str, payload: bytes = b"", *, parameters: str = "", timeout: float = 5.0) -> bytes:
        """Query a key."""
        answerers = [each for each in self._visible("queryable") if matches(each.pattern, key)]
        if not answerers:
            raise NoReply(f"Nobody answers {key}.")
        try:
            values = _query(answerers[0], Query(key, parameters, bytes(payload))).result(timeout)
        except TimeoutError:
            raise NoReply(f"Nobody answered {key} within {timeout:g} s.") from None
        if key not in values:
            raise NoReply(f"Nobody has a value of {key}.")
        return values[key]

    def ask_all(self, pattern: str, *, timeout: float = 2.0) -> dict[str, bytes]:
        """Query all matching keys."""
        answerers, query = self._visible("queryable"), Query(pattern, "", b"")
        answers = [_query(each, query) for each in answerers if matches(each.pattern, pattern)]
        answered, _ = wait(answers, timeout)
        found = [answer.result() for answer in answers if answer in answered and not answer.exception()]
        return {key: value for values in found for key, value in values.items() if matches(pattern, key)}

    def token(self, key: str) -> AbstractContextManager[None]:
        """Declare a liveliness token."""
        return self._declare("token", key)

    def watch(self, pattern: str, handler: TokenHandler) -> AbstractContextManager[None]:
        """Watch tokens."""
        return self._declare("watcher", pattern, handler)

    def on_link(self, handler: Callable[[bool], None]) -> AbstractContextManager[None]:
        """Report `disconnect` and `reconnect`."""
        self._links.append(handler)
        return Declaration(lambda: self._links.remove(handler))

    def close(self) -> None:
        """Take back everything declared."""
        self._is_open = False
        self._network.remove(lambda entry: entry.session is self)

    def _declare(self, kind: Kind, pattern: str, handler: Callable[..., Any] = print) -> Declaration:
        self._check_open()
        return self._network.add(Registration(self, kind, pattern, handler))

    def _visible(self, kind: Kind) -> list[Registration]:
        self._check_open()
        return self._network.visible(kind, self)

    def _set_cut(self, cut: bool) -> None:
        if cut != self._is_cut:
            self._is_cut = cut
            for handler in list(self._links):
                _call(handler, not cut)
            self._network.report_tokens()

    def _check_open(self) -> None:
        if not self._is_open:
            raise BusError("The session is closed.")


def _query(answerer: Registration, query: Query) -> "Future[Mapping[str, bytes]]":
    """Return the future answer of a query, made in a thread of its own."""
    answer: Future[Mapping[str, bytes]] = Future()

    def reply() -> None:
        with answerer.lock:
            try:
                answer.set_result(answerer.handler(query))
            except Exception as error:  # noqa: BLE001  # any error is sent to the asker, and logged
                answer.set_exception(reply_error(error, query.key))

    threading.Thread(target=reply, daemon=True).start()
    return answer


def _call(handler: Callable[..., None], *arguments: object) -> None:
    try:
        handler(*arguments)
    except Exception:
        log.exception("a callback failed")
