"""The recorder on the bus: takes settled rows, commits them in groups, and says what is durable.

One thread does everything; callbacks of the bus only fill its inbox.
"""

import secrets
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from queue import Empty, SimpleQueue

import structlog

from qdgrasp_coordinator.books import Books
from qdgrasp_coordinator.intake import Verdict
from qdgrasp_coordinator.job_folder import JobFolder
from qdgrasp_coordinator.reports import Reports
from qdgrasp_coordinator.room import Room
from qdgrasp_protocol import chunks, codec
from qdgrasp_protocol.bus import Bus, Channel, Query, Sample
from qdgrasp_protocol.errors import BusError, DiskFull, InputError, MessageError, NoReply, Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.messages import Log, Open, Platform, Recordable, Recorded, short

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
        self._inbox: SimpleQueue[Sample | Question | None] = SimpleQueue()
        self._untaken: Counter[Verdict] = Counter()
        self._reports = Reports()
        self._room = Room(path, disk_wait)
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
            stack.enter_context(self._bus.subscribe(self._keys.outcome(), self._inbox.put))
            stack.enter_context(self._bus.answer(self._keys.open, self._ask))
            stack.enter_context(self._bus.answer(self._keys.log, self._ask))
            stack.enter_context(self._bus.token(self._keys.recorder_token(secrets.token_hex(8))))
            log.info("recording", job=self._job, folder=str(self._path))
            self._watch(self._books.runs)
            while not self._stop.is_set:
                self._step()
            self._hear(0.0)
            with suppress(DiskFull):
                self._commit_due(inf)
            self._report(time.monotonic())

    def _step(self) -> None:
        """Hear what came, then do what is due."""
        now = time.monotonic()
        self._hear(max(0.0, min(self._commit_at, self._reports.deadline, self._next_fetch, now + REST) - now))
        now = time.monotonic()
        if now >= self._commit_at:
            self._commit(now)
        self._report(now)
        if now >= self._next_fetch:
            self._fetch_scenes(now)

    @property
    def _commit_at(self) -> float:
        return max(self._books.deadline, self._room.try_at)

    @property
    def _next_fetch(self) -> float:
        return self._fetch_at if self._books.missing_scenes else inf

    def _hear(self, patience: float) -> None:
        """Take what is in the inbox, waiting at most `patience` seconds for the first."""
        try:
            self._take(self._inbox.get(timeout=patience))
            for _ in range(MOST):
                self._take(self._inbox.get_nowait())
        except Empty:
            return

    def _take(self, event: Sample | Question | None) -> None:
        try:
            match event:
                case Question(query):
                    self._answer(event, self._open if query.key == self._keys.open else self._page)
                case Sample(encoding=kind) if kind == codec.encoding(Recordable):
                    self._take_rows(codec.decode(event.payload, Recordable))
                case Sample(encoding=kind) if kind == codec.encoding(Platform):
                    self._books.set_platform(codec.decode(event.payload, Platform))
        except (MessageError, Refused) as error:
            log.warning("dropped a message", reason=str(error))
        except DiskFull as full:
            self._wait_for_room(full, time.monotonic())

    def _take_rows(self, message: Recordable) -> None:
        now = time.monotonic()
        verdict = self._books.take(message, now)
        if verdict is Verdict.TAKEN:
            self._reports.heard(message.run, now)
        else:
            self._untaken[verdict] += message.n
            self._reports.news(message.run, now)

    def _ask(self, query: Query) -> bytes:
        """In a thread of the bus: hand the query over and wait for its answer."""
        question = Question(query)
        self._inbox.put(question)
        try:
            return question.answer.result(ANSWER_PATIENCE)
        except TimeoutError:
            raise NoReply("the recorder is busy") from None

    def _answer(self, question: Question, act: Callable[[bytes], bytes]) -> None:
        """Answer a query with what `act` makes of it; on a full disk not at all: it will be asked again."""
        try:
            question.answer.set_result(act(question.query.payload))
        except DiskFull as full:
            question.answer.set_exception(NoReply(str(full)))
            raise
        except (InputError, MessageError, Refused) as error:
            question.answer.set_exception(Refused(str(error)))

    def _open(self, payload: bytes) -> bytes:
        asked = codec.decode(payload, Open)
        opened = self._books.open(asked)
        self._have_room()
        self._watch([run.run for run in asked.runs])
        for run, rows in zip(asked.runs, opened.durable, strict=True):
            log.info("opened", run=run.run, epoch=opened.epoch, rows=rows)
        return codec.encode(opened)

    def _watch(self, runs: list[str]) -> None:
        """Report runs for a while, and fetch their scenes where they are missing."""
        for run in runs:
            self._reports.heard(run, time.monotonic())
        self._fetch_at = 0.0

    def _page(self, payload: bytes) -> bytes:
        return codec.encode(self._books.page(codec.decode(payload, Log)))

    def _commit(self, now: float) -> None:
        try:
            self._commit_due(now)
        except DiskFull as full:
            self._wait_for_room(full, now)
        else:
            self._have_room()

    def _commit_due(self, now: float) -> None:
        for run in self._books.due(now):
            self._books.commit(run)
            self._reports.news(run, now)

    def _wait_for_room(self, full: DiskFull, now: float) -> None:
        """Say that the disk is full, and try again soon; give up when it was full for too long."""
        if not self._room.trouble:
            log.warning("the disk is full; trying again until there is room", reason=str(full))
        self._room.missed(short(str(full)), now, JobFolder(self._path).resume_command)
        for run in self._books.due(inf):
            self._reports.news(run, now)

    def _have_room(self) -> None:
        if self._room.trouble:
            log.info("there is room again", folder=str(self._path))
            self._reports.repeat(time.monotonic())
        self._room.found()

    def _report(self, now: float) -> None:
        """Tell the coordinator what is durable."""
        for run in self._reports.due(now):
            durable, trouble = self._books.durable(run), self._room.trouble
            self._put(Recorded(epoch=self._books.epoch, run=run, durable=durable, trouble=trouble))
        for verdict, rows in self._untaken.items():
            log.info("rows not taken", reason=verdict.value, rows=rows)
        self._untaken.clear()

    def _put(self, report: Recorded) -> None:
        encoding = codec.encoding(Recorded)
        self._bus.put(self._keys.recorded, codec.encode(report), encoding=encoding, channel=Channel.CONTROL)

    def _fetch_scenes(self, now: float) -> None:
        """Fetch the bundles of runs that were begun without, once the coordinator shows them."""
        self._fetch_at = now + FETCH_INTERVAL
        for digest in self._books.missing_scenes:
            try:
                self._books.add_scene(digest, chunks.fetch(self._bus, self._job, digest))
            except (MessageError, Refused):
                continue  # the coordinator is not there for this run now
            except (BusError, DiskFull):
                return  # the next try is soon
