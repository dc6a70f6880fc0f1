"""The bus over Eclipse Zenoh: the one module that imports zenoh."""

import json
import re
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TypeVar

import structlog
import zenoh

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
from qdgrasp_protocol.errors import BusError, EndpointError, Faulty, NoReply, Refused, SecurityError
from qdgrasp_protocol.keys import matches
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.session import (
    OPEN_SECONDS,
    Credentials,
    Mode,
    ZenohSettings,
    check_open,
    clean_zenoh_error,
    default_endpoint,
    parse_endpoints,
    session_settings,
    unreachable_error,
)
from qdgrasp_protocol.text import printable

log = structlog.get_logger()

T = TypeVar("T")

PORT_TRIES = 3  # Free ports that are tried, as other programs may take one first
FIRST_TRY = 1.0  # seconds of the first try to connect to one of several routers; the next takes twice that
ERROR_ENCODINGS: dict[type[BusError], str] = {
    Refused: "text/plain;qdgrasp.refusal",
    Faulty: "text/plain;qdgrasp.fault",
}
"""Encodings of error replies by error; a reply without either is zenoh's own (time-out)."""

SYSTEM_ERROR = re.compile(r"([A-Z][a-z ]+) \(os error")
MAX_REASON = 1000  # The most bytes that are shown of a refusal

QOS = {
    Channel.DATA: (zenoh.CongestionControl.BLOCK, zenoh.Priority.DATA),
    Channel.CONTROL: (zenoh.CongestionControl.BLOCK, zenoh.Priority.INTERACTIVE_HIGH),
    Channel.MONITOR: (zenoh.CongestionControl.DROP, zenoh.Priority.DATA_LOW),
}
"""Congestion control and priority by channel; links are streams: only drops lose messages."""


def free_endpoint(credentials: Credentials | None = None) -> str:
    """Return the default loopback endpoint if its port is free, else one on a free port."""
    default = default_endpoint(encrypted=credentials is not None)
    for port in (default.port, 0):
        try:
            with socket.create_server((default.host, port)) as server:
                return f"{default.protocol}/{default.host}:{server.getsockname()[1]}"
        except OSError:
            continue
    raise EndpointError(f"No port is free on {default.host}.")


class ZenohBus(Bus):
    """A zenoh session; opened by `connect` or `router`."""

    def __init__(self, session: zenoh.Session, mode: Mode) -> None:
        self._session = session
        self._mode = mode
        self._held: set[Declaration] = set()  # zenoh ends a token without a reference

    @classmethod
    def connect(
        cls,
        endpoint: str | None,
        deadline_seconds: float,
        stop: Stop | None = None,
        credentials: Credentials | None = None,
    ) -> "ZenohBus":
        """Open a session at the router on `endpoint`, trying for `deadline_seconds`.

        Of several endpoints, separated by commas, the first that answers serves, and when it is lost another
        one; None is the default one, and a path from the root is that of a file with the endpoint, which is
        waited for. A try takes as long as a slow link needs, and ends when `stop` is set. An EndpointError if
        no router answers in time, or the text is not an endpoint; a SystemExit if `stop` was set meanwhile.
        """
        if endpoint is None:
            endpoint = default_endpoint(encrypted=credentials is not None).text
        elif endpoint.startswith("/"):
            endpoint = _written_endpoint(Path(endpoint), stop)
        endpoints = parse_endpoints(endpoint)
        deadline = time.monotonic() + deadline_seconds
        order = deque(endpoints)
        patience = FIRST_TRY if len(endpoints) > 1 else OPEN_SECONDS
        ends: SimpleQueue[zenoh.Session | Exception | None] = SimpleQueue()  # Of tries; None: of all of them
        if stop is not None:
            stop.tell(lambda: ends.put(None))
        while True:
            if stop is not None and stop.is_set:
                raise SystemExit(stop.exit_code)
            left = min(patience, max(0.0, deadline - time.monotonic()))
            chosen = session_settings("client", connect=order, credentials=credentials, seconds=left)
            config = _config(chosen, zenoh.Config())
            attempt = partial(_open, config, stop)  # in a thread, as nothing can interrupt it
            threading.Thread(target=lambda attempt=attempt: ends.put(attempt()), daemon=True).start()
            end = ends.get()
            if isinstance(end, zenoh.Session):
                if stop is None or not stop.is_set:
                    return cls(end, "client")
                end.close()  # type: ignore[no-untyped-call]  # zenoh says no type
                continue
            if end is not None and not isinstance(end, zenoh.ZError):
                raise end
            if time.monotonic() >= deadline:
                raise unreachable_error(endpoints, deadline_seconds, credentials)
            order.rotate(-1)  # a router that does not answer may have taken up all of this try
            patience = min(2 * patience, OPEN_SECONDS)

    @classmethod
    def router(
        cls,
        endpoint: str,
        *,
        connect: str | None = None,
        credentials: Credentials | None = None,
        insecure: bool = False,
    ) -> "ZenohBus":
        """Open a session that is the router itself and listens on `endpoint`, or several.

        `connect` names other routers to relay with, now or as soon as they answer. The folder of
        `credentials` holds the access list. An EndpointError if the port is taken, the address is not ours,
        or strangers could get there (unless `insecure`); a SecurityError if the router's file is no
        configuration, or has no access list.
        """
        listening = parse_endpoints(endpoint)
        for place in listening:
            check_open(place, insecure=insecure)
        others = parse_endpoints(connect) if connect is not None else ()
        chosen = session_settings("router", listen=listening, connect=others, credentials=credentials)
        config = _config(chosen, _router_config(credentials) if credentials else zenoh.Config())
        try:
            return cls(zenoh.open(config), "router")
        except zenoh.ZError as error:
            why = SYSTEM_ERROR.search(str(error))
            reason = f"{why[1].lower()}; name another endpoint with --listen" if why else None
            raise EndpointError(
                f"Cannot listen on {endpoint}: {reason or clean_zenoh_error(str(error))}."
            ) from None

    @classmethod
    def embedded(
        cls, endpoint: str | None, credentials: Credentials | None = None, *, insecure: bool = False
    ) -> tuple["ZenohBus", str]:
        """Open a router on `endpoint`, or on a free port if None; return it with its endpoint.

        An `EndpointError` if it cannot be listened on, or no port is free.
        """
        if endpoint is not None:
            return cls.router(endpoint, credentials=credentials, insecure=insecure), endpoint
        for _ in range(PORT_TRIES - 1):
            with suppress(EndpointError):  # another program took the port first
                return cls.embedded(free_endpoint(credentials), credentials)
        return cls.embedded(free_endpoint(credentials), credentials)

    def put(self, key: str, payload: bytes, *, encoding: str, channel: Channel = Channel.DATA) -> None:
        """Publish one message, without a Publisher per key, which would leak memory on every join."""
        congestion_control, priority = QOS[channel]
        self._try(
            lambda: self._session.put(
                key, payload, encoding=encoding, congestion_control=congestion_control, priority=priority
            )
        )

    def subscribe(self, pattern: str, handler: SampleHandler) -> AbstractContextManager[None]:
        """Subscribe to messages."""
        return self._declare(
            lambda sample: handler(_sample(sample)),
            lambda call: self._session.declare_subscriber(pattern, call),
        )

    def ask(self, key: str, payload: bytes = b"", *, parameters: str = "", timeout: float = 5.0) -> bytes:
        """Query a key."""
        selector = f"{key}?{parameters}" if parameters else key
        replies = self._try(
            lambda: self._session.get(
                selector, payload=payload, timeout=timeout, consolidation=zenoh.ConsolidationMode.NONE
            )
        )
        for reply in replies:
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
            for kind, encoding in ERROR_ENCODINGS.items():
                if reply.err is not None and str(reply.err.encoding) == encoding:
                    reason = reply.err.payload.to_bytes()[:MAX_REASON].decode(errors="ignore")
                    raise kind(printable(reason))
        raise NoReply(f"Nobody answered {key} within {timeout:g} s.")

    def answer_values(self, pattern: str, handler: ValuesHandler) -> AbstractContextManager[None]:
        """Answer queries with values; a query that is let go unanswered ends its asker's waiting."""

        def asked(query: zenoh.Query) -> None:
            with query:
                _reply(query, handler)

        return self._declare(asked, lambda call: self._session.declare_queryable(pattern, call))

    def ask_all(self, pattern: str, *, timeout: float = 2.0) -> dict[str, bytes]:
        """Query all matching keys."""
        replies = self._try(
            lambda: self._session.get(pattern, timeout=timeout, consolidation=zenoh.ConsolidationMode.NONE)
        )
        found = [reply.ok for reply in replies if reply.ok is not None]
        return {str(sample.key_expr): sample.payload.to_bytes() for sample in found}

    def token(self, key: str) -> AbstractContextManager[None]:
        """Declare a liveliness token, which zenoh declares again at each reconnection."""
        return self._hold(Declaration(), lambda: self._session.liveliness().declare_token(key))

    def watch(self, pattern: str, handler: TokenHandler) -> AbstractContextManager[None]:
        """Watch tokens; repeated states (echoes after a reconnection) are not reported."""
        alive: set[str] = set()

        def changed(sample: zenoh.Sample) -> None:
            key, is_alive = str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT
            if is_alive != (key in alive):
                alive.symmetric_difference_update({key})
                handler(key, is_alive)

        return self._declare(
            changed,
            lambda call: self._session.liveliness().declare_subscriber(pattern, call, history=True),
        )

    def on_link(self, handler: Callable[[bool], None]) -> AbstractContextManager[None]:
        """Report changes of the transport to the router."""
        if self._mode == "router":
            return Declaration()
        return self._declare(
            lambda event: handler(event.kind == zenoh.SampleKind.PUT),
            self._session.info.declare_transport_events_listener,
        )

    def close(self) -> None:
        """Close the session; without it the process hangs at its end."""
        self._held.clear()
        self._session.close()  # type: ignore[no-untyped-call]  # zenoh says no type

    def _declare(self, callback: Callable[[Any], None], declare: Callable[[Any], Any]) -> Declaration:
        """Declare a callback; its errors are logged, and it is not called after the end."""
        declaration = Declaration()

        def call(argument: Any) -> None:
            try:
                if declaration.holds:
                    callback(argument)
            except Exception:
                log.exception("a callback failed")

        return self._hold(declaration, lambda: declare(call))

    def _hold(self, declaration: Declaration, declare: Callable[[], Any]) -> Declaration:
        """Declare something, and hold it until it is undone."""
        entity = self._try(declare)

        def undo() -> None:
            self._held.discard(declaration)
            entity.undeclare()

        declaration.undo = undo
        self._held.add(declaration)
        return declaration

    def _try(self, act: Callable[[], T]) -> T:
        try:
            return act()
        except zenoh.ZError as error:
            raise BusError(f"The bus refuses: {error}.") from None


def _written_endpoint(path: Path, stop: Stop | None) -> str:
    """Wait for a file with endpoints; return the first of them, as it is reached from here."""
    while not path.exists():
        if stop is not None and stop.is_set:
            raise SystemExit(stop.exit_code)
        time.sleep(0.02)  # seconds
    return parse_endpoints(path.read_text().strip())[0].reached_from(here=True)


def _open(config: zenoh.Config, stop: Stop | None) -> zenoh.Session | Exception:
    """Open a client's session; returns the error in its place, and closes it after a stop."""
    try:
        session = zenoh.open(config)
    except Exception as error:  # noqa: BLE001  # it is for the thread that waits
        return error
    if stop is not None and stop.is_set:
        session.close()  # type: ignore[no-untyped-call]  # zenoh says no type
    return session


def _sample(sample: zenoh.Sample) -> Sample:
    return Sample(str(sample.key_expr), sample.payload.to_bytes(), str(sample.encoding))


def _config(chosen: ZenohSettings, config: zenoh.Config) -> zenoh.Config:
    for name, value in chosen.items():
        config.insert_json5(name, json.dumps(value))
    return config


def _router_config(credentials: Credentials) -> zenoh.Config:
    """Return a router's configuration file, after a check of its access list."""
    path = credentials.configuration
    try:
        config = zenoh.Config.from_json5(path.read_text())
        guard = json.loads(config.get_json("access_control"))
    except (OSError, ValueError, zenoh.ZError) as error:
        raise SecurityError(
            f"{path} is not a configuration that zenoh takes: {clean_zenoh_error(str(error))}."
        ) from None
    if not (guard["enabled"] and guard["default_permission"] == "deny"):
        raise SecurityError(
            f"{path} does not deny what it does not allow; `qdgrasp security init` writes a file that does."
        )
    return config


def _reply(query: zenoh.Query, handler: ValuesHandler) -> None:
    """Answer one query with the values that match it, or with the error."""
    key = str(query.key_expr)
    payload = query.payload.to_bytes() if query.payload is not None else b""
    try:
        values = handler(Query(key, str(query.parameters), payload))
    except Exception as error:  # noqa: BLE001  # any error is sent to the asker, and logged
        told = reply_error(error, key)
        for kind, encoding in ERROR_ENCODINGS.items():
            if isinstance(told, kind):
                query.reply_err(str(told).encode(), encoding=encoding)
        return
    for concrete, value in values.items():
        if matches(key, concrete):
            query.reply(concrete, value)
