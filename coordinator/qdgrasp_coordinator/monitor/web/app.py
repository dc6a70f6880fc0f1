"""The server of the page: a few addresses to read from, and nothing to write to."""

import asyncio
import socket
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import structlog
import uvicorn
from anyio import CapacityLimiter, to_thread
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles

from qdgrasp_coordinator.monitor.web.access import Access, Guard
from qdgrasp_coordinator.monitor.web.broadcast import Broadcast, EventStream
from qdgrasp_coordinator.monitor.web.libraries import Library
from qdgrasp_coordinator.monitor.web.showing import Showing, Watched
from qdgrasp_coordinator.monitor.web.visit import Visit
from qdgrasp_protocol.errors import EndpointError, InputError, QdgraspError
from qdgrasp_protocol.keys import number
from qdgrasp_protocol.lifetime import Stop

log = structlog.get_logger()
STATIC = Path(__file__).with_name("static")
CLOSING = 1  # seconds that answers under way may take when the server ends
CONNECTIONS = 512
"""So many at a time; whoever comes then is asked to try again."""
ASKERS = 16
"""So many threads ask the library; what waits for them keeps nothing else waiting."""
HIGHEST = (1 << 32) - 1
"""The last number that a row of a journal may have."""


class Pages:
    """The answers of the server."""

    def __init__(self, shown: Showing, library: Library, broadcast: Broadcast) -> None:
        self._shown = shown
        self._library = library
        self._broadcast = broadcast
        self._askers = CapacityLimiter(ASKERS)

    def routes(self) -> list[BaseRoute]:
        """What is answered where."""
        run = "/api/jobs/{job}/runs/{run}"
        return [
            Route("/", self.page),
            Route("/api/state", self.state),
            Route("/api/stream", self.stream),
            Route("/api/jobs/{job}/curves", self.curves),
            Route("/api/jobs/{job}/runs", self.runs),
            Route(f"{run}/scene", self.scene),
            Route(f"{run}/cells", self.cells),
            Route(f"{run}/grasps/{{number}}", self.grasp),
            Route("/metrics", self.metrics),
            Mount("/static", StaticFiles(directory=STATIC)),
        ]

    def page(self, request: Request) -> Response:
        """The page itself."""
        return FileResponse(STATIC / "index.html")

    def state(self, request: Request) -> Response:
        """What the stream tells, once."""
        return _json(self._shown.state())

    async def stream(self, request: Request) -> Response:
        """What there is to see, twice a second."""
        if self._broadcast.is_full:
            return PlainTextResponse("Too many browsers watch already.\n", 503, {"Retry-After": "5"})
        return EventStream(self._broadcast, packed="gzip" in request.headers.get("accept-encoding", ""))

    def curves(self, request: Request) -> Response:
        """The curves of one job."""
        return _json(self._shown.curves(request.path_params["job"]))

    async def runs(self, request: Request) -> Response:
        """The runs of one job, finished ones too."""
        return _json(await self._asked(lambda: self._library.runs(request.path_params["job"])))

    async def scene(self, request: Request) -> Response:
        """What stands in the view in 3D."""
        return _json(await self._asked(lambda: self._library.scene(*_run(request))))

    async def cells(self, request: Request) -> Response:
        """The cells of the view in 3D."""
        since = _row(request.query_params.get("from", "")) or 0
        packed = await self._asked(lambda: self._library.cells(*_run(request), since))
        return Response(packed, media_type="application/octet-stream")

    async def grasp(self, request: Request) -> Response:
        """One find."""
        row = _row(text := request.path_params["number"])
        if row is None:
            raise InputError(f"'{text[:20]}' is not the number of a row.")
        return _json(await self._asked(lambda: self._library.grasp(*_run(request), row)))

    def metrics(self, request: Request) -> Response:
        """What Prometheus asks for."""
        text, kind = self._shown.metrics()
        return Response(text, headers={"Content-Type": kind})

    async def _asked(self, question: Callable[[], bytes]) -> bytes:
        """What the library answers, in a thread of those that may take long."""
        return await to_thread.run_sync(question, limiter=self._askers)


class Server(uvicorn.Server):
    """A server that leaves signals to this process, and lets those who watch go when it ends."""

    def __init__(self, config: uvicorn.Config, broadcast: Broadcast) -> None:
        super().__init__(config)
        self._broadcast = broadcast

    def capture_signals(self) -> nullcontext[None]:  # type: ignore[override]
        """Leave them."""
        return nullcontext()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End."""
        self._broadcast.end()
        await super().shutdown(sockets)

    def end(self) -> None:
        """Have it end soon; may be called by a signal's handler."""
        self.should_exit = True


def application(shown: Showing, library: Library, access: Access, broadcast: Broadcast) -> Starlette:
    """The server as an ASGI application."""
    return Starlette(
        routes=Pages(shown, library, broadcast).routes(),
        middleware=[
            Middleware(Guard, access=access),
            Middleware(GZipMiddleware, minimum_size=1024, compresslevel=5),
        ],
        exception_handlers={QdgraspError: _sorry},
    )


def serve(feed: Watched, library: Library, host: str, port: int, token: str, stop: Stop) -> None:
    """Serve the page until this process is asked to stop; says where it is, and with which token.

    Raises
    ------
    EndpointError
        Nothing can be served there.
    ImpossibleValue
        The token is too short.
    """
    shown, access = Showing(feed), Access.at(host, token)
    broadcast = Broadcast(shown.state)
    config = uvicorn.Config(
        application(shown, library, access, broadcast),
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        http=Visit,
        limit_concurrency=CONNECTIONS,
        timeout_graceful_shutdown=CLOSING,
    )
    server = Server(config, broadcast)
    stop.tell(server.end)
    with _listener(host, port) as listener:
        log.info("the page is open", address=access.address(host, listener.getsockname()[1]))
        asyncio.run(server.serve([listener]))


def _listener(host: str, port: int) -> socket.socket:
    """Where browsers are heard."""
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, port), family=family, backlog=128)
    except OSError as error:
        reason = (error.strerror or str(error)).partition(" (while")[0]
        raise EndpointError(
            f"The page cannot be served at {host}:{port}: {reason}; name another place with --web."
        ) from None


def _run(request: Request) -> tuple[str, str]:
    """The job and the run that are asked for."""
    return request.path_params["job"], request.path_params["run"]


def _row(text: str) -> int | None:
    """The number of a row of a journal; None where the text is none."""
    found = number(text)
    return found if found is None or found <= HIGHEST else None


def _json(text: bytes) -> Response:
    return Response(text, headers={"Cache-Control": "no-store"}, media_type="application/json")


def _sorry(_request: Request, error: Exception) -> Response:
    """Why there is no answer, in a sentence."""
    return JSONResponse({"error": str(error)}, 404 if isinstance(error, InputError) else 503)
