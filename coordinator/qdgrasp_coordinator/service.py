"""The coordinator on the bus: ask, dispatch, settle, tell - for every run of a job at once.

One thread does everything but opening runs; callbacks of the bus and the opener only fill its inbox. What to
do with what comes is decided in `Turn`, and carried out here.
"""

import time
from collections.abc import Callable
from contextlib import ExitStack

import structlog

from qdgrasp_coordinator.assignment import Assignment
from qdgrasp_coordinator.figures import Figures, JobFigures, to_json
from qdgrasp_coordinator.inbox import Event, Inbox, LinkChange, TokenChange, Wake
from qdgrasp_coordinator.lane import Lane
from qdgrasp_coordinator.lanes import Lanes
from qdgrasp_coordinator.opener import Begun, Failed, NoneLeft
from qdgrasp_coordinator.programme import Programme
from qdgrasp_coordinator.reception import Reception
from qdgrasp_coordinator.record import Record
from qdgrasp_coordinator.turn import Turn
from qdgrasp_protocol import codec
from qdgrasp_protocol.bus import Bus, Channel
from qdgrasp_protocol.errors import Refused, RunFailed
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.messages import Message, Opened

log = structlog.get_logger()

STAT_INTERVAL = 0.5  # seconds between two publications of the figures
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
    ) -> None:
        self._bus = bus
        self._stop = stop
        self._job = job
        self._keys = Keys(job)
        self._batch_size = batch_size
        self._inbox = Inbox()
        self._doors = ExitStack()
        self._lanes = Lanes(programme, make_record, self._inbox.put, stop)
        self._reception = Reception(self._inbox, self._lanes.scene)
        self._turn = self._new_turn(0)
        self._stat_at = 0.0

    def run(self, look: Callable[[float], None] = lambda _now: None) -> None:
        """Carry all runs out until they are finished and recorded, or until asked to stop.

        Parameters
        ----------
        look
            Called with the time at every step.

        Raises
        ------
        EndedEarly
            Another coordinator took over.
        RunsFailed
            Runs could not be carried out: a scene that cannot be built, a recorder that holds another run, a
            journal that is not what its spec replays to. The others are.
        """
        self._stop.tell(lambda: self._inbox.put(Wake()))
        with self._doors:
            self._doors.callback(self._lanes.close)
            self._doors.enter_context(self._bus.subscribe(self._keys.recorded, self._inbox.put))
            self._doors.enter_context(self._bus.watch(self._keys.recorder_token(), self._token_changed))
            while not (self._stop.is_set or self._lanes.are_done):
                self._step()
                look(time.monotonic())
            self._publish_figures(time.monotonic())
        reason = "asked to stop" if self._stop.is_set else "done"
        log.info("ended", reason=reason, **self._turn.dispatch.counters)
        if not self._stop.is_set:
            self._lanes.check()

    def figures(self, now: float) -> JobFigures:
        """How far the job is."""
        return self._lanes.figures(self._job, self._turn.dispatch.workers, now)

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
        self._lanes.open_another(self._turn.epoch, is_wanted=self._turn.wants_more)
        if now >= self._stat_at:
            self._publish_figures(now)

    def _patience(self, now: float) -> float:
        return min(MAX_PATIENCE, max(0.0, self._turn.next_deadline() - now))

    def _take(self, event: Event, now: float) -> None:
        match event:
            case Begun(lane, opened):
                self._begin(lane, opened)
            case Failed(reason):
                self._failed(reason)
            case NoneLeft():
                self._lanes.none_left()
            case _:
                self._turn.take(event, now)

    # Runs begin, go on and end.

    def _begin(self, lane: Lane, opened: Opened) -> None:
        """Take on a run that is open."""
        if not self._turn.epoch:
            self._begin_turn(opened.epoch)
        try:
            self._turn.begin(lane, opened)
        except Refused as refusal:
            self._failed(RunFailed(lane.run, f"Its rows were made elsewhere: {refusal}"))
            return
        self._lanes.begin(lane)
        log.info("opened", run=lane.run, recorded=lane.replayed)

    def _begin_turn(self, epoch: int) -> None:
        """Open the doors: results, joins and scenes first, the token that invites workers last."""
        self._turn = self._new_turn(epoch)
        enter = self._doors.enter_context
        enter(self._bus.subscribe(self._keys.result(), self._inbox.put))
        enter(self._bus.subscribe(self._keys.stat("worker/*"), self._inbox.put))
        enter(self._bus.answer(self._keys.join, self._reception.join))
        enter(self._bus.answer(self._keys.asset(), self._reception.scene))
        enter(self._bus.watch(self._keys.worker_token(), self._token_changed))
        enter(self._bus.on_link(lambda up: self._inbox.put(LinkChange(up))))
        enter(self._bus.watch(self._keys.coordinator_token(), self._token_changed))
        enter(self._bus.token(self._keys.coordinator_token(epoch)))

    def _new_turn(self, epoch: int) -> Turn:
        return Turn(self._job, epoch, self._lanes, self._put, self._batch_size)

    def _failed(self, reason: Exception) -> None:
        """Go on without a run that cannot be carried out; raise every other error."""
        if not isinstance(reason, RunFailed):
            raise reason
        self._lanes.fail(reason)
        log.error("a run cannot be carried out", run=reason.run, reason=str(reason))

    def _end(self, lane: Lane, now: float) -> None:
        """Let go of a run that is finished and recorded."""
        self._publish(f"run/{lane.run}", lane.figures(self._turn.dispatch.workers, now))
        self._lanes.end(lane)
        log.info("finished", run=lane.run, reason=lane.pipeline.finished)

    # Messages are sent.

    def _token_changed(self, key: str, alive: bool) -> None:
        self._inbox.put(TokenChange(key, alive))

    def _put(self, key: str, message: Message, channel: Channel) -> None:
        kind = codec.encoding(type(message))
        self._bus.put(key, codec.encode(message), encoding=kind, channel=channel)

    def _publish_figures(self, now: float) -> None:
        self._stat_at = now + STAT_INTERVAL
        for lane in self._lanes:
            self._publish(f"run/{lane.run}", lane.figures(self._turn.dispatch.workers, now))
        self._publish("job", self.figures(now))

    def _publish(self, what: str, figures: Figures | JobFigures) -> None:
        key = self._keys.stat(what)
        self._bus.put(key, to_json(figures), encoding="application/json", channel=Channel.MONITOR)
