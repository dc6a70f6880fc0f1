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
from pathlib import Path
from queue import Empty, SimpleQueue

import structlog

from qdgrasp_coordinator.intake import Verdict
from qdgrasp_coordinator.ledger import Ledger
from qdgrasp_coordinator.stretch import to_message
from qdgrasp_protocol import chunks, codec
from qdgrasp_protocol.bus import Bus, Channel, Query, Sample
from qdgrasp_protocol.errors import BusError, DiskFull, InputError, MessageError, NoReply, Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.messages import Log, Open, Opened, Platform, Recordable, Recorded, short

log = structlog.get_logger()

REPORT_INTERVAL = 1.0  # seconds between two reports when nothing happens
RETRY_INTERVAL = 1.0  # seconds between two tries on a full disk
ANSWER_PATIENCE = 10.0  # seconds that a query waits for its turn
MOST = 256  # events between two looks at what is due
PAGE_ITEMS = 1 << 18  # numbers in the widest column of a page: 1 MB, the most that a message may have


@dataclass(frozen=True)
class Question:
    """A query that waits for its answer."""

    query: Query
    answer: Future[bytes] = field(default_factory=Future)


class RecorderService:
    """Records the run of a job until it is asked to stop.

    Parameters
    ----------
    bus
        An open session.
    job
        The job's name.
    path
        The run's folder; begun where there is none.
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
        self._inbox: SimpleQueue[Sample | Question | None] = SimpleQueue()
        self._untaken: Counter[Verdict] = Counter()
        self._full_since: float | None = None
        self._trouble = ""
        self._try_at = 0.0
        self._report_at = 0.0

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
            self._ledger = stack.enter_context(Ledger(self._path, self._job))
            stack.enter_context(self._bus.subscribe(self._keys.outcome(), self._inbox.put))
            stack.enter_context(self._bus.answer(self._keys.open, self._ask))
            stack.enter_context(self._bus.answer(self._keys.log, self._ask))
            stack.enter_context(self._bus.token(self._keys.recorder_token(secrets.token_hex(8))))
            log.info("recording", job=self._job, folder=str(self._path))
            while not self._stop.is_set:
                self._step()
            self._hear(0.0)
            with suppress(DiskFull):
                self._ledger.commit()
            self._report(time.monotonic())

    def _step(self) -> None:
        """Hear what came, then do what is due."""
        now = time.monotonic()
        self._hear(max(0.0, min(self._commit_at, self._report_at) - now))
        now = time.monotonic()
        if now >= self._commit_at:
            self._commit(now)
        if now >= self._report_at:
            self._report(now)
            self._fetch_scene()

    @property
    def _commit_at(self) -> float:
        return max(self._ledger.intake.deadline, self._try_at)

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
                    self._take_platform(codec.decode(event.payload, Platform))
        except (MessageError, Refused) as error:
            log.warning("dropped a message", reason=str(error))

    def _take_rows(self, message: Recordable) -> None:
        verdict = self._ledger.take(message, time.monotonic())
        if verdict is not Verdict.TAKEN:
            self._untaken[verdict] += message.n
            self._report_at = 0.0

    def _take_platform(self, message: Platform) -> None:
        if message.epoch >= self._ledger.intake.epoch:
            self._ledger.set_platform(message.platform)

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
            self._wait_for_room(full, time.monotonic())
        except (InputError, MessageError, Refused) as error:
            question.answer.set_exception(Refused(str(error)))

    def _open(self, payload: bytes) -> bytes:
        asked = codec.decode(payload, Open)
        if asked.job != self._job or len(asked.runs) != 1:
            raise Refused(f"this recorder keeps one run of job '{self._job}'")
        epoch = self._ledger.open(asked.runs[0])
        self._full_since, self._trouble, self._try_at = None, "", 0.0
        journal = self._ledger.journal
        log.info("opened", run=journal.run, epoch=epoch, rows=journal.count)
        return codec.encode(Opened(epoch=epoch, durable=[journal.count], platform=journal.platform))

    def _page(self, payload: bytes) -> bytes:
        asked = codec.decode(payload, Log)
        journal = self._ledger.journal
        if asked.run != journal.run:
            raise Refused(f"no run '{asked.run}' is recorded here, only '{journal.run}'")
        shape = journal.shape
        limit = min(asked.limit, PAGE_ITEMS // max(shape.genes, shape.joints, shape.descriptors, 7))
        page = self._ledger.page(asked.first, limit)
        return codec.encode(to_message(page, journal.run, self._ledger.intake.epoch, shape))

    def _commit(self, now: float) -> None:
        try:
            self._ledger.commit()
        except DiskFull as full:
            self._wait_for_room(full, now)
            return
        if self._trouble:
            log.info("there is room again", folder=str(self._path))
        self._full_since, self._trouble, self._try_at = None, "", 0.0
        self._report_at = 0.0

    def _wait_for_room(self, full: DiskFull, now: float) -> None:
        """Say that the disk is full, and try again soon; give up when it was full for too long."""
        if self._full_since is None:
            self._full_since = now
            log.warning("the disk is full; trying again until there is room", reason=str(full))
        elif now - self._full_since > self._disk_wait:
            raise DiskFull(
                f"{self._path} has had no room for {self._disk_wait:g} s; "
                f"make room, then `qdgrasp resume {self._path}` goes on."
            )
        self._trouble = short(str(full))
        self._try_at, self._report_at = now + RETRY_INTERVAL, 0.0

    def _report(self, now: float) -> None:
        """Tell the coordinator what is durable."""
        self._report_at = now + REPORT_INTERVAL
        for verdict, rows in self._untaken.items():
            log.info("rows not taken", reason=verdict.value, rows=rows)
        self._untaken.clear()
        if not self._ledger.is_open:
            return
        intake, run = self._ledger.intake, self._ledger.journal.run
        message = Recorded(epoch=intake.epoch, run=run, durable=intake.durable, trouble=self._trouble)
        self._bus.put(
            self._keys.recorded,
            codec.encode(message),
            encoding=codec.encoding(Recorded),
            channel=Channel.CONTROL,
        )

    def _fetch_scene(self) -> None:
        """Fetch the scene's bundle where the run was begun without it, once the coordinator shows it."""
        digest = self._ledger.missing_scene
        if digest is None:
            return
        try:
            self._ledger.add_scene(chunks.fetch(self._bus, self._job, digest))
        except (BusError, DiskFull, MessageError):
            return  # the next report tries again
