"""HTTP server of a page: a few addresses to read from, and nothing to write to.

A connection without a request soon is closed, and so are too many from one address.
"""

import asyncio
import socket
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Mount
from starlette.staticfiles import StaticFiles
from uvicorn.protocols.http.h11_impl import H11Protocol

from qdgrasp_protocol.errors import EndpointError, InputError, QdgraspError
from qdgrasp_protocol.process import Stop
from qdgrasp_tools.monitor.web.access import Access, guard
from qdgrasp_tools.monitor.web.routes import Site

STATIC = Path(__file__).with_name("static")
FIRST_REQUEST_SECONDS = 10.0  # A connection may take so long to send its first request [s]
CLOSING_SECONDS = 1  # Answers under way may take so long when the server ends [s]
MAX_CONNECTIONS = 512  # Further ones are asked to try again
MAX_CONNECTIONS_PER_ADDRESS = 256  # Half of all, so that one client does not shut out the others


class LimitedConnection(H11Protocol):
    """A connection that is closed where no request comes, or too many are from its address."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as in H11Protocol: over TCP
        """Begin; of too many from one address the newest ends."""
        super().connection_made(transport)
        others = [one for one in self.connections if isinstance(one, LimitedConnection) and one is not self]
        addresses = [one.client[0] for one in others if one.client]
        if addresses.count(self.client[0] if self.client else "") >= MAX_CONNECTIONS_PER_ADDRESS:
            transport.abort()
        else:
            self._deadline = self.loop.call_later(FIRST_REQUEST_SECONDS, self.close_if_idle)

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        super().connection_lost(exc)
        if self._deadline:
            self._deadline.cancel()

    def close_if_idle(self) -> None:
        """Close the connection, unless there was a request."""
        if self.cycle is None:
            self.transport.close()


class PageServer(uvicorn.Server):
    """A server that leaves signals to this process, and ends the site's streams when it ends."""

    def __init__(self, config: uvicorn.Config, site: Site) -> None:
        super().__init__(config)
        self._site = site

    def capture_signals(self) -> nullcontext[None]:  # type: ignore[override]  # any with-block does
        """Capture none."""
        return nullcontext()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the streams first."""
        self._site.end()
        await super().shutdown(sockets)


def application(site: Site, access: Access) -> Starlette:
    """Make a site an ASGI application."""
    return Starlette(
        routes=[*site.routes, Mount("/static", StaticFiles(directory=STATIC))],
        middleware=[
            Middleware(guard, access=access),
            Middleware(GZipMiddleware, minimum_size=1024, compresslevel=5),
        ],
        exception_handlers={QdgraspError: _error_response},
    )


def serve(site: Site, host: str, port: int, token: str, stop: Stop, opened: Callable[[str], object]) -> None:
    """Serve a site until this process is asked to stop.

    Browsers must send `token`; without one there is none on loopback, elsewhere a new one. As soon as the
    server listens, `opened` is called with the address for a browser, which includes a new token. An address
    that cannot be used raises `EndpointError`, a token that is too short `ImpossibleValue`.
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
    stop.tell(lambda: setattr(server, "should_exit", True))
    with _listening_socket(host, port) as listener:
        opened(access.address(host, listener.getsockname()[1]))
        asyncio.run(server.serve([listener]))


def _listening_socket(host: str, port: int) -> socket.socket:
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, port), family=family, backlog=128)
    except OSError as error:
        reason = (error.strerror or str(error)).partition(" (while")[0]
        raise EndpointError(
            f"The page cannot be served at {host}:{port}: {reason}; name another place with --web."
        ) from None


def _error_response(_request: Request, error: Exception) -> Response:
    """Answer with the sentence of an error; the name of a file in it may be no text."""
    sentence = str(error).encode(errors="backslashreplace").decode()
    return JSONResponse({"error": sentence}, 404 if isinstance(error, InputError) else 503)
