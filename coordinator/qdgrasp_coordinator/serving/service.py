"""The coordinator on the bus: ask, dispatch, settle, tell - for every run of a job at once.

One thread does everything but opening runs; callbacks of the bus and the opener only fill its inbox. What to
do with what comes is decided in `Turn`, and carried out here.
"""

import os
import socket
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import closing

import structlog

from qdgrasp_coordinator.campaigns.programme import Programme
from qdgrasp_coordinator.counts.figures import JobFigures
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.serving.board import Board
from qdgrasp_coordinator.serving.doors import Doors
from qdgrasp_coordinator.serving.ending import Ending
from qdgrasp_coordinator.serving.inbox import (
    Event,
    Inbox,
    OrderRequest,
    TokenChange,
    Wake,
)
from qdgrasp_coordinator.serving.lane import Lane
from qdgrasp_coordinator.serving.lanes import Lanes
from qdgrasp_coordinator.serving.opener import Begun, Failed, NoneLeft
from qdgrasp_coordinator.serving.orders import Orders
from qdgrasp_coordinator.serving.reception import Reception
from qdgrasp_coordinator.serving.record import Record
from qdgrasp_coordinator.serving.turn import Turn
from qdgrasp_protocol import codec
from qdgrasp_protocol.bus import Bus, Channel
from qdgrasp_protocol.errors import EndedEarly, RecorderFellBack, Refused, RunFailed
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.messages import Message, Opened, Order

log = structlog.get_logger()

MAX_PATIENCE = 0.5  # seconds that the inbox is waited for, at most


class CoordinatorService:
    """Carries the runs of a job out: from their first ask, or from where a journal ends, to their budgets.

    Parameters
    ----------
    bus
        An open session.
    job
        The job's name.
    programme
        The runs. As many are carried out at once as keep the workers busy.
    make_record
        Where the rows of a run go.
    batch_size
        Rows in a batch; None: measured.
    seconds
        After so long what is out is taken back, what was found is recorded, and `run` returns; None: never.
    paused
        Whether nothing is handed out until somebody says so.
    """

    def __init__(
        self,
        bus: Bus,
        stop: Stop,
        *,
        job: str,
        programme: Programme,
        make_record: Callable[[Assignment], Record],
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
        self._lanes = Lanes(programme, make_record, self._inbox.put, stop)
        self._board = Board(bus, job, self._lanes, lambda: self._turn)
        reception = Reception(self._inbox, self._lanes.scene)
        self._doors = Doors(bus, self._keys, self._inbox, reception, self._board.display)
        self._note = self._board.chronicle.note
        self._turn = self._new_turn(0)
        self._turn.is_paused = paused
        self._orders = Orders(job, lambda: self._turn, self._end_early)
        self._ending = Ending(seconds, time.monotonic())

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
            Somebody wanted the job to end.
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

    def figures(self, now: float) -> JobFigures:
        """How far the job is."""
        return self._board.figures(now)

    def _step(self) -> None:
        """Hear what came, then do everything that is possible now."""
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
        return min(MAX_PATIENCE, max(0.0, deadline - now))

    def _take(self, event: Event, now: float) -> None:
        match event:
            case Begun(lane, opened):
                self._begin(lane, opened)
            case Failed(reason):
                self._failed(reason)
            case NoneLeft():
                self._lanes.none_left()
            case OrderRequest(order, answer):
                self._obey(order, answer, now)
            case TokenChange(key, alive):
                self._board.token_changed(key, alive)
                self._turn.take(event, now)
            case _:
                self._hear(event, now)

    def _hear(self, event: Event, now: float) -> None:
        try:
            self._turn.take(event, now)
        except RecorderFellBack as fallen:
            self._mend(fallen)

    # Some end before they are done.

    def _obey(self, order: Order, answer: "Future[str]", now: float) -> None:
        """Do what an order asks, and answer it."""
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
        """Begin nothing any more, and wait a little until what was found is recorded."""
        self._turn.end()
        self._ending.begin(time.monotonic(), reason)

    @property
    def _has_ended(self) -> bool:
        """Whether a job that ends early may end now."""
        if not self._turn.is_ending:
            return False
        is_safe = all(lane.record.is_empty for lane in self._lanes)
        return self._ending.is_over(time.monotonic(), is_safe=is_safe)

    # Runs begin, go on and end.

    def _begin(self, lane: Lane, opened: Opened) -> None:
        """Take on a run that is open."""
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
        """Invite workers."""
        before, self._turn = self._turn, self._new_turn(epoch)
        self._turn.is_paused, self._turn.is_ending = before.is_paused, before.is_ending
        self._doors.open_to_workers(epoch)
        self._board.publish_meta(identity)
        how = f"takes over with turn {epoch}" if epoch > 1 else "begins"
        self._note("job", f"The coordinator on {socket.gethostname()} (process {os.getpid()}) {how}.")

    def _new_turn(self, epoch: int) -> Turn:
        return Turn(self._job, epoch, self._lanes, self._put, self._batch_size, self._board.chronicle)

    def _mend(self, fallen: RecorderFellBack) -> None:
        """Go on with a run from what is left of its records: what is missing is evaluated again."""
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

    def _end(self, lane: Lane, now: float) -> None:
        """Let go of a run that is finished and recorded."""
        self._board.publish_run(lane.figures(self._turn.dispatch.workers, now))
        self._lanes.end(lane)
        log.info("finished", run=lane.run, reason=lane.pipeline.finished)
        self._note("run", f"Run '{lane.run}' is finished: {lane.pipeline.finished}.", run=lane.run)

    def _put(self, key: str, message: Message, channel: Channel) -> None:
        kind = codec.encoding(type(message))
        self._bus.put(key, codec.encode(message), encoding=kind, channel=channel)
