"""The recorder on the bus: takes settled rows, commits them, and reports what is durable.

One thread does everything but fetching scenes; callbacks of the bus and the fetcher only fill its inbox.
What to do with what comes is decided in `Recorder`, and carried out here.
"""

import secrets
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from queue import Empty, SimpleQueue

import structlog

from qdgrasp_coordinator.recorder.queries import QueryServer
from qdgrasp_coordinator.recorder.recorder import Recorder
from qdgrasp_coordinator.recorder.run_store import RunStore
from qdgrasp_protocol import bundle_transfer, messages
from qdgrasp_protocol.bus import Bus, Channel, Query, Sample
from qdgrasp_protocol.errors import BusError, DiskFull, MessageError, NoReply, Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Recorded
from qdgrasp_protocol.process import Stop


@dataclass(frozen=True)
class FetchedScene:
    """A fetched scene."""

    digest: str
    payload: bytes


class SceneFetcher:
    """Fetches scene bundles, one after the other.

    Parameters
    ----------
    tell
        Takes each of them; called in the fetcher's thread.
    """

    def __init__(self, bus: Bus, job: str, tell: Callable[[FetchedScene], None]) -> None:
        self._bus = bus
        self._job = job
        self._tell = tell
        self._thread: threading.Thread | None = None

    def begin(self, digests: Iterable[str]) -> None:
        """Ask for scenes, unless some are being asked for."""
        if self._thread is None or not self._thread.is_alive():
            self._thread = threading.Thread(
                target=self._fetch, args=(list(digests),), name="fetcher", daemon=True
            )
            self._thread.start()

    def _fetch(self, digests: list[str]) -> None:
        for digest in digests:
            try:
                self._tell(FetchedScene(digest, bundle_transfer.fetch_bundle(self._bus, self._job, digest)))
            except (MessageError, Refused):
                continue  # the coordinator is not there for this run now
            except BusError:
                return  # the next try is soon


log = structlog.get_logger()

FETCH_INTERVAL = 1.0  # seconds between two tries to fetch scenes
ANSWER_TIMEOUT = 10.0  # seconds that a query waits for its turn
MOST_EVENTS = 256  # events between two looks at what is due
LONGEST_WAIT = 60.0  # seconds after which there is a look in any case


@dataclass(frozen=True)
class PendingQuery:
    """A query that waits for its answer."""

    query: Query
    answer: Future[bytes] = field(default_factory=Future)


RecorderEvent = Sample | PendingQuery | FetchedScene | None
"""Input of the recorder's one thread; None: check for signals."""


class RecorderService:
    """Records the runs of a job until it is asked to stop.

    Parameters
    ----------
    bus
        An open session.
    job
        The job's name.
    path
        The job's folder; begun where there is none.
    disk_wait
        How long a full disk is waited for [s].
    """

    def __init__(self, bus: Bus, stop: Stop, *, job: str, path: Path, disk_wait: float = 60.0) -> None:
        self._bus = bus
        self._stop = stop
        self._job = job
        self._keys = Keys(job)
        self._path = path
        self._disk_wait = disk_wait
        self._inbox: SimpleQueue[RecorderEvent] = SimpleQueue()
        self._fetcher = SceneFetcher(bus, job, self._inbox.put)
        self._fetch_at = 0.0

    def run(self) -> None:
        """Record until asked to stop.

        Raises
        ------
        FolderError
            The folder cannot be used: another job's, in use, or other files are in it.
        DiskFull
            The disk was full for too long; nothing is lost that was reported durable.
        """
        self._stop.tell(lambda: self._inbox.put(None))
        with ExitStack() as stack:
            self._books = stack.enter_context(RunStore(self._path, self._job))
            self._scribe = Recorder(self._books, self._job, self._path, self._disk_wait, time.monotonic())
            stack.enter_context(self._bus.subscribe(self._keys.outcome(), self._inbox.put))
            stack.enter_context(self._bus.answer(self._keys.open, self._ask))
            stack.enter_context(self._bus.answer(self._keys.log, self._ask))
            stack.enter_context(QueryServer(self._bus, self._job, self._path))
            stack.enter_context(self._bus.token(self._keys.recorder_token(secrets.token_hex(8))))
            log.info("recording", job=self._job, folder=str(self._path))
            while not self._stop.is_set:
                self._step()
            self._hear(0.0)
            self._report(self._scribe.close(time.monotonic()))

    def _step(self) -> None:
        """Process what came, then do what is due."""
        now = time.monotonic()
        self._hear(max(0.0, min(self._scribe.deadline, self._next_fetch, now + LONGEST_WAIT) - now))
        now = time.monotonic()
        self._report(self._scribe.step(now))
        if now >= self._next_fetch:
            self._fetch_scenes(now)

    @property
    def _next_fetch(self) -> float:
        return self._fetch_at if self._books.missing_scenes else inf

    def _hear(self, patience: float) -> None:
        """Take what is in the inbox, waiting at most `patience` seconds for the first."""
        try:
            self._take(self._inbox.get(timeout=patience), time.monotonic())
            for _ in range(MOST_EVENTS):
                self._take(self._inbox.get_nowait(), time.monotonic())
        except Empty:
            return

    def _take(self, event: RecorderEvent, now: float) -> None:
        match event:
            case PendingQuery():
                self._answer(event, now)
            case Sample():
                self._scribe.take(event, now)
                self._fetch_at = 0.0  # whoever sends rows shows their scene, and may soon be gone
            case FetchedScene(digest, payload):
                self._store(digest, payload)

    def _ask(self, query: Query) -> bytes:
        """In a thread of the bus: hand the query over and wait for its answer."""
        question = PendingQuery(query)
        self._inbox.put(question)
        try:
            return question.answer.result(ANSWER_TIMEOUT)
        except TimeoutError:
            raise NoReply("the recorder is busy") from None

    def _answer(self, question: PendingQuery, now: float) -> None:
        """Answer a query; a full disk that is waited for no longer ends this process."""
        try:
            question.answer.set_result(self._scribe.answer(question.query, now))
        except DiskFull as full:
            question.answer.set_exception(NoReply(str(full)))
            raise
        except (NoReply, Refused) as reason:
            question.answer.set_exception(reason)
        if question.query.key == self._keys.open:
            self._fetch_at = 0.0

    def _report(self, reports: list[Recorded]) -> None:
        """Tell the coordinator what is durable."""
        encoding = messages.encoding(Recorded)
        for report in reports:
            self._bus.put(
                self._keys.recorded, messages.encode(report), encoding=encoding, channel=Channel.CONTROL
            )

    def _fetch_scenes(self, now: float) -> None:
        """Start to fetch the scene bundles that runs still lack."""
        self._fetch_at = now + FETCH_INTERVAL
        self._fetcher.begin(self._books.missing_scenes)

    def _store(self, digest: str, payload: bytes) -> None:
        with suppress(DiskFull):  # it is fetched again soon
            self._books.add_scene(digest, payload)
