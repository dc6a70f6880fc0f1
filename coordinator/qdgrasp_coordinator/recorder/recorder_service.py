"""The recorder on the bus: takes settled rows, commits them, and reports what is durable.

One thread does everything but fetching scenes; callbacks of the bus and the fetcher only fill its inbox.
`Recorder` decides on each event; its decisions are carried out here.
"""

import secrets
import threading
import time
from concurrent.futures import Future
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from queue import Empty, SimpleQueue

import structlog

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.recorder.recorder import OPEN_JOURNALS, Recorder
from qdgrasp_coordinator.storage.journal_writer import OpenJournals
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus, Channel, Query, Sample, fetch_bundle
from qdgrasp_protocol.errors import BusError, DiskFull, MessageError, NoReply, Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Recorded
from qdgrasp_protocol.process import Stop

log = structlog.get_logger()

FETCH_INTERVAL = 1.0  # seconds between two tries to fetch scenes
ANSWER_TIMEOUT = 10.0  # seconds that a query waits for its answer
MOST_EVENTS = 256  # events between two checks of what is due
LONGEST_WAIT = 60.0  # seconds after which what is due is checked in any case


@dataclass(frozen=True)
class PendingQuery:
    """A query that waits for its answer."""

    query: Query
    answer: Future[bytes] = field(default_factory=Future)


RecorderEvent = Sample | PendingQuery | Bundle | None
"""Input of the recorder's one thread; None: check for signals."""


class RecorderService:
    """Records the runs of a job until it is asked to stop; begins its folder if it is missing.

    A full disk is waited for `disk_wait` seconds.
    """

    def __init__(self, bus: Bus, stop: Stop, *, job: str, path: Path, disk_wait: float = 60.0) -> None:
        self._bus = bus
        self._stop = stop
        self._job = job
        self._keys = Keys(job)
        self._path = path
        self._disk_wait = disk_wait
        self._inbox: SimpleQueue[RecorderEvent] = SimpleQueue()
        self._fetcher: threading.Thread | None = None
        self._fetch_at = 0.0

    def run(self) -> None:
        """Record until asked to stop.

        Raises `FolderError` where the folder is another job's, in use, or holds other files, and `DiskFull`
        where the disk was full for too long; nothing is lost that was reported durable.
        """
        self._stop.tell(lambda: self._inbox.put(None))
        with ExitStack() as stack:
            enter = stack.enter_context
            journals = enter(OpenJournals(OPEN_JOURNALS))
            recorder = enter(Recorder(self._path, self._job, self._disk_wait, journals))
            enter(self._bus.subscribe(self._keys.outcome(), self._inbox.put))
            enter(self._bus.answer(self._keys.open, self._ask))
            enter(self._bus.answer(self._keys.log, self._ask))
            enter(self._bus.token(self._keys.recorder_token(secrets.token_hex(8))))
            log.info("recording", job=self._job, folder=str(self._path))
            while not self._stop.is_set:
                self._step(recorder)
            self._process(recorder, 0.0)
            self._report(recorder.finish())

    def _step(self, recorder: Recorder) -> None:
        now = time.monotonic()
        due = min(recorder.deadline, self._next_fetch(recorder), now + LONGEST_WAIT)
        self._process(recorder, max(0.0, due - now))
        now = time.monotonic()
        self._report(recorder.step(now))
        if now >= self._next_fetch(recorder):
            self._fetch_at = now + FETCH_INTERVAL
            self._begin_fetching(recorder.missing_scenes)

    def _next_fetch(self, recorder: Recorder) -> float:
        return self._fetch_at if recorder.missing_scenes else inf

    def _process(self, recorder: Recorder, timeout: float) -> None:
        """Process the events in the inbox; wait at most `timeout` seconds for the first."""
        with suppress(Empty):
            self._take(recorder, self._inbox.get(timeout=timeout), time.monotonic())
            for _ in range(MOST_EVENTS):
                self._take(recorder, self._inbox.get_nowait(), time.monotonic())

    def _take(self, recorder: Recorder, event: RecorderEvent, now: float) -> None:
        match event:
            case PendingQuery():
                self._answer(recorder, event, now)
            case Sample():
                recorder.take(event, now)
                self._fetch_at = 0.0  # a coordinator that sends rows has their scene, and may soon be gone
            case Bundle():
                with suppress(DiskFull):  # it is fetched again soon
                    recorder.add_scene(event.digest, event.payload)

    def _ask(self, query: Query) -> bytes:
        """Hand a query over from a thread of the bus, and wait for its answer."""
        pending = PendingQuery(query)
        self._inbox.put(pending)
        try:
            return pending.answer.result(ANSWER_TIMEOUT)
        except TimeoutError:
            raise NoReply("the recorder is busy") from None

    def _answer(self, recorder: Recorder, pending: PendingQuery, now: float) -> None:
        """Answer a query; a full disk that is waited for no longer ends this process."""
        try:
            pending.answer.set_result(recorder.answer(pending.query, now))
        except DiskFull as full:
            pending.answer.set_exception(NoReply(str(full)))
            raise
        except (NoReply, Refused) as reason:
            pending.answer.set_exception(reason)
        if pending.query.key == self._keys.open:
            self._fetch_at = 0.0

    def _report(self, reports: list[Recorded]) -> None:
        encoding = messages.encoding(Recorded)
        for report in reports:
            self._bus.put(
                self._keys.recorded, messages.encode(report), encoding=encoding, channel=Channel.CONTROL
            )

    def _begin_fetching(self, digests: list[str]) -> None:
        if self._fetcher is None or not self._fetcher.is_alive():
            self._fetcher = threading.Thread(target=self._fetch, args=[digests], name="fetcher", daemon=True)
            self._fetcher.start()

    def _fetch(self, digests: list[str]) -> None:
        """Fetch scene bundles one after the other; runs in the fetcher's thread."""
        for digest in digests:
            try:
                payload = fetch_bundle(self._bus, self._keys.asset(digest))
            except (MessageError, Refused):
                continue  # the coordinator is not there for this run now
            except BusError:
                return  # the next try is soon
            self._inbox.put(Bundle(payload, digest))
