"""The coordinator on the bus: ask, dispatch, settle, tell - for every run of a job at once.

One thread does everything but opening runs; callbacks of the bus and the run loader only fill its inbox.
What to do with what comes is decided in `JobScheduler`, and carried out here.
"""

import os
import socket
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import closing

import structlog

from qdgrasp_coordinator.metrics.job_status import JobStatus
from qdgrasp_coordinator.scheduler.job_scheduler import (
    AdminRequest,
    EarlyStop,
    Inbox,
    InboxEvent,
    JobScheduler,
    TokenChange,
    Wake,
)
from qdgrasp_coordinator.scheduler.recorder_client import RowSink
from qdgrasp_coordinator.scheduler.rpc import AdminCommands, BusSubscriptions, RpcHandlers
from qdgrasp_coordinator.scheduler.run_plan import RunPlan, RunQueue
from qdgrasp_coordinator.scheduler.run_registry import (
    ActiveRun,
    NoRunLeft,
    RunNotOpened,
    RunOpened,
    RunRegistry,
)
from qdgrasp_coordinator.scheduler.status_publisher import StatusPublisher
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus, Channel
from qdgrasp_protocol.errors import EndedEarly, RecorderFellBack, Refused, RunFailed
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Message, Opened, Order
from qdgrasp_protocol.process import Stop

log = structlog.get_logger()

MOST_WAIT = 0.5  # seconds that the inbox is waited for, at most


class CoordinatorService:
    """Carries out the runs of a job, each from its start or the end of its journal.

    Parameters
    ----------
    bus
        An open session.
    job
        The job's name.
    programme
        The runs. As many are carried out at once as keep the workers busy.
    make_record
        Makes the record that takes a run's rows.
    batch_size
        Rows in a batch; None: measured.
    seconds
        After so long leases are withdrawn, what was found is recorded, and `run` returns; None: never.
    paused
        True: nothing is handed out until a command continues the job.
    """

    def __init__(
        self,
        bus: Bus,
        stop: Stop,
        *,
        job: str,
        programme: RunQueue,
        make_record: Callable[[RunPlan], RowSink],
        batch_size: int | None = None,
        seconds: float | None = None,
        paused: bool = False,
    ) -> None:
        self._bus = bus
        self._stop = stop
        self._job = job
        self._keys = Keys(job)
        self._batch_size = batch_size
        self._inbox = Inbox()
        self._lanes = RunRegistry(programme, make_record, self._inbox.put, stop)
        self._board = StatusPublisher(bus, job, self._lanes, lambda: self._turn)
        reception = RpcHandlers(self._inbox, self._lanes.scene)
        self._doors = BusSubscriptions(bus, self._keys, self._inbox, reception, self._board.display)
        self._note = self._board.chronicle.note
        self._turn = self._new_turn(0)
        self._turn.is_paused = paused
        self._orders = AdminCommands(job, lambda: self._turn, self._end_early)
        self._ending = EarlyStop(seconds, time.monotonic())

    def run(self, look: Callable[[float], None] = lambda _now: None) -> None:
        """Carry all runs out until they are finished and recorded, or until asked to stop.

        Parameters
        ----------
        look
            Called with the time at every step.

        Raises
        ------
        TookOver
            Another coordinator goes on with the job.
        Cancelled
            The job was cancelled.
        RunsFailed
            Runs could not be carried out: a scene that cannot be built, a recorder that holds another run, a
            journal that is not what its spec replays to. The others are.
        """
        self._stop.tell(lambda: self._inbox.put(Wake()))
        with closing(self._lanes), self._doors:
            self._board.open(time.monotonic())
            self._doors.open()
            while not (self._stop.is_set or self._lanes.are_done or self._has_ended):
                self._step()
                look(time.monotonic())
            reason = str("asked to stop" if self._stop.is_set else self._ending.reason or "done")
            self._board.is_cancelled = self._has_ended and not (self._stop.is_set or self._lanes.are_done)
            self._board.publish(time.monotonic())
            self._note("job", f"The coordinator ends: {reason.rstrip('.')}.")
        dropped = self._turn.drops.count
        log.info("ended", reason=reason, dropped=dropped, **self._turn.dispatch.counters)
        if self._stop.is_set:
            return
        if self._ending.reason and not self._lanes.are_done:
            raise self._ending.reason
        self._lanes.check()

    def figures(self, now: float) -> JobStatus:
        """Return the job's figures."""
        return self._board.figures(now)

    def _step(self) -> None:
        """Process what came, then do everything that is possible now."""
        now = time.monotonic()
        for event in self._inbox.take(self._patience(now)):
            self._take(event, time.monotonic())
        now = time.monotonic()
        self._turn.step(now)
        for lane in self._lanes:
            if lane.is_done:
                self._end(lane, now)
        if not self._turn.is_ending:
            self._lanes.open_another(self._turn.epoch, is_wanted=self._turn.wants_more)
            if self._ending.is_due(now):
                self._end_early()
        self._board.publish_due(now)

    def _patience(self, now: float) -> float:
        deadline = min(self._turn.next_deadline(), self._ending.deadline, self._board.due)
        return min(MOST_WAIT, max(0.0, deadline - now))

    def _take(self, event: InboxEvent, now: float) -> None:
        match event:
            case RunOpened(lane, opened):
                self._begin(lane, opened)
            case RunNotOpened(reason):
                self._failed(reason)
            case NoRunLeft():
                self._lanes.none_left()
            case AdminRequest(order, answer):
                self._obey(order, answer, now)
            case TokenChange(key, alive):
                self._board.token_changed(key, alive)
                self._turn.take(event, now)
            case _:
                self._hear(event, now)

    def _hear(self, event: InboxEvent, now: float) -> None:
        try:
            self._turn.take(event, now)
        except RecorderFellBack as fallen:
            self._mend(fallen)

    # Some end before they are done.

    def _obey(self, order: Order, answer: "Future[str]", now: float) -> None:
        """Carry a command out, and answer it."""
        try:
            words = self._orders.obey(order, now)
        except Refused as refusal:
            answer.set_exception(refusal)
            return
        log.info("obeyed", order=order.act, words=words)
        self._note("job", words)
        self._board.publish(now)  # whoever has the answer and looks is to see it done
        answer.set_result(words)

    def _end_early(self, reason: EndedEarly | None = None) -> None:
        """Stop asking and leasing, and start the wait for the recorder."""
        self._turn.end()
        self._ending.begin(time.monotonic(), reason)

    @property
    def _has_ended(self) -> bool:
        """True if a job that ends early may end now."""
        if not self._turn.is_ending:
            return False
        is_safe = all(lane.record.is_empty for lane in self._lanes)
        return self._ending.is_over(time.monotonic(), is_safe=is_safe)

    # Runs begin, go on and end.

    def _begin(self, lane: ActiveRun, opened: Opened) -> None:
        """Add a run that is open."""
        if not self._turn.epoch:
            self._begin_turn(opened.epoch, opened.identity)
        try:
            self._turn.begin(lane, opened)
        except Refused as refusal:
            self._failed(RunFailed(lane.run, f"Its rows were made elsewhere: {refusal}"))
            return
        self._lanes.begin(lane)
        log.info("opened", run=lane.run, recorded=lane.replayed)
        rows = lane.tally.rows
        words = f"Run '{lane.run}' goes on from row {rows}." if rows else f"Run '{lane.run}' begins."
        self._note("run", words, run=lane.run)

    def _begin_turn(self, epoch: int, identity: str) -> None:
        """Begin the epoch that the recorder issued, and invite workers."""
        before, self._turn = self._turn, self._new_turn(epoch)
        self._turn.is_paused, self._turn.is_ending = before.is_paused, before.is_ending
        self._doors.open_to_workers(epoch)
        self._board.publish_meta(identity)
        how = f"takes over with turn {epoch}" if epoch > 1 else "begins"
        self._note("job", f"The coordinator on {socket.gethostname()} (process {os.getpid()}) {how}.")

    def _new_turn(self, epoch: int) -> JobScheduler:
        return JobScheduler(self._job, epoch, self._lanes, self._put, self._batch_size, self._board.chronicle)

    def _mend(self, fallen: RecorderFellBack) -> None:
        """Reopen a run whose recorder lost rows; these are evaluated again."""
        lane = self._lanes.get(fallen.run)
        if lane is not None:
            log.warning("a run goes on from fewer records", run=lane.run, reason=str(fallen))
            self._note("recorder", str(fallen), run=lane.run)
            self._turn.withdraw(lane.run)
            self._lanes.reopen(lane)

    def _failed(self, reason: Exception) -> None:
        """Go on without a run that cannot be carried out; raise every other error."""
        if not isinstance(reason, RunFailed):
            raise reason
        self._lanes.fail(reason)
        log.error("a run cannot be carried out", run=reason.run, reason=str(reason))
        self._note("error", f"Run '{reason.run}' cannot be carried out: {reason}", run=reason.run)

    def _end(self, lane: ActiveRun, now: float) -> None:
        """Remove a run that is finished and recorded."""
        self._board.publish_run(lane.figures(self._turn.dispatch.workers, now))
        self._lanes.end(lane)
        log.info("finished", run=lane.run, reason=lane.pipeline.finished)
        self._note("run", f"Run '{lane.run}' is finished: {lane.pipeline.finished}.", run=lane.run)

    def _put(self, key: str, message: Message, channel: Channel) -> None:
        kind = messages.encoding(type(message))
        self._bus.put(key, messages.encode(message), encoding=kind, channel=channel)
