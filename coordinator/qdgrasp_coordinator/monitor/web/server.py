"""HTTP server of a page: a few addresses to read from, and nothing to write to.

A connection on which nothing is asked soon is closed, and so are too many from one address.
"""

import asyncio
import socket
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Protocol

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Mount
from starlette.staticfiles import StaticFiles
from uvicorn.protocols.http.h11_impl import H11Protocol

from qdgrasp_coordinator.monitor.web.access import Access, AccessMiddleware
from qdgrasp_protocol.errors import EndpointError, InputError, QdgraspError
from qdgrasp_protocol.process import Stop

FIRST_REQUEST_SECONDS = 10.0  # So long a connection may take to send its first request [s]
MAX_CONNECTIONS_PER_ADDRESS = 256
"""So many connections may come from one address, half of all that there may be."""


class LimitedConnection(H11Protocol):
    """A connection that is closed where nothing is asked on it, or too many come from its address."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as in H11Protocol: over TCP
        """Begin; whoever has many already is shut out alone."""
        super().connection_made(transport)
        if self.others >= MAX_CONNECTIONS_PER_ADDRESS:
            transport.abort()
        else:
            self._deadline = self.loop.call_later(FIRST_REQUEST_SECONDS, self.leave)

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        super().connection_lost(exc)
        if self._deadline:
            self._deadline.cancel()

    @property
    def others(self) -> int:
        """How many other connections there are from this address."""
        host = self.client and self.client[0]
        visits = [
            visit for visit in self.connections if isinstance(visit, LimitedConnection) and visit is not self
        ]
        return sum(1 for visit in visits if visit.client and visit.client[0] == host)

    def leave(self) -> None:
        """Make room, unless something was asked."""
        if self.cycle is None:
            self.transport.close()


STATIC = Path(__file__).with_name("static")
CLOSING_SECONDS = 1  # seconds that answers under way may take when the server ends
MAX_CONNECTIONS = 512  # So many at a time; whoever comes then is asked to try again


class Site(Protocol):
    """What is served."""

    def routes(self) -> list[BaseRoute]:
        """What is answered where."""

    def end(self) -> None:
        """Hear that the server ends: nobody is to be kept waiting."""


class PageServer(uvicorn.Server):
    """A server that leaves signals to this process, and lets those who watch go when it ends."""

    def __init__(self, config: uvicorn.Config, site: Site) -> None:
        super().__init__(config)
        self._site = site

    def capture_signals(self) -> nullcontext[None]:  # type: ignore[override]  # any with-block does
        """Leave them."""
        return nullcontext()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End."""
        self._site.end()
        await super().shutdown(sockets)

    def end(self) -> None:
        """Have it end soon; may be called by a signal's handler."""
        self.should_exit = True


def application(site: Site, access: Access) -> Starlette:
    """A site as an ASGI application."""
    return Starlette(
        routes=[*site.routes(), Mount("/static", StaticFiles(directory=STATIC))],
        middleware=[
            Middleware(AccessMiddleware, access=access),
            Middleware(GZipMiddleware, minimum_size=1024, compresslevel=5),
        ],
        exception_handlers={QdgraspError: _error_response},
    )


def serve(site: Site, host: str, port: int, token: str, stop: Stop, opened: Callable[[str], object]) -> None:
    """Serve a site until this process is asked to stop.

    Parameters
    ----------
    token
        What has to be shown; empty: nothing on loopback, elsewhere a new one.
    opened
        Called with the address for a browser, and the token where one was made, as soon as it can be asked.

    Raises
    ------
    EndpointError
        Nothing can be served there.
    ImpossibleValue
        The token is too short.
    """
    access = Access.at(host, token)
    config = uvicorn.Config(
        application(site, access),
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        http=LimitedConnection,
        limit_concurrency=MAX_CONNECTIONS,
        timeout_graceful_shutdown=CLOSING_SECONDS,
    )
    server = PageServer(config, site)
    stop.tell(server.end)
    with _listening_socket(host, port) as listener:
        opened(access.address(host, listener.getsockname()[1]))
        asyncio.run(server.serve([listener]))


def _listening_socket(host: str, port: int) -> socket.socket:
    """Where browsers are heard."""
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, port), family=family, backlog=128)
    except OSError as error:
        reason = (error.strerror or str(error)).partition(" (while")[0]
        raise EndpointError(
            f"The page cannot be served at {host}:{port}: {reason}; name another place with --web."
        ) from None


def _error_response(_request: Request, error: Exception) -> Response:
    """Why there is no answer, in a sentence; the name of a file in it may be no text."""
    sentence = str(error).encode(errors="backslashreplace").decode()
    return JSONResponse({"error": sentence}, 404 if isinstance(error, InputError) else 503)
