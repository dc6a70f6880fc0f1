"""Routes of the two pages: jobs that a monitor watches, and jobs in folders.

The state of all jobs is encoded at most twice a second, for all browsers together, and sent as server-sent
events. Its history is sent on request.
"""

import asyncio
import re
import threading
import time
from asyncio import CancelledError
from collections import Counter
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from textwrap import indent

import msgspec
from anyio import CapacityLimiter, to_thread
from sse_starlette import EventSourceResponse
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Route

from qdgrasp_protocol.errors import InputError, UnknownName
from qdgrasp_protocol.keys import parse_number
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.text import printable
from qdgrasp_tools.campaign.summaries import count_states, select_objects, with_events
from qdgrasp_tools.monitor.feed import Feed
from qdgrasp_tools.monitor.job_model import MOST_WORKERS, JobView
from qdgrasp_tools.monitor.prometheus import exposition
from qdgrasp_tools.monitor.records import FolderIndex, FolderRecords
from qdgrasp_tools.monitor.web.run_cache import JobCaches, RunCache, RunCaches

PAGES = Path(__file__).with_name("pages")
PART = re.compile(r"^( *)<!-- (parts/\w+\.html) -->\n", re.MULTILINE)
MAX_THREADS = 16  # Threads for answers that may take long; requests that wait for them delay no others
MAX_ROW = (1 << 32) - 1  # The greatest number of a row in a journal
PAGE_ROWS = 50  # Objects on a page
MAX_PICTURE_THREADS = 2  # So that pictures leave room for other answers
PICTURE_CACHING = "private, max-age=300"
JSON = "application/json"
STATE_SECONDS = 0.5  # Between two states that a browser gets [s]
STUCK_SECONDS = 15.0  # A browser that takes nothing for so long is dropped [s]
MAX_BROWSERS = 64


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
        self._lock = threading.Lock()
        self._text = b""
        self._encoded_at = float("-inf")
        self.browsers = 0

    def state(self) -> bytes:
        """Return all jobs as they are now, or were a moment ago, as JSON in one line."""
        with self._lock:
            if time.monotonic() > self._encoded_at + STATE_SECONDS / 2:
                jobs = [job_state(view) for view in self.views()]
                link = {"linked": self._feed.is_linked, "foreign_jobs": self._feed.foreign_jobs}
                self._text = msgspec.json.encode({"at": time.time(), **link, "jobs": jobs})
                self._encoded_at = time.monotonic()
            return self._text

    def history(self, job: str) -> bytes:
        """Return the figures of a job over time as JSON, or raise `UnknownName`."""
        views = {view.job: view for view in self.views()}
        if job not in views:
            raise UnknownName("job", job, views)
        return msgspec.json.encode(views[job].history)

    def views(self) -> list[JobView]:
        """Return the jobs as they are now."""
        return self._feed.views()

    async def events(self, stop: Stop) -> AsyncIterator[dict[str, str]]:
        """Yield the state again and again until this process is asked to stop."""
        self.browsers += 1
        try:
            while not stop.is_set:
                yield {"data": (await to_thread.run_sync(self.state)).decode()}
                await asyncio.sleep(STATE_SECONDS)
        finally:
            self.browsers -= 1


def live_routes(feed: Feed, caches: JobCaches, stop: Stop) -> list[BaseRoute]:
    """Return the routes of the page of the jobs in a feed."""
    state, limiter = PageState(feed), CapacityLimiter(MAX_THREADS)

    async def stream(_request: Request) -> Response:
        if state.browsers >= MAX_BROWSERS:
            return PlainTextResponse("Too many browsers watch already.\n", 503, {"Retry-After": "5"})
        return EventSourceResponse(state.events(stop), sep="\n", ping=0, send_timeout=STUCK_SECONDS)

    def object_runs(request: Request) -> bytes:
        return caches.object_runs(request.path_params["job"], request.query_params.get("file", ""))

    def curve(request: Request) -> bytes:
        return caches.curve(request.path_params["job"], request.path_params["run"])

    def picture(request: Request) -> bytes:
        return caches.object_picture(request.path_params["job"], request.path_params["run"])

    def metrics(_request: Request) -> Response:
        text, kind = exposition(state.views())
        return Response(text, headers={"Content-Type": kind})

    return [
        Route("/", lambda _: HTMLResponse(html("index"))),
        Route("/api/state", lambda _: _json(state.state())),
        Route("/api/stream", stream),
        Route("/api/jobs/{job}/history", lambda request: _json(state.history(request.path_params["job"]))),
        _slow("/api/jobs/{job}/runs", lambda request: caches.runs(request.path_params["job"]), limiter),
        _slow("/api/jobs/{job}/objects", lambda request: _object_page(request, caches, state), limiter),
        _slow("/api/jobs/{job}/objects/runs", object_runs, limiter),
        _slow("/api/jobs/{job}/runs/{run}/curve", curve, limiter),
        _picture_route("/api/jobs/{job}/runs/{run}/picture", picture),
        Route("/metrics", metrics),
        *_run_routes(caches, limiter),
    ]


def _object_page(request: Request, caches: JobCaches, state: PageState) -> bytes:
    """Return a page of a job's objects, searched and sorted as the address says."""
    job, query = request.path_params["job"], request.query_params
    found = caches.objects(job)
    told = found.objects
    for view in state.views():
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
    runs = _run_routes(RunCaches(FolderRecords(index)), limiter)
    return [page, _slow("/api/jobs", listings, limiter), *runs]


def html(name: str) -> str:
    """Return the page of that name, with its parts."""

    def read(path: str) -> str:
        return (PAGES / path).read_text(encoding="utf-8")

    return PART.sub(lambda part: indent(read(part[2]), part[1]), read(f"{name}.html"))


def _run_routes(caches: RunCaches, limiter: CapacityLimiter) -> list[BaseRoute]:
    """Return the routes of one run's data, which both pages have."""

    def run(request: Request) -> RunCache:
        return caches.run(request.path_params["job"], request.path_params["run"])

    def cells(request: Request) -> bytes:
        since = _row(request.query_params.get("from", "")) or 0
        return run(request).cells(since)

    def row(request: Request) -> int:
        found = _row(text := request.path_params["number"])
        if found is None:
            raise InputError(f"'{text[:20]}' is not the number of a row.")
        return found

    path = "/api/jobs/{job}/runs/{run}"
    return [
        _slow(f"{path}/scene", lambda request: run(request).scene(), limiter),
        _slow(f"{path}/cells", cells, limiter, "application/octet-stream"),
        _slow(f"{path}/grasps/{{number}}", lambda request: run(request).grasp(row(request)), limiter),
        _picture_route(f"{path}/grasps/{{number}}/picture", lambda asked: run(asked).picture(row(asked))),
        _slow(f"{path}/settings", lambda request: run(request).settings(), limiter),
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


def _row(text: str) -> int | None:
    """Return the number of a row of a journal; None where the text is not one."""
    found = parse_number(text)
    return found if found is None or found <= MAX_ROW else None
