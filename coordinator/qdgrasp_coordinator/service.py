"""The coordinator on the bus: ask, dispatch, settle, tell - for every run of a job at once.

One thread does everything but opening runs; callbacks of the bus and the opener only fill its inbox. What to
do is decided by pure state machines - pipeline, dispatch, outbox - and carried out here.
"""

import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack

import structlog

from qdgrasp_coordinator.assignment import Assignment
from qdgrasp_coordinator.batch import Settlement, readable
from qdgrasp_coordinator.dispatch import Dispatch
from qdgrasp_coordinator.figures import Figures, JobFigures, to_json
from qdgrasp_coordinator.generation import Generation
from qdgrasp_coordinator.inbox import Event, Inbox, JoinRequest, LinkChange, TokenChange, Wake
from qdgrasp_coordinator.lane import Lane
from qdgrasp_coordinator.lanes import Lanes
from qdgrasp_coordinator.opener import Begun, Failed, NoneLeft
from qdgrasp_coordinator.platforms import admit
from qdgrasp_coordinator.programme import Programme
from qdgrasp_coordinator.reception import Reception
from qdgrasp_coordinator.record import Record
from qdgrasp_protocol import codec
from qdgrasp_protocol.bus import Bus, Channel, Sample
from qdgrasp_protocol.errors import EndedEarly, MessageError, Refused, RunFailed
from qdgrasp_protocol.keys import Keys, last_chunk
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.messages import (
    VERSION,
    Control,
    Join,
    Joined,
    Message,
    Opened,
    Recorded,
    Result,
)

log = structlog.get_logger()

STAT_INTERVAL = 0.5  # seconds between two publications of the figures
MAX_PATIENCE = 0.5  # seconds that the inbox is waited for, at most
AHEAD_SECONDS = 2.0
"""Another run is opened when less work than this waits for each worker."""


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
        self._epoch = 0
        self._dispatch = Dispatch(0, batch_size)
        self._platform: dict[str, str] = {}
        self._alive: set[str] = set()
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
        log.info("ended", reason="asked to stop" if self._stop.is_set else "done", **self._dispatch.counters)
        if not self._stop.is_set:
            self._lanes.check()

    def figures(self, now: float) -> JobFigures:
        """How far the job is."""
        return self._lanes.figures(self._job, self._dispatch.workers, now)

    def _step(self) -> None:
        """Hear what came, then do everything that is possible now."""
        now = time.monotonic()
        for event in self._inbox.take(self._patience(now)):
            self._take(event, time.monotonic())
        now = time.monotonic()
        for lost in self._dispatch.tick(now):
            log.info("gave a worker up", worker=lost.wid[:8], reason=lost.reason, requeued=lost.batches)
        for lane in self._lanes:
            self._move(lane, now)
        ahead = AHEAD_SECONDS * self._dispatch.workers
        self._lanes.open_another(self._epoch, is_wanted=self._dispatch.queued_seconds < ahead)
        for lease in self._dispatch.leases(now):
            self._put(self._keys.work(lease.wid), lease.work(self._epoch))
        if now >= self._stat_at:
            self._publish_figures(now)

    def _patience(self, now: float) -> float:
        return min(MAX_PATIENCE, max(0.0, self._dispatch.next_deadline() - now))

    # Runs begin, go on and end.

    def _begin(self, lane: Lane, opened: Opened) -> None:
        """Take on a run that is open."""
        if not self._epoch:
            self._begin_turn(opened.epoch)
        try:
            self._platform = admit(self._platform, opened.platform or self._platform)
        except Refused as refusal:
            self._failed(RunFailed(lane.run, f"Its rows were made elsewhere: {refusal}"))
            return
        lane.record.set_platform(self._platform)
        self._lanes.begin(lane)
        log.info("opened", run=lane.run, recorded=lane.replayed)

    def _begin_turn(self, epoch: int) -> None:
        """Open the doors: results, joins and scenes first, the token that invites workers last."""
        self._epoch = epoch
        self._dispatch = Dispatch(epoch, self._batch_size)
        enter = self._doors.enter_context
        enter(self._bus.subscribe(self._keys.result(), self._inbox.put))
        enter(self._bus.subscribe(self._keys.stat("worker/*"), self._inbox.put))
        enter(self._bus.answer(self._keys.join, self._reception.join))
        enter(self._bus.answer(self._keys.asset(), self._reception.scene))
        enter(self._bus.watch(self._keys.worker_token(), self._token_changed))
        enter(self._bus.on_link(lambda up: self._inbox.put(LinkChange(up))))
        enter(self._bus.watch(self._keys.coordinator_token(), self._token_changed))
        enter(self._bus.token(self._keys.coordinator_token(epoch)))

    def _failed(self, reason: Exception) -> None:
        """Go on without a run that cannot be carried out; raise every other error."""
        if not isinstance(reason, RunFailed):
            raise reason
        self._lanes.fail(reason)
        log.error("a run cannot be carried out", run=reason.run, reason=str(reason))

    def _move(self, lane: Lane, now: float) -> None:
        """Ask what may be asked of a run, unless the recorder is far behind; send what it has found."""
        while not lane.record.is_full and (generation := lane.pipeline.ask()) is not None:
            self._submit(lane, generation)
        lane.record.tick(now)
        if lane.is_done:
            self._end(lane, now)

    def _submit(self, lane: Lane, generation: Generation) -> None:
        self._dispatch.submit(
            lane.run,
            lane.assignment.bundle.digest,
            lane.assignment.prior,
            generation.number,
            generation.indices,
            generation.trials,
            generation.genomes,
        )

    def _end(self, lane: Lane, now: float) -> None:
        """Let go of a run that is finished and recorded."""
        self._publish(f"run/{lane.run}", lane.figures(self._dispatch.workers, now))
        self._lanes.end(lane)
        log.info("finished", run=lane.run, reason=lane.pipeline.finished)

    def _withdraw(self, run: str) -> None:
        """Have nobody work on what a finished run does not need any more."""
        for wid, batches in self._dispatch.withdraw(run).items():
            self._drop(wid, batches)

    # Events come in.

    def _take(self, event: Event, now: float) -> None:
        match event:
            case JoinRequest(join, answer):
                self._admit(join, answer, now)
            case TokenChange(key, alive):
                self._take_token(key, alive, now)
            case LinkChange(up):
                self._dispatch.link(up, now)
            case Begun(lane, opened):
                self._begin(lane, opened)
            case Failed(reason):
                self._failed(reason)
            case NoneLeft():
                self._lanes.none_left()
            case Sample():
                self._take_sample(event, now)

    def _take_sample(self, sample: Sample, now: float) -> None:
        try:
            if sample.encoding == codec.encoding(Result):
                self._take_result(sample, now)
            elif sample.encoding == codec.encoding(Recorded):
                self._take_recorded(codec.decode(sample.payload, Recorded), now)
            else:
                self._dispatch.seen(last_chunk(sample.key), now)
        except MessageError as error:
            log.warning("dropped a message", key=sample.key, reason=str(error))

    def _take_token(self, key: str, alive: bool, now: float) -> None:
        who = last_chunk(key)
        if key == self._keys.worker_token(who):
            if alive:
                self._alive.add(who)
                self._dispatch.back(who, now)
            else:
                self._alive.discard(who)
                self._dispatch.gone(who, now)
        elif key == self._keys.recorder_token(who):
            for lane in self._lanes if alive else ():
                lane.record.recorder_up(now)
        elif alive and who.isdigit() and int(who) > self._epoch:
            raise EndedEarly(f"Another coordinator of job '{self._job}' took over (epoch {who}).")

    def _admit(self, join: Join, answer: "Future[bytes]", now: float) -> None:
        """Answer a worker that asks to join."""
        try:
            if VERSION not in join.versions:
                raise Refused(
                    f"it speaks versions {join.versions} of the protocol, this job speaks {VERSION}"
                )
            known = self._platform
            self._platform = admit(known, join.platform)
        except Refused as refusal:
            answer.set_exception(refusal)
            return
        for lane in self._lanes if not known else ():
            lane.record.set_platform(self._platform)
        drop = self._dispatch.join(join.wid, join.number, join.credit, join.held, now)
        if join.wid not in self._alive:  # its token is late, or vanished before its question came
            self._dispatch.gone(join.wid, now)
        log.info("worker joined", worker=join.wid[:8], host=join.host, pid=join.pid)
        answer.set_result(codec.encode(Joined(epoch=self._epoch, drop=drop)))

    def _take_result(self, sample: Sample, now: float) -> None:
        """Settle a result once, and take what became final."""
        result, wid = codec.decode(sample.payload, Result), last_chunk(sample.key)
        lane = self._lanes.get(result.run)
        if lane is None:
            self._dispatch.seen(wid, now)
            return
        result, rows = readable(result, lane.assignment.shape)
        settled = self._dispatch.settle(wid, result, rows, now)
        if settled.superseded is not None:
            self._drop(settled.superseded, [result.batch])
        if settled.kind is Settlement.FRESH and settled.rows is not None:
            lane.record.push(lane.pipeline.settle(settled.rows, settled.cpu_seconds, settled.failures))
            if lane.pipeline.finished is not None:
                self._withdraw(lane.run)

    def _take_recorded(self, report: Recorded, now: float) -> None:
        lane = self._lanes.get(report.run)
        if lane is not None:
            lane.record.heard(report, now)

    # Messages are sent.

    def _token_changed(self, key: str, alive: bool) -> None:
        self._inbox.put(TokenChange(key, alive))

    def _drop(self, wid: str, batches: list[bytes]) -> None:
        """Take batches back from a worker."""
        self._put(self._keys.ctl(wid), Control(epoch=self._epoch, drop=batches), Channel.CONTROL)

    def _put(self, key: str, message: Message, channel: Channel = Channel.DATA) -> None:
        kind = codec.encoding(type(message))
        self._bus.put(key, codec.encode(message), encoding=kind, channel=channel)

    def _publish_figures(self, now: float) -> None:
        self._stat_at = now + STAT_INTERVAL
        for lane in self._lanes:
            self._publish(f"run/{lane.run}", lane.figures(self._dispatch.workers, now))
        self._publish("job", self.figures(now))

    def _publish(self, what: str, figures: Figures | JobFigures) -> None:
        key = self._keys.stat(what)
        self._bus.put(key, to_json(figures), encoding="application/json", channel=Channel.MONITOR)
