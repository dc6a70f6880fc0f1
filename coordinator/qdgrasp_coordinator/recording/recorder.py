"""The recorder on the bus: takes settled rows, commits them in groups, and says what is durable.

One thread does everything but fetching scenes; callbacks of the bus and the fetcher only fill its inbox. What
to do with what comes is decided in `Scribe`, and carried out here.
"""

import secrets
import time
from concurrent.futures import Future
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from queue import Empty, SimpleQueue

import structlog

from qdgrasp_coordinator.recording.books import Books
from qdgrasp_coordinator.recording.fetcher import Fetched, Fetcher
from qdgrasp_coordinator.recording.librarian import Librarian
from qdgrasp_coordinator.recording.scribe import Scribe
from qdgrasp_protocol import codec
from qdgrasp_protocol.bus import Bus, Channel, Query, Sample
from qdgrasp_protocol.errors import DiskFull, NoReply, Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.messages import Recorded

log = structlog.get_logger()

FETCH_INTERVAL = 1.0  # seconds between two tries to fetch scenes
ANSWER_PATIENCE = 10.0  # seconds that a query waits for its turn
MOST = 256  # events between two looks at what is due
REST = 60.0  # seconds after which there is a look in any case


@dataclass(frozen=True)
class Question:
    """A query that waits for its answer."""

    query: Query
    answer: Future[bytes] = field(default_factory=Future)


Event = Sample | Question | Fetched | None
"""What reaches the recorder's one thread; None: look at the signals."""


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
        self._inbox: SimpleQueue[Event] = SimpleQueue()
        self._fetcher = Fetcher(bus, job, self._inbox.put)
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
            self._books = stack.enter_context(Books(self._path, self._job))
            self._scribe = Scribe(self._books, self._job, self._path, self._disk_wait, time.monotonic())
            stack.enter_context(self._bus.subscribe(self._keys.outcome(), self._inbox.put))
            stack.enter_context(self._bus.answer(self._keys.open, self._ask))
            stack.enter_context(self._bus.answer(self._keys.log, self._ask))
            stack.enter_context(Librarian(self._bus, self._job, self._path))
            stack.enter_context(self._bus.token(self._keys.recorder_token(secrets.token_hex(8))))
            log.info("recording", job=self._job, folder=str(self._path))
            while not self._stop.is_set:
                self._step()
            self._hear(0.0)
            self._report(self._scribe.close(time.monotonic()))

    def _step(self) -> None:
        """Hear what came, then do what is due."""
        now = time.monotonic()
        self._hear(max(0.0, min(self._scribe.deadline, self._next_fetch, now + REST) - now))
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
            for _ in range(MOST):
                self._take(self._inbox.get_nowait(), time.monotonic())
        except Empty:
            return

    def _take(self, event: Event, now: float) -> None:
        match event:
            case Question():
                self._answer(event, now)
            case Sample():
                self._scribe.take(event, now)
                self._fetch_at = 0.0  # whoever sends rows shows their scene, and may soon be gone
            case Fetched(digest, payload):
                self._store(digest, payload)

    def _ask(self, query: Query) -> bytes:
        """In a thread of the bus: hand the query over and wait for its answer."""
        question = Question(query)
        self._inbox.put(question)
        try:
            return question.answer.result(ANSWER_PATIENCE)
        except TimeoutError:
            raise NoReply("the recorder is busy") from None

    def _answer(self, question: Question, now: float) -> None:
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
        encoding = codec.encoding(Recorded)
        for report in reports:
            self._bus.put(
                self._keys.recorded, codec.encode(report), encoding=encoding, channel=Channel.CONTROL
            )

    def _fetch_scenes(self, now: float) -> None:
        """Fetch the bundles of runs that were begun without, once the coordinator shows them."""
        self._fetch_at = now + FETCH_INTERVAL
        self._fetcher.begin(self._books.missing_scenes)

    def _store(self, digest: str, payload: bytes) -> None:
        with suppress(DiskFull):  # it is fetched again soon
            self._books.add_scene(digest, payload)
