"""The coordinator on the bus: ask, dispatch, settle, tell.

One thread does everything; callbacks of the bus only fill its inbox. What to do is decided by pure state
machines - pipeline, dispatch, outbox - and carried out here.
"""

import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack

import msgspec
import structlog

from qdgrasp_coordinator.assignment import Assignment
from qdgrasp_coordinator.batch import Settlement
from qdgrasp_coordinator.dispatch import Dispatch
from qdgrasp_coordinator.figures import Figures, to_json
from qdgrasp_coordinator.generation import Generation
from qdgrasp_coordinator.inbox import Event, Inbox, JoinRequest, LinkChange, TokenChange, Wake
from qdgrasp_coordinator.platforms import admit
from qdgrasp_coordinator.record import Record
from qdgrasp_protocol import chunks, codec
from qdgrasp_protocol.bus import Bus, Channel, Query, Sample
from qdgrasp_protocol.errors import EndedEarly, MessageError, NoReply, Refused
from qdgrasp_protocol.keys import Keys, last_chunk
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.messages import (
    VERSION,
    Control,
    Failure,
    Join,
    Joined,
    Message,
    Recorded,
    Result,
    short,
)
from qdgrasp_protocol.rows import RESULT, Rows, unpack

log = structlog.get_logger()

STAT_INTERVAL = 0.5  # seconds between two publications of the figures
ASK_INTERVAL = 0.1  # seconds between two questions to a recorder that does not answer
MAX_PATIENCE = 0.5  # seconds that the inbox is waited for, at most


class CoordinatorService:
    """Carries a run out: from its first ask, or from where its journal ends, to its budget.

    Parameters
    ----------
    bus
        An open session.
    job
        The job's name.
    assignment
        The run.
    record
        Where its rows go.
    batch_size
        Rows in a batch; None: measured.
    """

    def __init__(
        self,
        bus: Bus,
        stop: Stop,
        *,
        job: str,
        assignment: Assignment,
        record: Record,
        batch_size: int | None = None,
    ) -> None:
        self._bus = bus
        self._stop = stop
        self._job = job
        self._keys = Keys(job)
        self._run = assignment
        self._pipeline = assignment.pipeline
        self._record = record
        self._batch_size = batch_size
        self._inbox = Inbox()
        self._platform: dict[str, str] = {}
        self._alive: set[str] = set()
        self._dispatch = Dispatch(0, batch_size)
        self._began = time.monotonic()
        self._replayed = 0
        self._stat_at = 0.0

    def run(self, look: Callable[[float], None] = lambda _now: None) -> None:
        """Carry the run out until it is finished and recorded, or until asked to stop.

        Parameters
        ----------
        look
            Called with the time at every step.

        Raises
        ------
        EndedEarly
            Another coordinator took over.
        InputError
            The recorder holds another run.
        ReplayError
            The journal is not what its spec replays to.
        """
        self._stop.tell(lambda: self._inbox.put(Wake()))
        with ExitStack() as stack:
            self._listen_to_recorder(stack)
            opened = self._record.open(self._run.opening, self._wait)
            self._epoch = opened.epoch
            self._platform = opened.platform
            self._dispatch = Dispatch(opened.epoch, self._batch_size)
            self._replay(opened.durable[0])
            self._serve(stack)
            while not (self._stop.is_set or (self._pipeline.finished and self._record.is_empty)):
                self._step()
                look(time.monotonic())
            self._publish_figures(time.monotonic())
        reason = self._pipeline.finished or "asked to stop"
        log.info("ended", run=self._run.run, reason=reason, **self._dispatch.counters)

    def _listen_to_recorder(self, stack: ExitStack) -> None:
        stack.enter_context(self._bus.subscribe(self._keys.recorded, self._inbox.put))
        stack.enter_context(self._bus.watch(self._keys.recorder_token(), self._token_changed))

    def _serve(self, stack: ExitStack) -> None:
        """Open the doors: results, joins and scenes first, the token that invites workers last."""
        stack.enter_context(self._bus.subscribe(self._keys.result(), self._inbox.put))
        stack.enter_context(self._bus.subscribe(self._keys.stat("worker/*"), self._inbox.put))
        stack.enter_context(self._bus.answer(self._keys.join, self._answer_join))
        stack.enter_context(self._bus.answer(self._keys.asset(), self._answer_asset))
        stack.enter_context(self._bus.watch(self._keys.worker_token(), self._token_changed))
        stack.enter_context(self._bus.on_link(lambda up: self._inbox.put(LinkChange(up))))
        stack.enter_context(self._bus.watch(self._keys.coordinator_token(), self._token_changed))
        stack.enter_context(self._bus.token(self._keys.coordinator_token(self._epoch)))

    def _replay(self, durable: int) -> None:
        """Bring the search to where the journal ends: the same asks and tells, checked bit for bit."""
        position = 0
        while position < durable and not self._pipeline.finished:
            stretch = self._record.recorded(position, self._wait)
            if not len(stretch):
                raise EndedEarly(f"The recorder has {durable} rows but shows none from {position} on.")
            self._pipeline.replay(stretch.rows)
            position = stretch.stop
            self._replayed = self._pipeline.tally.evaluations
            self._pause()

    def _wait(self) -> None:
        """Between two questions to a recorder that does not answer."""
        self._pause()
        time.sleep(ASK_INTERVAL)

    def _pause(self) -> None:
        """Say how far the run is; end here if asked to.

        Raises
        ------
        SystemExit
            This process is asked to stop.
        """
        self._publish_figures(time.monotonic())
        if self._stop.is_set:
            raise SystemExit(self._stop.exit_code)

    def _step(self) -> None:
        """Hear what came, then do everything that is possible now."""
        now = time.monotonic()
        for event in self._inbox.take(self._patience(now)):
            self._take(event, time.monotonic())
        now = time.monotonic()
        for lost in self._dispatch.tick(now):
            log.info("gave a worker up", worker=lost.wid[:8], reason=lost.reason, requeued=lost.batches)
        self._ask()
        for lease in self._dispatch.leases(now):
            self._put(self._keys.work(lease.wid), lease.work(self._epoch))
        self._record.tick(now)
        self._publish_figures(now)

    def _patience(self, now: float) -> float:
        return min(MAX_PATIENCE, max(0.0, self._dispatch.next_deadline() - now))

    def _ask(self) -> None:
        """Ask the search for what it may be asked for, unless the recorder is far behind."""
        while not self._record.is_full:
            generation = self._pipeline.ask()
            if generation is None:
                return
            self._submit(generation)

    def _submit(self, generation: Generation) -> None:
        self._dispatch.submit(
            self._run.run,
            self._run.bundle.digest,
            self._run.prior,
            generation.number,
            generation.indices,
            generation.trials,
            generation.genomes,
        )

    def _take(self, event: Event, now: float) -> None:
        match event:
            case JoinRequest(join, answer):
                self._admit(join, answer, now)
            case TokenChange(key, alive):
                self._take_token(key, alive, now)
            case LinkChange(up):
                self._dispatch.link(up, now)
            case Sample(encoding=kind) if kind == codec.encoding(Result):
                self._take_result(event, now)
            case Sample(encoding=kind) if kind == codec.encoding(Recorded):
                self._take_recorded(event, now)
            case Sample(key=key):
                self._dispatch.seen(last_chunk(key), now)

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
            if alive:
                self._record.recorder_up(now)
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
        if not known:
            self._record.set_platform(self._platform)
        drop = self._dispatch.join(join.wid, join.number, join.credit, join.held, now)
        if join.wid not in self._alive:  # its token is late, or vanished before its question came
            self._dispatch.gone(join.wid, now)
        log.info("worker joined", worker=join.wid[:8], host=join.host, pid=join.pid)
        joined = Joined(epoch=self._epoch, lease_seconds=self._dispatch.lease_seconds, drop=drop)
        answer.set_result(codec.encode(joined))

    def _take_result(self, sample: Sample, now: float) -> None:
        """Settle a result once, and take what became final."""
        try:
            result, rows = self._read(sample)
            settled = self._dispatch.settle(last_chunk(sample.key), result, rows, now)
        except MessageError as error:
            log.warning("dropped a result", reason=str(error))
            return
        if settled.superseded is not None:
            control = Control(epoch=self._epoch, drop=[result.batch])
            self._put(self._keys.ctl(settled.superseded), control, Channel.CONTROL)
        if settled.kind is Settlement.FRESH and settled.rows is not None:
            self._record.push(self._pipeline.settle(settled.rows, settled.cpu_seconds, settled.failures))

    def _read(self, sample: Sample) -> tuple[Result, Rows]:
        """A result and its rows; where these cannot be read, all of them failed, for that reason."""
        result = codec.decode(sample.payload, Result)
        shape = self._run.shape
        rows = shape.empty(result.n)
        if len(result.failures) == result.n:
            return result, rows
        try:
            return result, unpack(rows, RESULT, result.columns, shape)
        except MessageError as error:
            failures = [Failure(row=row, reason=short(str(error))) for row in range(result.n)]
            return msgspec.structs.replace(result, failures=failures), rows

    def _take_recorded(self, sample: Sample, now: float) -> None:
        try:
            self._record.heard(codec.decode(sample.payload, Recorded), now)
        except MessageError as error:
            log.warning("dropped a report of the recorder", reason=str(error))

    def _answer_join(self, query: Query) -> bytes:
        """In a thread of the bus: hand the request over and wait for the answer."""
        try:
            request = JoinRequest(codec.decode(query.payload, Join))
        except MessageError as error:
            raise Refused(str(error)) from None
        self._inbox.put(request)
        try:
            return request.answer.result(timeout=5.0)
        except TimeoutError:
            raise NoReply("the coordinator is busy") from None

    def _answer_asset(self, query: Query) -> bytes:
        """In a thread of the bus: one chunk of the scene."""
        return chunks.answer(query, self._run.bundle.payload, self._run.bundle.digest)

    def _token_changed(self, key: str, alive: bool) -> None:
        self._inbox.put(TokenChange(key, alive))

    def _put(self, key: str, message: Message, channel: Channel = Channel.DATA) -> None:
        kind = codec.encoding(type(message))
        self._bus.put(key, codec.encode(message), encoding=kind, channel=channel)

    def _publish_figures(self, now: float) -> None:
        if now < self._stat_at and not self._pipeline.finished:
            return
        self._stat_at = now + STAT_INTERVAL
        payload = to_json(self.figures(now))
        key = self._keys.stat(f"run/{self._run.run}")
        self._bus.put(key, payload, encoding="application/json", channel=Channel.MONITOR)

    def figures(self, now: float) -> Figures:
        """How far the run is."""
        counts = self._pipeline.tally
        seconds = now - self._began
        return Figures(
            run=self._run.run,
            evaluations=counts.evaluations,
            budget=self._run.evaluations,
            rows=counts.rows,
            proposals=counts.proposals,
            overlaps=counts.overlaps,
            successes=counts.successes,
            grasps=counts.grasps,
            robust=counts.robust,
            errors=counts.errors,
            cells=counts.cells,
            workers=self._dispatch.workers,
            durable=self._record.durable,
            seconds=seconds,
            rate=(counts.evaluations - self._replayed) / seconds if seconds > 0 else 0.0,
            trouble=self._record.trouble,
        )
