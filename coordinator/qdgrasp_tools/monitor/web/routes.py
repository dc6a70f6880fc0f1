"""Routes of the two sites: jobs that a monitor watches, and jobs in folders."""

import re
import zlib
from asyncio import CancelledError
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from textwrap import indent

import msgspec
from anyio import CapacityLimiter, to_thread
from msgspec import Struct
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Route

from qdgrasp_coordinator.metrics.job_status import ObjectListing
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.keys import parse_number
from qdgrasp_protocol.text import printable
from qdgrasp_tools.campaign.object_table import count_states, select_objects, with_events
from qdgrasp_tools.monitor.feed import Feed
from qdgrasp_tools.monitor.prometheus import exposition
from qdgrasp_tools.monitor.records import FolderIndex, FolderRecords
from qdgrasp_tools.monitor.web.run_cache import RunCaches, RunDataCaches
from qdgrasp_tools.monitor.web.state_stream import MAX_BROWSERS, Broadcast, EventStream, PageState

PAGES = Path(__file__).with_name("pages")
PART = re.compile(r"^( *)<!-- (parts/\w+\.html) -->\n", re.MULTILINE)
MAX_THREADS = 16  # Threads for answers that may take long; requests that wait for them delay no others
MAX_ROW = (1 << 32) - 1  # The greatest number of a row in a journal
PAGE_ROWS = 50  # Objects on a page
MAX_PICTURE_THREADS = 2  # So that pictures leave room for other answers
PICTURE_CACHING = "private, max-age=300"
JSON = "application/json"


@dataclass(frozen=True)
class Site:
    """A page with its data."""

    routes: list[BaseRoute]
    end: Callable[[], None] = lambda: None  # Called when the server ends, to end streams


class ObjectPage(Struct, frozen=True, kw_only=True):
    """Some objects of a job, as a browser asked for them."""

    objects: list[ObjectListing]
    first: int  # Number of the first of these among the objects found
    found: int  # Objects that the search leaves
    total: int
    states: dict[str, int]  # Number of all objects in each state
    little: int  # Number of all objects that got little
    uncounted: int  # Runs whose rows are still being counted


class JobListing(Struct, frozen=True):
    """A job in a folder."""

    job: str
    folder: str  # Its path, printable
    runs: list[str]  # Names of its runs that were begun


def live_site(feed: Feed, runs: RunCaches) -> Site:
    """Return the site of the jobs in a feed."""
    state, limiter = PageState(feed), CapacityLimiter(MAX_THREADS)
    broadcast = Broadcast(state.state)

    async def stream(request: Request) -> Response:
        if broadcast.watchers >= MAX_BROWSERS:
            return PlainTextResponse("Too many browsers watch already.\n", 503, {"Retry-After": "5"})
        return EventStream(broadcast, packed="gzip" in request.headers.get("accept-encoding", ""))

    async def objects(request: Request) -> Response:
        text = await to_thread.run_sync(_object_page, request, runs, state, limiter=limiter)
        return _json_if_new(request, text)

    def object_runs(request: Request) -> bytes:
        return runs.object_runs(request.path_params["job"], request.query_params.get("file", ""))

    def metrics(_request: Request) -> Response:
        text, kind = exposition(state.views())
        return Response(text, headers={"Content-Type": kind})

    routes = [
        Route("/", lambda _: HTMLResponse(html("index"))),
        Route("/api/state", lambda _: _json(state.state())),
        Route("/api/stream", stream),
        Route("/api/jobs/{job}/curves", lambda request: _json(state.curves(request.path_params["job"]))),
        _slow("/api/jobs/{job}/runs", lambda request: runs.runs(request.path_params["job"]), limiter),
        Route("/api/jobs/{job}/objects", objects),
        _slow("/api/jobs/{job}/objects/runs", object_runs, limiter),
        _picture_route("/api/jobs/{job}/runs/{run}/picture", lambda request: runs.picture(*_run(request))),
        Route("/metrics", metrics),
    ]
    return Site([*routes, *_run_routes(runs, limiter)], broadcast.end)


def _object_page(request: Request, runs: RunCaches, state: PageState) -> bytes:
    """Return a page of a job's objects, searched and sorted as the address says."""
    job, query = request.path_params["job"], request.query_params
    found = runs.objects(job)
    told = found.objects
    for view in state.views():
        if view.job == job:
            told = with_events(told, view.events, view.figures.building)
    shown = select_objects(told, query.get("search", ""), query.get("sort", ""), down="down" in query)
    first = min(parse_number(query.get("from", "")) or 0, max(0, len(shown) - 1) // PAGE_ROWS * PAGE_ROWS)
    page = ObjectPage(
        objects=shown[first : first + PAGE_ROWS],
        first=first,
        found=len(shown),
        total=len(told),
        states=count_states(told),
        little=sum(bool(each.little) for each in told),
        uncounted=found.uncounted,
    )
    return msgspec.json.encode(page)


def _picture_route(path: str, draw: Callable[[Request], bytes]) -> BaseRoute:
    """Return a route of small pictures that are drawn in threads, few at once."""
    limiter = CapacityLimiter(MAX_PICTURE_THREADS)

    async def picture(request: Request) -> Response:
        try:
            payload = await to_thread.run_sync(draw, request, limiter=limiter)
        except CancelledError:  # the server ends while pictures wait for their turn
            return PlainTextResponse("The server has ended.\n", 503)
        return Response(payload, media_type="image/png", headers={"Cache-Control": PICTURE_CACHING})

    return Route(path, picture)


def folder_site(index: FolderIndex) -> Site:
    """Return the site of the jobs in folders."""
    limiter = CapacityLimiter(MAX_THREADS)

    def listings(_request: Request) -> bytes:
        jobs = index.jobs.items()
        found = [JobListing(name, printable(str(job.folder.path)), list(job.runs)) for name, job in jobs]
        return msgspec.json.encode(found)

    page = Route("/", lambda _: HTMLResponse(html("view")))
    runs = _run_routes(RunDataCaches(FolderRecords(index)), limiter)
    return Site([page, _slow("/api/jobs", listings, limiter), *runs])


def html(name: str) -> str:
    """Return the page of that name, with its parts."""

    def read(path: str) -> str:
        return (PAGES / path).read_text(encoding="utf-8")

    return PART.sub(lambda part: indent(read(part[2]), part[1]), read(f"{name}.html"))


def _run_routes(runs: RunDataCaches, limiter: CapacityLimiter) -> list[BaseRoute]:
    """Return the routes of one run's data, which both sites have."""

    def cells(request: Request) -> bytes:
        since = _row(request.query_params.get("from", "")) or 0
        return runs.cells(*_run(request), since, margins="margins" in request.query_params)

    def row(request: Request) -> int:
        found = _row(text := request.path_params["number"])
        if found is None:
            raise InputError(f"'{text[:20]}' is not the number of a row.")
        return found

    def picture(request: Request) -> bytes:
        return runs.grasp_picture(*_run(request), row(request))

    run = "/api/jobs/{job}/runs/{run}"
    return [
        _slow(f"{run}/curve", lambda request: runs.curve(*_run(request)), limiter),
        _slow(f"{run}/scene", lambda request: runs.scene(*_run(request)), limiter),
        _slow(f"{run}/cells", cells, limiter, "application/octet-stream"),
        _slow(f"{run}/grasps/{{number}}", lambda asked: runs.grasp(*_run(asked), row(asked)), limiter),
        _picture_route(f"{run}/grasps/{{number}}/picture", picture),
        _slow(f"{run}/settings", lambda request: runs.settings(*_run(request)), limiter),
    ]


def _slow(
    path: str, query: Callable[[Request], bytes], limiter: CapacityLimiter, media_type: str = JSON
) -> BaseRoute:
    """Return a route whose answer may take long, and is queried in a thread."""

    async def respond(request: Request) -> Response:
        text = await to_thread.run_sync(query, request, limiter=limiter)
        return _json(text) if media_type == JSON else Response(text, media_type=media_type)

    return Route(path, respond)


def _json(text: bytes) -> Response:
    """Return JSON that is not cached."""
    return Response(text, headers={"Cache-Control": "no-store"}, media_type=JSON)


def _json_if_new(request: Request, text: bytes) -> Response:
    """Return JSON with a tag; without content where the browser has it already."""
    tag = f'W/"{zlib.crc32(text):08x}-{len(text)}"'
    headers = {"Cache-Control": "no-cache", "ETag": tag}
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers=headers)
    return Response(text, headers=headers, media_type=JSON)


def _run(request: Request) -> tuple[str, str]:
    return request.path_params["job"], request.path_params["run"]


def _row(text: str) -> int | None:
    """Return the number of a row of a journal; None where the text is not one."""
    found = parse_number(text)
    return found if found is None or found <= MAX_ROW else None
