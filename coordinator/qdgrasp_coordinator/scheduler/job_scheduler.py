"""The scheduler of a job: decides on each event, without a thread or a clock.

Pipeline, dispatcher and outbox decide for themselves; here stands who of them hears what, and what goes out
(docs/bus.md, rules 1 to 10). Time is passed in, in seconds of any steady clock.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from math import inf
from queue import Empty, SimpleQueue
from typing import Protocol

import structlog

from qdgrasp_coordinator.metrics.job_status import EventLog, from_json
from qdgrasp_coordinator.scheduler.batch_queue import Settlement, read_result
from qdgrasp_coordinator.scheduler.dispatcher import STRIKES, Dispatcher
from qdgrasp_coordinator.scheduler.pipeline import Generation
from qdgrasp_coordinator.scheduler.run_registry import ActiveRun, LoaderEvent
from qdgrasp_coordinator.scheduler.worker_admission import PutMessage, WorkerAdmission
from qdgrasp_coordinator.storage.run_folder import admit_platform
from qdgrasp_protocol.bus import Channel, DropCounter, Sample
from qdgrasp_protocol.errors import EndedEarly, MessageError, TookOver
from qdgrasp_protocol.keys import Keys, last_chunk, parse_number
from qdgrasp_protocol.messages import Failure, Heartbeat, Join, Opened, Order, Recorded, Result, decode_sample
from qdgrasp_protocol.text import counted


@dataclass(frozen=True)
class JoinRequest:
    """A worker's request to join, and its answer."""

    join: Join
    answer: Future[bytes] = field(default_factory=Future)


@dataclass(frozen=True)
class AdminRequest:
    """An administrator's command, and its answer in words."""

    order: Order
    answer: Future[str] = field(default_factory=Future)


@dataclass(frozen=True)
class TokenChange:
    """A token of this job appeared or vanished."""

    key: str
    alive: bool


@dataclass(frozen=True)
class LinkChange:
    """A transport of this session came up or went down."""

    up: bool


@dataclass(frozen=True)
class Wake:
    """Wakes the thread to check for signals."""


InboxEvent = Sample | JoinRequest | AdminRequest | TokenChange | LinkChange | LoaderEvent | Wake


class Inbox:
    """Events in the order they came."""

    def __init__(self) -> None:
        self._queue: SimpleQueue[InboxEvent] = SimpleQueue()

    def put(self, event: InboxEvent) -> None:
        """Add an event; safe in a signal handler."""
        self._queue.put(event)

    def take(self, patience: float, most: int = 256) -> list[InboxEvent]:
        """Return at most `most` events, waiting at most `patience` seconds for the first."""
        events: list[InboxEvent] = []
        try:
            events.append(self._queue.get(timeout=max(0.0, patience)))
            while len(events) < most:
                events.append(self._queue.get_nowait())
        except Empty:
            pass
        return events


LEAST_STOP_SECONDS = 0.2  # Shortest time that an ending takes [s], so that the asker gets its answer
MOST_STOP_SECONDS = 5.0  # Longest wait for a recorder [s]; rows unrecorded by then are evaluated again


class EarlyStop:
    """Decides when a job ends early.

    Parameters
    ----------
    seconds
        Time after which it ends by itself; None: never.
    """

    reason: EndedEarly | None = None
    """Reason of a requested end; None: not requested."""

    def __init__(self, seconds: float | None, now: float) -> None:
        self._due_at = inf if seconds is None else now + seconds
        self._began: float | None = None

    def begin(self, now: float, reason: EndedEarly | None = None) -> None:
        """Begin the ending: no more work is asked or handed out."""
        self._began, self.reason = now, reason

    def is_due(self, now: float) -> bool:
        """True if it is to begin by itself now."""
        return self._began is None and now >= self._due_at

    def is_over(self, now: float, *, is_safe: bool) -> bool:
        """True if the job may end now; `is_safe`: all results are recorded."""
        if self._began is None:
            return False
        return now >= self._began + (LEAST_STOP_SECONDS if is_safe else MOST_STOP_SECONDS)

    @property
    def deadline(self) -> float:
        """When it is to begin by itself; infinite: never, or it has begun."""
        return inf if self._began is not None else self._due_at


log = structlog.get_logger()

AHEAD_SECONDS = 2.0  # Another run is wanted when less work than this waits for each worker


class OpenRuns(Protocol):
    """The active runs."""

    def __iter__(self) -> Iterator[ActiveRun]:
        """Iterate, oldest first."""

    def get(self, run: str) -> ActiveRun | None:
        """Return an active run; None: not active."""


class JobScheduler:
    """Decides what a coordinator does with each event of one epoch.

    Parameters
    ----------
    epoch
        The coordinator's; 0: none is issued yet, and no worker is served.
    lanes
        The active runs.
    put
        Sends messages.
    batch_size
        Rows in a batch; None: measured.
    chronicle
        Log of what happens to workers and rows; None: a log that is not shown.
    """

    def __init__(
        self,
        job: str,
        epoch: int,
        lanes: OpenRuns,
        put: PutMessage,
        batch_size: int | None,
        chronicle: EventLog | None = None,
    ) -> None:
        self.epoch = epoch
        self.dispatch = Dispatcher(epoch, batch_size)
        self._job = job
        self._keys = Keys(job)
        self._results = self._keys.result("")
        self._lanes = lanes
        self._put = put
        self._chronicle = chronicle or EventLog()
        self.crew = WorkerAdmission(epoch, self._keys, self.dispatch, put, self._chronicle)
        self.drops = DropCounter()
        self.is_paused = False
        """True: nothing is leased; leased batches still count."""
        self.is_ending = False
        """True: nothing is asked or leased; what was found is still recorded."""

    # Events come in.

    def begin(self, lane: ActiveRun, opened: Opened) -> None:
        """Check that a run may be carried out beside the others, and note the platform of its rows.

        Raises
        ------
        Refused
            Its rows were made on another platform.
        """
        crew = self.crew
        crew.platform = admit_platform(crew.platform, opened.platform or crew.platform)
        lane.record.set_platform(crew.platform)

    def take(self, event: object, now: float) -> None:
        """Process an event; ignore those of other kinds.

        Raises
        ------
        TookOver
            Another coordinator took over.
        """
        match event:
            case JoinRequest(join, answer):
                self._take_join(join, answer, now)
            case TokenChange(key, alive):
                self._take_token(key, alive, now)
            case LinkChange(up):
                self.dispatch.link(up, now)
            case Sample():
                self._take_sample(event, now)

    def _take_sample(self, sample: Sample, now: float) -> None:
        """Process a message; its kind follows from its key, as in access lists."""
        try:
            if sample.key == self._keys.recorded:
                self._take_recorded(decode_sample(sample, Recorded), now)
            elif sample.key.startswith(self._results):
                self._take_result(sample, now)
            else:
                self.crew.said(last_chunk(sample.key), from_json(sample.payload, Heartbeat), now)
        except MessageError as error:
            self.drops.note(sample.key, error)

    def _take_token(self, key: str, alive: bool, now: float) -> None:
        who = last_chunk(key)
        if key == self._keys.worker_token(who):
            self.crew.token_changed(who, alive, now)
        elif key == self._keys.recorder_token(who):
            for lane in self._lanes if alive else ():
                lane.record.recorder_up(now)
        elif alive and (parse_number(who) or 0) > self.epoch:
            raise TookOver(self._job, who)

    def _take_join(self, join: Join, answer: "Future[bytes]", now: float) -> None:
        """Answer a worker that asks to join; the first one sets the platform of the rows."""
        known = self.crew.platform
        self.crew.join(join, answer, now)
        for lane in self._lanes if self.crew.platform != known else ():
            lane.record.set_platform(self.crew.platform)

    def _take_result(self, sample: Sample, now: float) -> None:
        """Settle a result once, and take what became final."""
        result, wid = decode_sample(sample, Result), last_chunk(sample.key)
        lane = self._lanes.get(result.run)
        if lane is None:
            self.dispatch.seen(wid, now)
            return
        result, rows = read_result(result, lane.assignment.shape)
        settled = self.dispatch.settle(wid, result, rows, now)
        if settled.superseded is not None:
            self.crew.drop(settled.superseded, [result.batch])
        if settled.kind is Settlement.FRESH and settled.rows is not None:
            self.crew.settled(wid, result.n, now)
            self._note_failures(lane.run, wid, settled.failures)
            lane.record.push(lane.pipeline.settle(settled.rows, settled.cpu_seconds, settled.failures))
            if lane.pipeline.finished is not None:
                self.withdraw(lane.run)

    def _note_failures(self, run: str, wid: str, failures: Sequence[Failure]) -> None:
        """Note that rows were given up."""
        if failures:
            rows = f"{counted(len(failures), 'row')} of run '{run}'"
            words = f"{rows} given up after {STRIKES} tries: {failures[0].reason}."
            self._chronicle.note("error", words, run=run, worker=wid)

    def _take_recorded(self, report: Recorded, now: float) -> None:
        lane = self._lanes.get(report.run)
        if lane is not None:
            lane.record.heard(report, now)

    # What can be done now is done.

    def step(self, now: float) -> None:
        """Give up overdue workers, ask, send what was found, and lease what waits."""
        for lost in self.dispatch.tick(now):
            self.crew.lost(lost, now)
        for lane in self._lanes:
            self._move(lane, now)
        for lease in [] if self.is_paused or self.is_ending else self.dispatch.leases(now):
            self._put(self._keys.work(lease.wid), lease.work(self.epoch), Channel.DATA)

    def next_deadline(self) -> float:
        """Return when `step` gives a worker up if nothing happens; infinite: never."""
        return self.dispatch.next_deadline()

    @property
    def wants_more(self) -> bool:
        """True if so little work waits that another run should be opened."""
        return not self.is_ending and self.dispatch.queued_seconds < AHEAD_SECONDS * self.dispatch.workers

    def _move(self, lane: ActiveRun, now: float) -> None:
        """Submit what a run asks, unless the recorder is far behind; send what it has found."""
        while self._may_ask(lane) and (generation := lane.pipeline.ask()) is not None:
            self._submit(lane, generation)
        lane.record.tick(now)

    def _may_ask(self, lane: ActiveRun) -> bool:
        return not (self.is_ending or lane.record.is_full)

    def _submit(self, lane: ActiveRun, generation: Generation) -> None:
        self.dispatch.submit(
            lane.run,
            lane.assignment.bundle.digest,
            lane.assignment.prior,
            generation.number,
            generation.indices,
            generation.trials,
            generation.genomes,
        )

    # It ends, or some of its runs do.

    def end(self) -> None:
        """Stop asking and leasing, and withdraw all leases; what was found is still recorded."""
        self.is_ending = True
        for lane in self._lanes:
            self.withdraw(lane.run)

    def withdraw(self, run: str) -> None:
        """Withdraw a run's queued and leased rows."""
        for wid, batches in self.dispatch.withdraw(run).items():
            self.crew.drop(wid, batches)
