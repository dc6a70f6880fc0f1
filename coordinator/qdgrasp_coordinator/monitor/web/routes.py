"""Routes of the two sites: jobs that a monitor watches, and jobs in folders."""

import re
from collections.abc import Callable
from pathlib import Path
from textwrap import indent
from typing import Protocol

import msgspec
from anyio import CapacityLimiter, to_thread
from msgspec import Struct
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Route

from qdgrasp_coordinator.monitor.job_view import JobFeed
from qdgrasp_coordinator.monitor.prometheus import exposition
from qdgrasp_coordinator.monitor.records import FolderIndex, FolderRecords
from qdgrasp_coordinator.monitor.web.run_cache import RunCaches
from qdgrasp_coordinator.monitor.web.state_stream import MAX_BROWSERS, Broadcast, EventStream, PageState
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.keys import parse_number
from qdgrasp_protocol.text import printable

PAGES = Path(__file__).with_name("pages")
PART = re.compile(r"^( *)<!-- (parts/\w+\.html) -->\n", re.MULTILINE)
MAX_THREADS = 16  # Threads that query the library; requests that wait for them delay no others
MAX_ROW = (1 << 32) - 1  # The greatest number of a row in a journal


def html(name: str) -> str:
    """Return the page of that name, with its parts."""

    def read(path: str) -> str:
        return (PAGES / path).read_text(encoding="utf-8")

    return PART.sub(lambda part: indent(read(part[2]), part[1]), read(f"{name}.html"))


class RunLibrary(Protocol):
    """Data of runs as the page reads it. Its methods may take a while, and are called in threads.

    Raises
    ------
    QdgraspError
        From any method: there is no such job, run or grasp, or no answer.
    """

    def runs(self, job: str) -> bytes:
        """Return the runs of a job, finished ones too: JSON of `RunListings`."""

    def curve(self, job: str, run: str) -> bytes:
        """Return the curve of a run, also of one that is over: JSON of `GrowthCurve`."""

    def scene(self, job: str, run: str) -> bytes:
        """Return the object, the hand's links and the bounds of a run: JSON of `BrowserScene`."""

    def cells(self, job: str, run: str, since: int) -> bytes:
        """Return the voxels of a run with the serial `since` or a later one, packed as `scene_data` says."""

    def grasp(self, job: str, run: str, number: int) -> bytes:
        """Return the success with this journal number: JSON of `GraspView`."""


class RunRoutes:
    """Routes of the data of runs, which both sites have."""

    def __init__(self, library: RunLibrary) -> None:
        self._library = library
        self._limiter = CapacityLimiter(MAX_THREADS)

    def routes(self) -> list[BaseRoute]:
        """Return the routes."""
        run = "/api/jobs/{job}/runs/{run}"
        return [
            Route(f"{run}/curve", self._curve),
            Route(f"{run}/scene", self._scene),
            Route(f"{run}/cells", self._cells),
            Route(f"{run}/grasps/{{number}}", self._grasp),
        ]

    async def query(self, work: Callable[[], bytes]) -> bytes:
        """Return the result of a function that may take long, called in a thread."""
        return await to_thread.run_sync(work, limiter=self._limiter)

    async def _curve(self, request: Request) -> Response:
        return json_response(await self.query(lambda: self._library.curve(*_run(request))))

    async def _scene(self, request: Request) -> Response:
        return json_response(await self.query(lambda: self._library.scene(*_run(request))))

    async def _cells(self, request: Request) -> Response:
        since = _row(request.query_params.get("from", "")) or 0
        packed = await self.query(lambda: self._library.cells(*_run(request), since))
        return Response(packed, media_type="application/octet-stream")

    async def _grasp(self, request: Request) -> Response:
        row = _row(text := request.path_params["number"])
        if row is None:
            raise InputError(f"'{text[:20]}' is not the number of a row.")
        return json_response(await self.query(lambda: self._library.grasp(*_run(request), row)))


def json_response(text: bytes) -> Response:
    """Return JSON that is not cached."""
    return Response(text, headers={"Cache-Control": "no-store"}, media_type="application/json")


def _run(request: Request) -> tuple[str, str]:
    """Return the job and the run in the path."""
    return request.path_params["job"], request.path_params["run"]


def _row(text: str) -> int | None:
    """Return the number of a row of a journal; None where the text is none."""
    found = parse_number(text)
    return found if found is None or found <= MAX_ROW else None


class LiveSite:
    """Site of the jobs in a feed; data of their runs comes from a library."""

    def __init__(self, feed: JobFeed, library: RunLibrary) -> None:
        self._state = PageState(feed)
        self._library = library
        self._runs = RunRoutes(library)
        self._broadcast = Broadcast(self._state.state)

    def routes(self) -> list[BaseRoute]:
        """Return the routes."""
        return [
            Route("/", lambda _: HTMLResponse(html("index"))),
            Route("/api/state", lambda _: json_response(self._state.state())),
            Route("/api/stream", self._stream),
            Route("/api/jobs/{job}/curves", self._curves),
            Route("/api/jobs/{job}/runs", self._listings),
            Route("/metrics", self._metrics),
            *self._runs.routes(),
        ]

    def end(self) -> None:
        """End the streams to browsers."""
        self._broadcast.end()

    async def _stream(self, request: Request) -> Response:
        if self._broadcast.watchers >= MAX_BROWSERS:
            return PlainTextResponse("Too many browsers watch already.\n", 503, {"Retry-After": "5"})
        return EventStream(self._broadcast, packed="gzip" in request.headers.get("accept-encoding", ""))

    def _curves(self, request: Request) -> Response:
        return json_response(self._state.curves(request.path_params["job"]))

    async def _listings(self, request: Request) -> Response:
        return json_response(await self._runs.query(lambda: self._library.runs(request.path_params["job"])))

    def _metrics(self, request: Request) -> Response:
        text, kind = exposition(self._state.views())
        return Response(text, headers={"Content-Type": kind})


class JobListing(Struct, frozen=True):
    """A job of a `FolderSite`."""

    job: str
    folder: str
    """Its path, printable."""
    runs: list[str]
    """Names of its runs that were begun."""


class FolderSite:
    """Site of the jobs in folders."""

    def __init__(self, index: FolderIndex) -> None:
        self._index = index
        self._runs = RunRoutes(RunCaches(FolderRecords(index)))

    def routes(self) -> list[BaseRoute]:
        """Return the routes."""
        page = Route("/", lambda _: HTMLResponse(html("view")))
        return [page, Route("/api/jobs", self._jobs), *self._runs.routes()]

    def end(self) -> None:
        """Do nothing: there are no streams."""

    async def _jobs(self, request: Request) -> Response:
        return json_response(await self._runs.query(self._listings))

    def _listings(self) -> bytes:
        jobs = self._index.jobs.items()
        listings = [JobListing(name, printable(str(job.folder.path)), list(job.runs)) for name, job in jobs]
        return msgspec.json.encode(listings)
