"""Routes of the page: of jobs that go on, and of jobs whose folders are at hand."""

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

from qdgrasp_coordinator.monitor.records import FolderIndex, FolderRecords
from qdgrasp_coordinator.monitor.web.event_stream import Broadcast, EventStream
from qdgrasp_coordinator.monitor.web.page_state import PageFeed, PageState
from qdgrasp_coordinator.monitor.web.run_cache import RunCaches
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.keys import parse_number
from qdgrasp_protocol.text import printable

PAGES = Path(__file__).with_name("pages")
PART = re.compile(r"^( *)<!-- (parts/\w+\.html) -->\n", re.MULTILINE)


def html(name: str) -> str:
    """The page of that name, with its parts."""
    return PART.sub(lambda part: indent(_text(part[2]), part[1]), _text(f"{name}.html"))


def _text(name: str) -> str:
    return (PAGES / name).read_text(encoding="utf-8")


class RunLibrary(Protocol):
    """Scenes and finds of runs, as the page's view in 3D reads them.

    Its methods may take a while, and are called in threads.
    """

    def runs(self, job: str) -> bytes:
        """JSON: the runs of a job, finished ones too (`RunListings`).

        Raises
        ------
        QdgraspError
            There is no such job, or nobody answers.
        """

    def curve(self, job: str, run: str) -> bytes:
        """JSON: how a run grew, also one that is over (`Curve`).

        Raises
        ------
        QdgraspError
            There is no such run, or nobody answers.
        """

    def scene(self, job: str, run: str) -> bytes:
        """JSON: the object, the hand's links and the bounds of a run.

        Raises
        ------
        QdgraspError
            There is no such run, or nobody answers.
        """

    def cells(self, job: str, run: str, since: int) -> bytes:
        """The voxels of a run with the serial `since` or a later one, packed as `voxels` says.

        Raises
        ------
        QdgraspError
            There is no such run, or nobody answers.
        """

    def grasp(self, job: str, run: str, number: int) -> bytes:
        """JSON: all that is known of the find with this journal number.

        Raises
        ------
        QdgraspError
            There is no such run or find, or nobody answers.
        """


MAX_THREADS = 16  # So many threads ask the library; what waits for them keeps nothing else waiting
MAX_ROW = (1 << 32) - 1  # The last number that a row of a journal may have


class RunRoutes:
    """What a library knows of runs."""

    def __init__(self, library: RunLibrary) -> None:
        self._library = library
        self._askers = CapacityLimiter(MAX_THREADS)

    def routes(self) -> list[BaseRoute]:
        """What is answered where."""
        run = "/api/jobs/{job}/runs/{run}"
        return [
            Route(f"{run}/curve", self.curve),
            Route(f"{run}/scene", self.scene),
            Route(f"{run}/cells", self.cells),
            Route(f"{run}/grasps/{{number}}", self.grasp),
        ]

    async def curve(self, request: Request) -> Response:
        """How a run grew that was over before anybody watched."""
        return json_response(await self.asked(lambda: self._library.curve(*_run(request))))

    async def scene(self, request: Request) -> Response:
        """What stands in the view in 3D."""
        return json_response(await self.asked(lambda: self._library.scene(*_run(request))))

    async def cells(self, request: Request) -> Response:
        """The cells of the view in 3D."""
        since = _row(request.query_params.get("from", "")) or 0
        packed = await self.asked(lambda: self._library.cells(*_run(request), since))
        return Response(packed, media_type="application/octet-stream")

    async def grasp(self, request: Request) -> Response:
        """One find."""
        row = _row(text := request.path_params["number"])
        if row is None:
            raise InputError(f"'{text[:20]}' is not the number of a row.")
        return json_response(await self.asked(lambda: self._library.grasp(*_run(request), row)))

    async def asked(self, question: Callable[[], bytes]) -> bytes:
        """What the library answers, in a thread of those that may take long."""
        return await to_thread.run_sync(question, limiter=self._askers)


def html_page(name: str) -> Response:
    """A page itself."""
    return HTMLResponse(html(name))


def json_response(text: bytes) -> Response:
    """JSON that holds for now alone."""
    return Response(text, headers={"Cache-Control": "no-store"}, media_type="application/json")


def _run(request: Request) -> tuple[str, str]:
    """The job and the run that are asked for."""
    return request.path_params["job"], request.path_params["run"]


def _row(text: str) -> int | None:
    """The number of a row of a journal; None where the text is none."""
    found = parse_number(text)
    return found if found is None or found <= MAX_ROW else None


class LiveSite:
    """A `Site`.

    Parameters
    ----------
    feed
        Knows the jobs.
    library
        Knows their runs.
    """

    def __init__(self, feed: PageFeed, library: RunLibrary) -> None:
        self._shown = PageState(feed)
        self._library = library
        self._runs = RunRoutes(library)
        self._broadcast = Broadcast(self._shown.state)

    def routes(self) -> list[BaseRoute]:
        """What is answered where."""
        return [
            Route("/", self.page),
            Route("/api/state", self.state),
            Route("/api/stream", self.stream),
            Route("/api/jobs/{job}/curves", self.curves),
            Route("/api/jobs/{job}/runs", self.runs),
            Route("/metrics", self.metrics),
            *self._runs.routes(),
        ]

    def end(self) -> None:
        """Let all who watch go."""
        self._broadcast.end()

    def page(self, request: Request) -> Response:
        """The page itself."""
        return html_page("index")

    def state(self, request: Request) -> Response:
        """What the stream tells, once."""
        return json_response(self._shown.state())

    async def stream(self, request: Request) -> Response:
        """What there is to see, twice a second."""
        if self._broadcast.is_full:
            return PlainTextResponse("Too many browsers watch already.\n", 503, {"Retry-After": "5"})
        return EventStream(self._broadcast, packed="gzip" in request.headers.get("accept-encoding", ""))

    def curves(self, request: Request) -> Response:
        """The curves of one job."""
        return json_response(self._shown.curves(request.path_params["job"]))

    async def runs(self, request: Request) -> Response:
        """The runs of one job, finished ones too."""
        return json_response(await self._runs.asked(lambda: self._library.runs(request.path_params["job"])))

    def metrics(self, request: Request) -> Response:
        """What Prometheus asks for."""
        text, kind = self._shown.metrics()
        return Response(text, headers={"Content-Type": kind})


class JobListing(Struct, frozen=True):
    """A job of a collection."""

    job: str
    """Its name there."""
    folder: str
    """Its path, to be read by a person."""
    runs: list[str]
    """The names of its runs that were begun."""


class FolderSite:
    """A `Site`."""

    def __init__(self, collection: FolderIndex) -> None:
        self._collection = collection
        self._runs = RunRoutes(RunCaches(FolderRecords(collection)))

    def routes(self) -> list[BaseRoute]:
        """What is answered where."""
        return [Route("/", self.page), Route("/api/jobs", self.jobs), *self._runs.routes()]

    def end(self) -> None:
        """Nobody waits for anything."""

    def page(self, request: Request) -> Response:
        """The page itself."""
        return html_page("view")

    async def jobs(self, request: Request) -> Response:
        """All jobs (`JobListing`), and which runs they have now."""
        return json_response(await self._runs.asked(self._listed))

    def _listed(self) -> bytes:
        return msgspec.json.encode([
            JobListing(name, printable(str(one.folder.path)), list(one.runs))
            for name, one in self._collection.jobs.items()
        ])  # fmt: skip
