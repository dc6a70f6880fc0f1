"""The scheduler of a job: decides on each event, without a thread or a clock.

It lives as long as its coordinator, over the epoch that a recorder issues. Pipelines, dispatcher, workers
and outboxes decide for themselves; this module passes events to them, and their messages on to the bus
(docs/bus.md, rules 1 to 10). Time is passed in, in seconds of any steady clock.
"""

import os
import socket
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from math import inf

import structlog

from qdgrasp_coordinator.metrics.job_status import EventKind, EventLog, JobStatus, from_json
from qdgrasp_coordinator.metrics.time_left import TimeLeft
from qdgrasp_coordinator.scheduler.auditor import Auditor, read_result
from qdgrasp_coordinator.scheduler.batch_dispatcher import STRIKES, Dispatcher
from qdgrasp_coordinator.scheduler.batch_queue import Audit
from qdgrasp_coordinator.scheduler.run_plan import BuildReply, WantedShapes
from qdgrasp_coordinator.scheduler.run_registry import (
    ActiveRun,
    LoadEnded,
    LoaderEvent,
    RunRegistry,
)
from qdgrasp_coordinator.scheduler.worker_registry import (
    WID_DIGITS,
    LostWorker,
    WorkerRegistry,
    choose_workers,
)
from qdgrasp_coordinator.storage.platforms import LacksEngine, admit_platform, lacks_engine
from qdgrasp_protocol import messages
from qdgrasp_protocol.build_messages import Built
from qdgrasp_protocol.bus import Channel, DropCounter, LinkChange, Sample, TokenChange, decode_sample
from qdgrasp_protocol.errors import (
    Cancelled,
    EndedEarly,
    MessageError,
    RecorderFellBack,
    Refused,
    RunFailed,
    TookOver,
)
from qdgrasp_protocol.keys import Keys, last_chunk, parse_number
from qdgrasp_protocol.messages import (
    Control,
    Heartbeat,
    Join,
    Message,
    Opened,
    Order,
    Recorded,
    Result,
    worker_id,
)
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.text import counted

log = structlog.get_logger()

AHEAD_SECONDS = 2.0  # Another run is wanted when less work than this waits for each worker
COUNTERS_SHOWN = ("requeued", "doubled")


@dataclass(frozen=True)
class JoinRequest:
    """A worker's request to join, and its answer."""

    join: Join
    answer: Future[bytes] = field(default_factory=Future)


SchedulerEvent = Sample | JoinRequest | TokenChange | LinkChange | LoaderEvent
"""What a scheduler decides on."""
PutMessage = Callable[[str, Message, Channel], None]
"""Sends a message on a key; messages are lost while there is no link."""


LEAST_STOP_SECONDS = 0.2  # Shortest time that an ending takes [s], so that the asker gets its answer
MOST_STOP_SECONDS = 5.0  # Longest wait for a recorder [s]; rows unrecorded by then are evaluated again


class JobScheduler:
    """Decides what a coordinator does with each event.

    `on_epoch` is called with the epoch that a recorder issued and the identity of the job, before a worker is
    served; `on_finished` with each finished and recorded run before it is removed. The job ends by itself at
    the time `ends_at`; infinite: when it is done.
    """

    stop_reason: EndedEarly | None = None
    """Why it ends early, where that was asked for."""

    def __init__(
        self,
        job: str,
        runs: RunRegistry,
        put: PutMessage,
        *,
        batch_size: int | None = None,
        events: EventLog | None = None,
        ends_at: float = inf,
        on_epoch: Callable[[int, str], None] = lambda _epoch, _identity: None,
        on_finished: Callable[[ActiveRun, float], None] = lambda _run, _now: None,
    ) -> None:
        self.job = job
        self.runs = runs
        self.events = events or EventLog()
        self.ends_at = ends_at
        """When it ends by itself; infinite: never, or it is ending."""
        self._stopped_at: float | None = None  # When the ending began
        self.drops = DropCounter()
        self.is_paused = False  # True: nothing is leased; leased batches still count
        self.is_cancelled = False
        """True if the job ends before it is done: it was cancelled, or its time is over."""
        self._keys = Keys(job)
        self._results = self._keys.result("")
        self._put = put
        self._batch_size = batch_size
        self._on_epoch = on_epoch
        self._on_finished = on_finished
        self._recorders: set[str] = set()
        self._time_left = TimeLeft()
        self.start_epoch(0)

    def start_epoch(self, epoch: int) -> None:
        """Begin an epoch, without workers; in epoch 0, before one is issued, no worker is served."""
        self.epoch = epoch
        self.workers = WorkerRegistry()
        self.dispatcher = Dispatcher(epoch, self.workers, self._batch_size)
        self._auditor = Auditor(self.dispatcher.audit)

    def handle(self, event: SchedulerEvent, now: float) -> None:
        """Process an event; TookOver if another coordinator did."""
        match event:
            case Sample():
                self._on_message(event, now)
            case JoinRequest(join, answer):
                self._on_join(join, answer, now)
            case TokenChange(key, alive):
                self._on_token(key, alive, now)
            case LinkChange(up):
                self.workers.on_link(up, now)
            case LoadEnded():
                self._on_load_ended(event)
            case WantedShapes():
                self._on_wanted_shapes(event)

    def _on_message(self, sample: Sample, now: float) -> None:
        """Process a message; its kind follows from its key, as in access lists."""
        try:
            if sample.key == self._keys.recorded:
                self._on_recorded(decode_sample(sample, Recorded), now)
            elif sample.encoding == messages.encoding(Built) and sample.key.startswith(self._results):
                built = decode_sample(sample, Built)
                self._check_sender(last_chunk(sample.key), built.key)
                self._on_built(built, last_chunk(sample.key), now)
            elif sample.key.startswith(self._results):
                result = decode_sample(sample, Result)
                self._check_sender(last_chunk(sample.key), result.key)
                self._on_result(result, last_chunk(sample.key), now)
            else:
                heartbeat = from_json(sample.payload, Heartbeat)
                self.workers.on_heartbeat(last_chunk(sample.key), heartbeat, now)
        except MessageError as error:
            self.drops.note(sample.key, error)

    def _check_sender(self, wid: str, key: bytes) -> None:
        """Raise a MessageError unless an answer is of the worker on whose key it came."""
        worker = self.workers.get(wid)
        if not (worker and worker.join.key == key) and worker_id(key) != wid:
            raise MessageError(f"an answer of worker {wid[:WID_DIGITS]} without this worker's key")

    def _on_result(self, result: Result, wid: str, now: float) -> None:
        """Settle a result once, and pass the rows that became final on to the recorder."""
        run = self.runs.get(result.run)
        if run is None or wid in self.runs.excluded:
            self.workers.answered(wid, result.batch, now)
            self.dispatcher.requeue(wid, [result.batch])  # an audit, while its run is opened again
            return
        result, rows = read_result(result, run.plan.shape)
        settled = self.dispatcher.settle(wid, result, rows, now)
        if settled is None:
            return
        if settled.audit is not None:
            self._on_audit(run.name, settled.audit, settled.rows)
            return
        self.workers.on_settled(wid, len(settled.rows), now)
        if failures := settled.failures:
            rows_of = f"{counted(len(failures), 'row')} of run '{run.name}'"
            words = f"{rows_of} given up after {STRIKES} tries: {failures[0].reason}."
            self.events.note("error", words, run=run.name, worker=wid)
        worker = self.workers.find(wid)
        maker = messages.shorten(f"{wid} {worker.join.host if worker else ''}")
        self._auditor.draw(run.ref, settled.rows, worker)
        run.sink.push(run.pipeline.settle(settled.rows, settled.cpu_seconds, settled.failures, maker))
        if run.pipeline.finished is not None:
            self._withdraw(run.name, audits=False)

    def _on_audit(self, run: str, audit: Audit, rows: Rows) -> None:
        """Exclude a worker that was certainly wrong, and take back all rows that it made."""
        row, (wid,) = self._auditor.first_wrong(audit, rows), audit.tried_by
        if row is None or wid in self.runs.excluded:
            return
        worker = self.workers.find(wid)
        who = worker.description if worker else f"Worker {wid[:WID_DIGITS]}"
        place = f"generation {row['generation']}, index {row['index']}, trial {row['trial']}"
        words = f"{who} is excluded: its result for {place} of run '{run}' is wrong. Its rows are taken back."
        log.error("a worker is excluded", worker=wid, run=run, row=place)
        self.events.note("error", words, run=run, worker=wid)
        self.workers.drain(wid)
        self._send_away(wid)
        for one in self.runs:
            self._withdraw(one.name, audits=False)
        self.runs.exclude(wid)

    def _on_built(self, built: Built, wid: str, now: float) -> None:
        """Settle a build once; the runs that wait for its shape are opened, or fail."""
        reply = self.dispatcher.settle_build(wid, built, now)
        if reply is not None:
            self.runs.shapes.end(reply)

    def _on_wanted_shapes(self, wanted: WantedShapes) -> None:
        self.runs.shapes.add(wanted)
        self.dispatcher.build(shape.task for shape in wanted.shapes)
        for warning in wanted.warnings:
            log.warning("a shape", object=warning.object, words=warning.words)
            self.events.note("warning", warning.words, object_=warning.object)

    def _on_recorded(self, report: Recorded, now: float) -> None:
        """Note the durable rows; reopen a run whose recorder lost some."""
        run = self.runs.get(report.run)
        if run is None:
            return
        try:
            run.sink.on_report(report, now)
        except RecorderFellBack as fallen:
            log.warning("a run goes on from fewer records", run=run.name, reason=str(fallen))
            self.events.note("recorder", str(fallen), run=run.name)
            self._withdraw(run.name)
            self.runs.reopen(run)

    def _on_token(self, key: str, alive: bool, now: float) -> None:
        name = last_chunk(key)
        if key == self._keys.worker_token(name):
            self.workers.on_token(name, alive, now)
        elif key == self._keys.recorder_token(name):
            self._on_recorder_token(name, alive, now)
        elif alive and (parse_number(name) or 0) > self.epoch:
            raise TookOver(self.job, name)

    def _on_recorder_token(self, name: str, alive: bool, now: float) -> None:
        if alive != (name in self._recorders):
            (self._recorders.add if alive else self._recorders.discard)(name)
            words = "A recorder is there." if alive else "The recorder is gone; what is found waits for one."
            self.events.note("recorder", words)
        for run in self.runs if alive else ():
            run.sink.resend(now)

    def _on_load_ended(self, event: LoadEnded) -> None:
        self.runs.load_ended(event)
        if event.failure is not None:
            self._on_not_opened(event.failure)
        elif event.opened is not None and event.run is not None:
            self._on_opened(event.run, event.opened)
        elif event.opened is not None:
            self._begin_epoch(event.opened)

    def _on_opened(self, run: ActiveRun, opened: Opened) -> None:
        if not self.epoch:
            self._begin_epoch(opened)
        workers = self.workers
        try:
            workers.platform = admit_platform(workers.platform, opened.platform or workers.platform)
        except Refused as refusal:
            self._on_not_opened(RunFailed(run.name, f"Its rows were made elsewhere: {refusal}."))
            return
        run.sink.platform = workers.platform
        for worker in list(workers):
            if lacks_engine(run.plan.spec.engine, worker.join.platform):
                workers.drain(worker.wid)
                self._send_away(worker.wid)
        self.runs.add(run)
        if run.excluded != self.runs.excluded:  # a worker was found wrong while it was opened
            self.runs.reopen(run)
            return
        log.info("opened", run=run.name, recorded=run.replayed)
        rows = run.tally.rows
        words = f"Run '{run.name}' goes on from row {rows}." if rows else f"Run '{run.name}' begins."
        self.events.note("run", words, run=run.name)

    def _begin_epoch(self, opened: Opened) -> None:
        """Begin the epoch that a recorder has issued, and serve workers from now on."""
        self.start_epoch(opened.epoch)
        self.workers.platform = opened.platform
        self._on_epoch(opened.epoch, opened.identity)
        how = f"takes over with epoch {opened.epoch}" if opened.epoch > 1 else "begins"
        self.events.note("job", f"The coordinator on {socket.gethostname()} (process {os.getpid()}) {how}.")

    def _on_not_opened(self, reason: Exception) -> None:
        """Go on without a run that cannot be carried out; raise every other error."""
        if not isinstance(reason, RunFailed):
            raise reason
        self._withdraw(reason.run)
        self.runs.add_failure(reason)
        log.error("a run cannot be carried out", run=reason.run, reason=str(reason))
        words = f"Run '{reason.run}' cannot be carried out: {reason}"
        self.events.note("error", words, run=reason.run, object_=self.runs.object_of(reason.run))

    def _remove(self, run: ActiveRun, now: float) -> None:
        self._withdraw(run.name)  # audits, if no trusted worker is left
        self._on_finished(run, now)
        self.runs.remove(run)
        log.info("finished", run=run.name, reason=run.pipeline.finished)
        self.events.note("run", f"Run '{run.name}' is finished: {run.pipeline.finished}.", run=run.name)

    def _withdraw(self, run: str, *, audits: bool = True) -> None:
        for wid, batches in self.dispatcher.withdraw(run, audits=audits).items():
            self._drop(wid, batches)

    def _on_join(self, join: Join, answer: "Future[bytes]", now: float) -> None:
        """Answer a worker that asks to join; the first one sets the platform of the rows."""
        platform, is_new = self.workers.platform, self.workers.get(join.wid) is None
        try:
            if join.wid in self.runs.excluded:
                raise Refused("it was found wrong, and is excluded from the job")
            for run in self.runs:
                if lacks_engine(run.plan.spec.engine, join.platform):
                    raise LacksEngine(run.name, run.plan.spec.engine)
            drop = self.dispatcher.join(join, now)
        except Refused as refusal:
            words = f"A worker on {join.host} was refused: {refusal}."
            self.events.note("worker", words, worker=join.wid)
            answer.set_exception(refusal)
            return
        worker = self.workers.get(join.wid)
        if worker and is_new:
            self.events.note("worker", f"{worker.description} joined.", worker=join.wid)
        if worker and worker.is_drained:
            self._send_away(join.wid)
        log.info("worker joined", worker=join.wid[:8], host=join.host, pid=join.pid)
        answer.set_result(messages.encode(messages.Joined(epoch=self.epoch, drop=drop)))
        for run in self.runs if self.workers.platform != platform else ():
            run.sink.platform = self.workers.platform

    def _on_lost(self, lost: LostWorker) -> None:
        """Queue again the batches of a worker that left, vanished or is stuck."""
        worker, requeued = lost.worker, self.dispatcher.requeue(lost.worker.wid, lost.batches)
        log.info("gave a worker up", worker=worker.wid[:8], reason=lost.reason, requeued=requeued)
        kind: EventKind = "trouble" if worker.gone_at is None else "worker"
        end = "is stuck" if worker.gone_at is None else "is gone"
        how = f"{end}: {lost.reason}" if worker.join.credit else "has left"
        again = f"; {requeued} of its batches are queued again" if requeued else ""
        self.events.note(kind, f"{worker.description} {how}{again}.", worker=worker.wid)

    def _drop(self, wid: str, batches: list[bytes]) -> None:
        self._put(self._keys.ctl(wid), Control(epoch=self.epoch, drop=batches), Channel.CONTROL)

    def _send_away(self, wid: str) -> None:
        self._put(self._keys.ctl(wid), Control(epoch=self.epoch, drain=True), Channel.CONTROL)

    def step(self, now: float) -> None:
        """Do all steps that are due: give up workers, ask, record, lease, end and open runs."""
        for lost in self.workers.overdue(now):
            self._on_lost(lost)
        for run in self.runs:
            while not (self.is_ending or run.sink.is_full) and (asked := run.pipeline.ask()) is not None:
                self.dispatcher.submit(run.ref, asked)
            run.sink.tick(now)
        if not (self.is_paused or self.is_ending):
            self._lease(now)
        for run in self.runs:
            if run.is_done and not self.dispatcher.awaits_audit(run.name):
                self._remove(run, now)
        if not self.is_ending:
            workers = len(self.workers)
            is_wanted = self.dispatcher.queued_seconds < AHEAD_SECONDS * workers
            self.runs.load(self.epoch, workers=workers, is_wanted=is_wanted)
        if now >= self.ends_at:
            self.stop(now)

    def _lease(self, now: float) -> None:
        """Lease builds, then batches; a build that no worker here can do is left to the loader."""
        # One at a time, as the loader's thread builds it: others may find a worker meanwhile.
        if not self.runs.is_loading and (task := self.dispatcher.give_up_build()) is not None:
            self.runs.shapes.end(BuildReply(task.key))
        for lease in self.dispatcher.leases(now):
            self._put(self._keys.work(lease.wid), lease.message(self.epoch), Channel.DATA)

    @property
    def is_ending(self) -> bool:
        """True: nothing is asked or leased; what was found is still recorded."""
        return self._stopped_at is not None

    def stop(self, now: float, reason: EndedEarly | None = None) -> None:
        """Stop asking and leasing, withdraw all leases, and start the wait for the recorder."""
        self._stopped_at, self.stop_reason, self.ends_at = now, reason, inf
        for run in self.runs:
            self._withdraw(run.name)
        for wid, builds in self.dispatcher.withdraw_builds().items():
            self._drop(wid, builds)

    def has_ended(self, now: float) -> bool:
        """True if a job that ends early may end now."""
        if self._stopped_at is None:
            return False
        is_safe = all(run.sink.is_empty for run in self.runs)  # all results are recorded
        return now >= self._stopped_at + (LEAST_STOP_SECONDS if is_safe else MOST_STOP_SECONDS)

    def obey(self, order: Order, now: float) -> str:
        """Carry an administrator's command out; returns what happened, or raises Refused.

        Commands decide when and where rows are evaluated, and have no say in what a run finds.
        """
        if self.is_ending:
            raise Refused(f"job '{self.job}' is ending already")
        match order.act:
            case "pause":
                return self._pause()
            case "continue":
                if not self.is_paused:
                    return f"Job '{self.job}' is not paused."
                self.is_paused = False
                return f"Job '{self.job}' goes on."
            case "cancel":
                self.stop(now, Cancelled(self.job))
                stays = "Recorded results stay: `qdgrasp resume DIR` (or `campaign`) goes on."
                return f"Job '{self.job}' ends. {stays}"
            case "drain":
                return self._drain(order)

    def _pause(self) -> str:
        if self.is_paused:
            return f"Job '{self.job}' is paused already; `qdgrasp continue {self.job}` has it go on."
        self.is_paused = True
        held = sum(len(worker.batches) for worker in self.workers)
        out = counted(held, "batch that is out still counts", "batches that are out still count")
        return f"Job '{self.job}' is paused: nothing is handed out; {out}."

    def _drain(self, order: Order) -> str:
        chosen = choose_workers(list(self.workers), order.worker, order.host, self.job)
        for worker in chosen:
            self.workers.drain(worker.wid)
            self._send_away(worker.wid)
        number = counted(len(chosen), "worker")
        return f"Asked {number} of job '{self.job}' to finish the batches at hand and leave."

    @property
    def state(self) -> str:
        """The job's state: starting, running, paused, ending or cancelled."""
        if self.is_cancelled:
            return "cancelled"
        if self.is_ending:
            return "ending"
        if self.is_paused:
            return "paused"
        return "running" if self.epoch else "starting"

    def status(self, now: float) -> JobStatus:
        """Return the job's figures."""
        figures = self.runs.status(
            now,
            self.dispatcher.trouble or self.workers.trouble,
            job=self.job,
            workers=len(self.workers),
            state=self.state,
            recorders=len(self._recorders),
            wanted_workers=self.dispatcher.wanted_workers(is_leasing=not (self.is_paused or self.is_ending)),
            strays=self.dispatcher.strays,
            **{name: self.dispatcher.counters[name] for name in COUNTERS_SHOWN},
        )
        return self._time_left.note(figures, self.workers.at_work, self.runs.shapes.under_way, now)
