"""State of the page as JSON, and its stream to all browsers.

The state of all jobs is made twice a second, once for all browsers, and sent as server-sent events. A
browser takes the newest frame whenever it has taken the one before: a slow one misses frames, a stuck one is
dropped, and neither makes anything wait or grow. Without a browser nothing is made. Curves go on request.
"""

import asyncio
import threading
import time
import zlib
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from typing import NamedTuple

import msgspec
from msgspec import Struct
from starlette.responses import StreamingResponse
from starlette.types import Message, Receive, Scope, Send

from qdgrasp_coordinator.metrics.job_status import JobEvent, JobMeta, JobStatus, RunStatus, WorkerStatus
from qdgrasp_protocol.errors import UnknownName
from qdgrasp_tools.monitor.feed import Feed
from qdgrasp_tools.monitor.job_view import JobView

FRESH_SECONDS = 0.2  # seconds for which the views are reused
MOST_WORKERS = 512  # The most workers of a job that are listed, those in trouble first; all are counted
MOST_RUNS = 256  # The most runs of a job that are listed: first those in progress, then the latest heard
URGENCY = ("excluded", "sick", "stuck", "gone", "leaving", "working", "idle")
"""The states of workers, those in trouble first."""


class WorkersState(Struct, frozen=True, kw_only=True):
    """The workers of a job."""

    total: int
    states: dict[str, int]  # Numbers of workers by state
    workers: list[WorkerStatus]  # At most `MOST_WORKERS` of them

    @classmethod
    def of(cls, workers: list[WorkerStatus]) -> "WorkersState":
        """Count workers; of too many, list those in trouble."""
        shown = workers
        if len(workers) > MOST_WORKERS:
            rank = {state: number for number, state in enumerate(URGENCY)}
            shown = sorted(workers, key=lambda worker: rank.get(worker.state, 0))[:MOST_WORKERS]
        states = dict(Counter(worker.state for worker in workers))
        return cls(total=len(workers), states=states, workers=shown)


class JobState(Struct, frozen=True, kw_only=True):
    """A job as it is sent twice a second."""

    job: str
    state: str
    silent: float  # Seconds since the last message of its coordinator
    speed: float  # Latest counted evaluations per second
    left: str  # Time left in words
    obstacle: str  # Cause that keeps it from going on, in words; empty: no obstacle
    meta: JobMeta
    figures: JobStatus
    runs: list[RunStatus]  # In progress, or ended during the watch; at most `MOST_RUNS`
    speeds: dict[str, float]  # Speeds of the runs, by their names
    lefts: dict[str, str]  # Time left of the runs
    team: WorkersState
    events: list[JobEvent]

    @classmethod
    def of(cls, view: JobView) -> "JobState":
        """Select what is sent of a job."""
        runs = view.foremost(MOST_RUNS)
        return cls(
            job=view.job,
            state=view.state,
            silent=view.silent,
            speed=view.history.latest_rate,
            left=view.figures.left,
            obstacle=view.figures.obstacle,
            meta=view.meta,
            figures=view.figures,
            runs=runs,
            speeds={one.run: view.histories[one.run].latest_rate for one in runs},
            lefts={one.run: one.left for one in runs},
            team=WorkersState.of(view.workers),
            events=view.events,
        )


class PageState:
    """JSON of the jobs in a feed; views are reused for `FRESH_SECONDS`."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._lock = threading.Lock()
        self._views: list[JobView] = []
        self._read_at = float("-inf")

    def state(self) -> bytes:
        """Return all jobs as they are now, as JSON in one line: what is sent twice a second."""
        jobs = [JobState.of(view) for view in self.views()]
        link = {"linked": self._feed.is_linked, "foreign_jobs": self._feed.foreign_jobs}
        return msgspec.json.encode({"at": time.time(), **link, "jobs": jobs})

    def curves(self, job: str) -> bytes:
        """Return the figures of a job and its runs over time as JSON, or raise `UnknownName`."""
        views = {view.job: view for view in self.views()}
        if job not in views:
            raise UnknownName("job", job, views)
        view = views[job]
        series = {"history": view.history, "histories": view.histories}
        return msgspec.json.encode({**series, "curves": view.curves})

    def views(self) -> list[JobView]:
        """Return the jobs as they are now, or were a moment ago."""
        with self._lock:
            if time.monotonic() > self._read_at + FRESH_SECONDS:
                self._views, self._read_at = self._feed.views(), time.monotonic()
            return self._views


INTERVAL = 0.5  # seconds between frames
STUCK_SECONDS = 15.0  # seconds after which a browser that takes nothing is dropped
MAX_BROWSERS = 64
GZIP_HEADER = b"\x1f\x8b\x08\x00\x00\x00\x00\x00\x00\xff"
"""Beginning of a gzip stream (RFC 1952); the blocks after it have no end here."""


class EventFrame(NamedTuple):
    """A server-sent event, in bytes."""

    number: int
    plain: bytes
    packed: bytes  # The same in self-contained blocks of DEFLATE, which fit into any gzip stream

    @classmethod
    def of(cls, number: int, state: bytes) -> "EventFrame":
        """Make the event of a state, which is one line."""
        plain = b"id: %d\ndata: %b\n\n" % (number, state)
        packer = zlib.compressobj(5, zlib.DEFLATED, -zlib.MAX_WBITS)
        return cls(number, plain, packer.compress(plain) + packer.flush(zlib.Z_FULL_FLUSH))


class Broadcast:
    """Frames for all browsers, one per interval [s]; `state` is called in a thread."""

    def __init__(self, state: Callable[[], bytes], interval: float = INTERVAL) -> None:
        self.watchers = 0
        self._state = state
        self._interval = interval
        self._frame: EventFrame | None = None
        self._is_new = asyncio.Event()
        self._maker: asyncio.Task[None] | None = None
        self._is_over = False

    async def frames(self) -> AsyncIterator[EventFrame]:
        """Yield frames from now on, until the broadcast is over; always the newest."""
        self.watchers += 1
        try:
            last = 0
            if not self._maker:  # the present frame was made for earlier browsers
                last = self._frame.number if self._frame else 0
                self._maker = asyncio.create_task(self._make(last))
            while not self._is_over:
                if self._frame and self._frame.number > last:
                    last = self._frame.number
                    yield self._frame
                else:
                    await self._is_new.wait()
        finally:
            self.watchers -= 1

    def end(self) -> None:
        """End all streams."""
        self._is_over = True
        self._is_new.set()

    async def _make(self, number: int) -> None:
        try:
            while self.watchers and not self._is_over:
                number += 1
                self._frame = EventFrame.of(number, await asyncio.to_thread(self._state))
                self._is_new.set()
                self._is_new = asyncio.Event()
                await asyncio.sleep(self._interval)
        finally:
            self._maker = None


class EventStream(StreamingResponse):
    """Response to a browser that watches: server-sent events without an end."""

    media_type = "text/event-stream"

    def __init__(self, broadcast: Broadcast, packed: bool) -> None:
        headers = {"Cache-Control": "no-store", "Vary": "Accept-Encoding", "X-Accel-Buffering": "no"}
        if packed:
            headers["Content-Encoding"] = "gzip"
        super().__init__(_body(broadcast, packed), headers=headers)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send frames until the browser is gone, or stuck."""

        async def send_in_time(message: Message) -> None:
            async with asyncio.timeout(STUCK_SECONDS):
                await send(message)

        with suppress(TimeoutError):
            await super().__call__(scope, receive, send_in_time)


async def _body(broadcast: Broadcast, packed: bool) -> AsyncIterator[bytes]:
    yield GZIP_HEADER if packed else b"retry: 1000\n\n"
    async for frame in broadcast.frames():
        yield frame.packed if packed else frame.plain
