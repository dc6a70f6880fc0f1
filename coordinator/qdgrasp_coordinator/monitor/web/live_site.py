"""The site of jobs that go on: what is heard of them, told to all browsers twice a second, and their runs."""

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Route

from qdgrasp_coordinator.monitor.web.broadcast import Broadcast, EventStream
from qdgrasp_coordinator.monitor.web.libraries import Library
from qdgrasp_coordinator.monitor.web.run_pages import RunPages, json_of, page
from qdgrasp_coordinator.monitor.web.showing import Showing, Watched


class LiveSite:
    """A `Site`.

    Parameters
    ----------
    feed
        Knows the jobs.
    library
        Knows their runs.
    """

    def __init__(self, feed: Watched, library: Library) -> None:
        self._shown = Showing(feed)
        self._library = library
        self._runs = RunPages(library)
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
        return page("index")

    def state(self, request: Request) -> Response:
        """What the stream tells, once."""
        return json_of(self._shown.state())

    async def stream(self, request: Request) -> Response:
        """What there is to see, twice a second."""
        if self._broadcast.is_full:
            return PlainTextResponse("Too many browsers watch already.\n", 503, {"Retry-After": "5"})
        return EventStream(self._broadcast, packed="gzip" in request.headers.get("accept-encoding", ""))

    def curves(self, request: Request) -> Response:
        """The curves of one job."""
        return json_of(self._shown.curves(request.path_params["job"]))

    async def runs(self, request: Request) -> Response:
        """The runs of one job, finished ones too."""
        return json_of(await self._runs.asked(lambda: self._library.runs(request.path_params["job"])))

    def metrics(self, request: Request) -> Response:
        """What Prometheus asks for."""
        text, kind = self._shown.metrics()
        return Response(text, headers={"Content-Type": kind})
