"""Server of the two pages: jobs that a monitor watches, and jobs in folders.

The pages are read-only, open on this machine, with a token from elsewhere. The state of all jobs is encoded
at most twice a second, for all browsers together, and sent as server-sent events.
"""

import asyncio
import hmac
import re
import secrets
import socket
import time
from asyncio import CancelledError
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import nullcontext
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from textwrap import indent
from urllib.parse import quote, urlsplit

import msgspec
import uvicorn
from anyio import CapacityLimiter, to_thread
from sse_starlette import EventSourceResponse
from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from qdgrasp_protocol.errors import EndpointError, ImpossibleValue, InputError, QdgraspError, UnknownName
from qdgrasp_protocol.keys import parse_number
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.text import printable
from qdgrasp_tools.campaign.summaries import count_states, select_objects, with_events
from qdgrasp_tools.monitor.feed import Feed
from qdgrasp_tools.monitor.job_model import MOST_WORKERS, JobView
from qdgrasp_tools.monitor.prometheus import exposition
from qdgrasp_tools.monitor.records import FolderIndex, FolderRecords
from qdgrasp_tools.monitor.web.run_cache import JobCaches, RunCache, TtlCache, run_caches

PAGES = Path(__file__).with_name("pages")
PART = re.compile(r"^( *)<!-- (parts/\w+\.html) -->\n", re.MULTILINE)
MAX_THREADS = 16  # Threads for answers that may take long; requests that wait for them delay no others
MAX_ROW = (1 << 32) - 1  # The greatest number of a row in a journal
PAGE_ROWS = 50  # Objects on a page
MAX_PICTURE_THREADS = 2  # So that pictures leave room for other answers
JSON, PNG = "application/json", "image/png"
CACHING = {PNG: "private, max-age=300"}
STATE_SECONDS = 0.5  # Between two states that a browser gets [s]
STUCK_SECONDS = 15.0  # A browser that takes nothing for so long is dropped [s]


def job_state(view: JobView) -> dict[str, object]:
    """Return a job as it is sent twice a second."""
    return {
        "job": view.job,
        "state": view.state,
        "silent": view.silent,  # Seconds since the last message of its coordinator
        "speed": view.history.latest_rate,  # Latest counted evaluations per second
        "left": view.figures.left,  # Time left in words
        "obstacle": view.figures.obstacle,  # Cause that keeps it from continuing, in words
        "meta": view.meta,
        "figures": view.figures,
        "runs": view.runs,  # In progress, or ended during the watch
        "lefts": {one.run: one.left for one in view.runs},
        "team": {
            "states": Counter(worker.state for worker in view.workers),
            "workers": view.workers[:MOST_WORKERS],
        },
        "events": view.events,
    }


class PageState:
    """The jobs in a feed, encoded once for all browsers."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self.state = TtlCache(self._encode, lambda _: STATE_SECONDS / 2).get
        """Returns all jobs as they are now, or were a moment ago, as JSON in one line."""

    def _encode(self, _before: bytes | None) -> bytes:
        jobs = [job_state(view) for view in self._feed.views()]
        return msgspec.json.encode({"at": time.time(), "linked": self._feed.is_linked, "jobs": jobs})

    def history(self, job: str) -> bytes:
        """Return the figures of a job over time as JSON, or raise `UnknownName`."""
        views = {view.job: view for view in self._feed.views()}
        if job not in views:
            raise UnknownName("job", job, views)
        return msgspec.json.encode(views[job].history)

    async def events(self, stop: Stop) -> AsyncIterator[dict[str, str]]:
        """Yield the state again and again until this process is asked to stop."""
        while not stop.is_set:
            yield {"data": (await to_thread.run_sync(self.state)).decode()}
            await asyncio.sleep(STATE_SECONDS)


def live_routes(feed: Feed, caches: JobCaches, stop: Stop) -> list[BaseRoute]:
    """Return the routes of the page of the jobs in a feed."""
    state, limiter = PageState(feed), CapacityLimiter(MAX_THREADS)

    async def stream(_request: Request) -> Response:
        return EventSourceResponse(state.events(stop), sep="\n", ping=0, send_timeout=STUCK_SECONDS)

    def object_runs(request: Request) -> bytes:
        return caches.object_runs(request.path_params["job"], request.query_params.get("file", ""))

    def curve(request: Request) -> bytes:
        return caches.curve(request.path_params["job"], request.path_params["run"])

    def metrics(_request: Request) -> Response:
        text, kind = exposition(feed.views())
        return Response(text, headers={"Content-Type": kind})

    return [
        Route("/", lambda _: HTMLResponse(html("index"))),
        Route("/api/state", lambda _: _answer(state.state())),
        Route("/api/stream", stream),
        Route("/api/jobs/{job}/history", lambda request: _answer(state.history(request.path_params["job"]))),
        _slow("/api/jobs/{job}/runs", lambda request: caches.runs(request.path_params["job"]), limiter),
        _slow("/api/jobs/{job}/objects", lambda request: _object_page(request, caches, feed), limiter),
        _slow("/api/jobs/{job}/objects/runs", object_runs, limiter),
        _slow("/api/jobs/{job}/runs/{run}/curve", curve, limiter),
        Route("/metrics", metrics),
        *_run_routes(caches.run, limiter),
    ]


def _object_page(request: Request, caches: JobCaches, feed: Feed) -> bytes:
    """Return a page of a job's objects, searched and sorted as the address says."""
    job, query = request.path_params["job"], request.query_params
    found = caches.objects(job)
    told = found.objects
    for view in feed.views():
        if view.job == job:
            told = with_events(told, view.events, view.figures.building)
    shown = select_objects(told, query.get("search", ""), query.get("sort", ""), down="down" in query)
    first = min(parse_number(query.get("from", "")) or 0, max(0, len(shown) - 1) // PAGE_ROWS * PAGE_ROWS)
    page = {
        "objects": shown[first : first + PAGE_ROWS],
        "first": first,
        "found": len(shown),
        "total": len(told),
        "states": count_states(told),
        "little": sum(bool(each.little) for each in told),
        "uncounted": found.uncounted,  # Runs whose rows are still being counted
    }
    return msgspec.json.encode(page)


def folder_routes(index: FolderIndex) -> list[BaseRoute]:
    """Return the routes of the page of the jobs in folders."""
    limiter = CapacityLimiter(MAX_THREADS)

    def listings(_request: Request) -> bytes:
        jobs = index.jobs.items()
        found = [
            {"job": name, "folder": printable(str(job.folder.path)), "runs": list(job.runs)}
            for name, job in jobs
        ]
        return msgspec.json.encode(found)

    page = Route("/", lambda _: HTMLResponse(html("view")))
    runs = _run_routes(run_caches(FolderRecords(index)), limiter)
    return [page, _slow("/api/jobs", listings, limiter), *runs]


def html(name: str) -> str:
    """Return the page of that name, with its parts."""

    def read(path: str) -> str:
        return (PAGES / path).read_text(encoding="utf-8")

    return PART.sub(lambda part: indent(read(part[2]), part[1]), read(f"{name}.html"))


def _run_routes(caches: Callable[[str, str], RunCache], limiter: CapacityLimiter) -> list[BaseRoute]:
    """Return the routes of one run's data, which both pages have."""

    def run(request: Request) -> RunCache:
        return caches(request.path_params["job"], request.path_params["run"])

    def cells(request: Request) -> bytes:
        since = _row(request.query_params.get("from", "")) or 0
        return run(request).cells(since)

    def row(request: Request) -> int:
        found = _row(text := request.path_params["number"])
        if found is None:
            raise InputError(f"'{text[:20]}' is not the number of a row.")
        return found

    path, pictures = "/api/jobs/{job}/runs/{run}", CapacityLimiter(MAX_PICTURE_THREADS)
    return [
        _slow(f"{path}/scene", lambda request: run(request).scene(), limiter),
        _slow(f"{path}/cells", cells, limiter, "application/octet-stream"),
        _slow(f"{path}/grasps/{{number}}", lambda request: run(request).grasp(row(request)), limiter),
        _slow(f"{path}/grasps/{{number}}/picture", lambda one: run(one).picture(row(one)), pictures, PNG),
    ]


def _slow(
    path: str, query: Callable[[Request], bytes], limiter: CapacityLimiter, kind: str = JSON
) -> BaseRoute:
    """Return a route whose answer may take long, and is queried in a thread."""

    async def respond(request: Request) -> Response:
        try:
            return _answer(await to_thread.run_sync(query, request, limiter=limiter), kind)
        except CancelledError:  # the server ends while requests wait for their turn
            return PlainTextResponse("The server has ended.\n", 503)

    return Route(path, respond)


def _answer(payload: bytes, kind: str = JSON) -> Response:
    """Return an answer of a media type; pictures alone may be cached."""
    return Response(payload, headers={"Cache-Control": CACHING.get(kind, "no-store")}, media_type=kind)


def _row(text: str) -> int | None:
    """Return the number of a row of a journal; None where the text is not one."""
    found = parse_number(text)
    return found if found is None or found <= MAX_ROW else None


STATIC = Path(__file__).with_name("static")
CLOSING_SECONDS = 1  # Answers in progress may take so long when the server ends [s]
MAX_REQUESTS = 512  # Further ones at the same time are answered 503
COOKIE = "qdgrasp-monitor"
TOKEN = re.compile(r"[!-~]{16,}")
WILDCARD_HOSTS = ("", "::", "0.0.0.0")  # noqa: S104  # it is only compared with
SECURITY_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
"""Headers of every answer: nothing is loaded from elsewhere, and no page embeds this one."""


@dataclass(frozen=True)
class Access:
    """Rules for the requests to a page."""

    local: bool
    """True on loopback: only requests under a name of this machine are answered.

    Otherwise a page elsewhere could read it through a name that resolves to this machine (DNS rebinding).
    """
    token: str = ""  # Token that a request must have; empty: none
    is_generated: bool = False  # True for a new token, which the user must see

    @classmethod
    def at(cls, host: str, token: str = "") -> "Access":
        """Return the rules of a page served at `host`: beyond loopback there is always a token.

        One that is too short, or of characters that no header may have, raises `ImpossibleValue`.
        """
        if token and not TOKEN.fullmatch(token):
            expected = "at least 16 characters of ASCII without spaces"
            raise ImpossibleValue("the token", "*" * len(token), expected)
        is_generated = not (token or is_loopback(host))
        return cls(is_loopback(host), secrets.token_urlsafe(24) if is_generated else token, is_generated)

    def address(self, host: str, port: int) -> str:
        """Return the address for a browser, with the token where it is a new one."""
        named = socket.gethostname() if host in WILDCARD_HOSTS else f"[{host}]" if ":" in host else host
        return f"http://{named}:{port}/" + (f"?token={quote(self.token)}" if self.is_generated else "")

    def refusal(self, request: Request) -> Response | None:
        """Return the answer to a request that is refused; None where it is allowed."""
        if request.method not in ("GET", "HEAD"):
            return PlainTextResponse("This page is read only.\n", 405, {"Allow": "GET, HEAD"})
        if self.local and not is_loopback(_hostname(request.headers.get("host", ""))):
            return PlainTextResponse("This page is served under the name localhost only.\n", 421)
        port = request.headers.get("host", "").rpartition(":")[2]  # one host's ports share its cookies
        cookie = f"{COOKIE}-{port}" if port.isdecimal() else COOKIE
        bearer = request.headers.get("authorization", "").removeprefix("Bearer ")
        if not self.token:
            return None
        if self._is_valid(bearer) or self._is_valid(request.cookies.get(cookie, "")):
            return None
        if request.url.path == "/" and self._is_valid(request.query_params.get("token", "")):
            entered = RedirectResponse("/", 303)
            entered.set_cookie(cookie, self.token, httponly=True, samesite="lax")
            return entered
        headers = {"WWW-Authenticate": "Bearer", "Cache-Control": "no-store"}
        return PlainTextResponse("A token is needed: open the page as /?token=TOKEN.\n", 401, headers)

    def _is_valid(self, token: str) -> bool:
        return hmac.compare_digest(token.encode(), self.token.encode())


def guard(app: ASGIApp, access: Access) -> ASGIApp:
    """Make an application refuse requests by the rules, and add the security headers."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.update(SECURITY_HEADERS)
                headers.setdefault("Cache-Control", "no-cache")
            await send(message)

        await (access.refusal(Request(scope)) or app)(scope, receive, send_guarded)

    return answer


def is_loopback(host: str) -> bool:
    """Return whether a name or address can only be this machine."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def _hostname(host: str) -> str:
    """Return the name in a Host header, without its port; empty where it is not valid."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


class PageServer(uvicorn.Server):
    """A server that leaves signals to this process."""

    def capture_signals(self) -> nullcontext[None]:  # type: ignore[override]  # any with-block does
        """Capture none."""
        return nullcontext()


def application(routes: list[BaseRoute], access: Access) -> Starlette:
    """Return the ASGI application of a page."""
    return Starlette(
        routes=[*routes, Mount("/static", StaticFiles(directory=STATIC))],
        middleware=[
            Middleware(guard, access=access),
            Middleware(GZipMiddleware, minimum_size=1024, compresslevel=5),
        ],
        exception_handlers={QdgraspError: _error_response},
    )


def serve(
    routes: list[BaseRoute], host: str, port: int, token: str, stop: Stop, opened: Callable[[str], object]
) -> None:
    """Serve a page until this process is asked to stop.

    Browsers must send `token`; without one there is none on loopback, elsewhere a new one. As soon as the
    server listens, `opened` is called with the address for a browser, which includes a new token. An address
    that cannot be used raises `EndpointError`, a token that is too short `ImpossibleValue`.
    """
    access = Access.at(host, token)
    config = uvicorn.Config(
        application(routes, access),
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        limit_concurrency=MAX_REQUESTS,
        timeout_graceful_shutdown=CLOSING_SECONDS,
    )
    server = PageServer(config)
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
