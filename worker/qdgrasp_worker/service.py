"""The worker on the bus: join, evaluate, answer.

One thread does everything; callbacks of the bus only fill its inbox. A worker has no state but caches:
whatever it loses is evaluated again elsewhere, with the same bytes.
"""

import json
import os
import random
import secrets
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from queue import Empty, SimpleQueue

import numpy as np
import structlog

from qdgrasp_assets.scene import unpack_scene
from qdgrasp_protocol import codec
from qdgrasp_protocol.bus import Bus, Channel, Sample
from qdgrasp_protocol.errors import BusError, InputError, MessageError, NoReply, Refused
from qdgrasp_protocol.keys import AnyJob, Keys, job_of, last_chunk
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.messages import (
    VERSION,
    Control,
    Failure,
    Join,
    Joined,
    Message,
    Result,
    Work,
    short,
)
from qdgrasp_protocol.rows import COLUMNS, RESULT, Rows, Shape, pack, unpack
from qdgrasp_worker.bundles import Bundles
from qdgrasp_worker.evaluate import Evaluator
from qdgrasp_worker.serving.appointment import Appointment
from qdgrasp_worker.worlds import Worlds

log = structlog.get_logger()

CREDIT = 2
"""Batches outstanding at a worker: one in work, one waiting."""
SLICE = 16
"""Rows evaluated between two looks at the inbox; evaluation is pure, so slicing changes nothing."""
STAT_INTERVAL = 1.0  # seconds between two signs of progress
WORK_COLUMNS = [column for column in COLUMNS if column.name in ("index", "trial", "genome")]


@dataclass(frozen=True)
class Coordinator:
    """A coordinator's token appeared or vanished."""

    key: str
    alive: bool


@dataclass(frozen=True)
class Link:
    """A transport of this session came up or went down."""

    up: bool


class RefusedByJob(Refused):
    """The only job this worker was meant for does not take it."""

    exit_code = 2


class WorkerService:
    """Serves the jobs on a bus until it is asked to stop.

    Parameters
    ----------
    bus
        An open session.
    job
        The only job to serve; None: every job there is.
    platform
        What decides the bits of this worker's results (docs/reproducibility.md).
    bundles
        Where scenes come from.
    """

    def __init__(
        self, bus: Bus, stop: Stop, *, job: str | None, platform: dict[str, str], bundles: Bundles
    ) -> None:
        self.wid = secrets.token_hex(16)
        self._bus = bus
        self._stop = stop
        self._only = job
        self._platform = platform
        self._bundles = bundles
        self._worlds = Worlds()
        self._jobs: dict[str, Appointment] = {}
        self._tokens = ExitStack()
        self._shown = 0.0
        self._inbox: SimpleQueue[Sample | Coordinator | Link | None] = SimpleQueue()

    def run(self) -> None:
        """Serve until asked to stop."""
        keys = Keys(self._only) if self._only else AnyJob()
        self._stop.tell(lambda: self._inbox.put(None))
        with ExitStack() as stack:
            stack.enter_context(self._worlds)
            stack.enter_context(self._tokens)
            stack.enter_context(self._bus.subscribe(keys.work(self.wid), self._inbox.put))
            stack.enter_context(self._bus.subscribe(keys.ctl(self.wid), self._inbox.put))
            stack.enter_context(self._bus.on_link(lambda up: self._inbox.put(Link(up))))
            stack.enter_context(self._bus.watch(keys.coordinator_token(), self._met))
            while not self._stop.is_set:
                self._hear(self._patience())
                self._join_due()
                for appointment in list(self._jobs.values()):
                    self._serve(appointment)

    def _met(self, key: str, alive: bool) -> None:
        self._inbox.put(Coordinator(key, alive))

    def _patience(self) -> float | None:
        """Seconds to wait for the inbox: none while there is work, else until the next try to join."""
        if any(job.desk.next() for job in self._jobs.values()):
            return 0.0
        due = [job.join_at for job in self._jobs.values() if job.join_at is not None]
        return max(0.0, min(due) - time.monotonic()) if due else None

    def _hear(self, patience: float | None) -> None:
        """Take everything out of the inbox, waiting at most `patience` seconds for the first."""
        try:
            self._take(self._inbox.get(timeout=patience))
            while True:
                self._take(self._inbox.get_nowait())
        except Empty:
            return

    def _take(self, event: Sample | Coordinator | Link | None) -> None:
        match event:
            case Coordinator(key, alive):
                self._meet(job_of(key), last_chunk(key), alive)
            case Link(up) if up:
                for appointment in self._jobs.values():
                    appointment.join_soon(time.monotonic())
            case Sample():
                self._read(event)

    def _meet(self, job: str | None, token: str, alive: bool) -> None:
        """Note that a job's coordinator is there, or is gone."""
        if job is None or not (token.isascii() and token.isdigit()):
            return
        appointment = self._jobs.get(job) or self._open(job)
        appointment.meet(int(token), alive, time.monotonic())

    def _open(self, job: str) -> Appointment:
        appointment = self._jobs[job] = Appointment(job)
        self._tokens.enter_context(self._bus.token(Keys(job).worker_token(self.wid)))
        return appointment

    def _read(self, sample: Sample) -> None:
        appointment = self._jobs.get(job_of(sample.key) or "")
        if appointment is None:
            return
        desk = appointment.desk
        try:
            if sample.encoding == codec.encoding(Work):
                desk.accept(codec.decode(sample.payload, Work))
            elif sample.encoding == codec.encoding(Control):
                desk.control(codec.decode(sample.payload, Control))
        except MessageError as error:
            log.warning("dropped a message that is not of the protocol", key=sample.key, reason=str(error))

    def _join_due(self) -> None:
        now = time.monotonic()
        for appointment in self._jobs.values():
            if appointment.is_due(now):
                self._join(appointment)

    def _join(self, appointment: Appointment) -> None:
        """Ask to serve a job; try again later when nobody answers."""
        desk = appointment.desk
        keys = Keys(desk.job)
        request = Join(
            versions=[VERSION],
            wid=self.wid,
            number=desk.joining(),
            credit=CREDIT,
            held=desk.held,
            host=socket.gethostname(),
            pid=os.getpid(),
            platform=self._platform,
        )
        try:
            answer = codec.decode(self._bus.ask(keys.join, codec.encode(request), timeout=2.0), Joined)
        except (NoReply, MessageError):
            appointment.unanswered(time.monotonic(), random.uniform(0.5, 1.5))  # noqa: S311 - jitter, no secret
            return
        except Refused as refusal:
            appointment.refused()
            log.error("a job does not take this worker", job=desk.job, reason=str(refusal))
            if self._only:
                raise RefusedByJob(f"Job '{desk.job}' does not take this worker: {refusal}") from None
            return
        if appointment.answered(answer):
            log.info("joined", job=desk.job, epoch=desk.epoch, worker=self.wid[:8])

    def _serve(self, appointment: Appointment) -> None:
        """Evaluate one batch of a job and send its result."""
        desk = appointment.desk
        work = desk.next()
        if work is None:
            return
        try:
            result = self._result(desk.job, work)
        except BusError as error:
            log.warning("handed a batch back", job=desk.job, reason=str(error))
            desk.release(work.batch)
            appointment.join_soon(time.monotonic())
            return
        if result is None or work.batch not in desk.held:
            return
        self._put(Keys(desk.job).result(self.wid), result)
        desk.release(work.batch)

    def _result(self, job: str, work: Work) -> Result | None:
        """What a batch found; where this worker cannot evaluate it at all, every row failed for that reason.

        Raises
        ------
        NoReply, Refused
            The scene cannot be had now.
        """
        try:
            return self._evaluate(self._evaluator(job, work.scene), work)
        except (InputError, MessageError) as error:
            log.warning("a batch cannot be evaluated here", job=job, reason=str(error))
            return failed(work, self.wid, str(error))

    def _evaluator(self, job: str, digest: str) -> Evaluator:
        def load() -> Evaluator:
            return Evaluator(unpack_scene(self._bundles.bundle(self._bus, job, digest)))

        return self._worlds.get(digest, load)

    def _evaluate(self, evaluator: Evaluator, work: Work) -> Result | None:
        """Evaluate a batch, slice by slice; None when this process is asked to stop on the way."""
        shape = evaluator.shape(work.prior)
        if work.genes != shape.genes:
            raise MessageError(f"the batch has {work.genes} genes, this scene has {shape.genes}")
        rows = unpack(shape.empty(work.n), WORK_COLUMNS, work.columns, shape)
        failures: list[Failure] = []
        began = time.process_time()
        for place in slices(work.n):
            self._hear(0.0)
            self._show_progress(work)
            if self._stop.is_set:
                return None
            part = evaluator.evaluate(work.prior, rows["genome"][place], rows["trial"][place])
            _copy_results(part.rows, rows[place])
            failures += [
                Failure(row=place.start + row, reason=short(reason)) for row, reason in part.failures
            ]
        seconds = time.process_time() - began
        return answer(work, self.wid, shape, pack(rows, RESULT), seconds, failures)

    def _show_progress(self, work: Work) -> None:
        """Show, about once a second, that a long batch goes on; so its lease does not pass."""
        now = time.monotonic()
        if now < self._shown + STAT_INTERVAL:
            return
        self._shown = now
        figures = {"wid": self.wid, "host": socket.gethostname(), "run": work.run, "rows": work.n}
        payload = json.dumps(figures).encode()
        for job in self._jobs:
            key = Keys(job).stat(f"worker/{self.wid}")
            self._bus.put(key, payload, encoding="application/json", channel=Channel.MONITOR)

    def _put(self, key: str, message: Message) -> None:
        self._bus.put(key, codec.encode(message), encoding=codec.encoding(type(message)))


def failed(work: Work, wid: str, reason: str) -> Result:
    """The result of a batch of which no row can be evaluated."""
    failures = [Failure(row=row, reason=short(reason)) for row in range(work.n)]
    return answer(work, wid, Shape(work.genes, joints=0, descriptors=0), {}, 0.0, failures)


def answer(
    work: Work, wid: str, shape: Shape, columns: dict[str, bytes], seconds: float, failures: list[Failure]
) -> Result:
    """The result of a batch: what it found, what that cost [CPU s], and which rows failed."""
    return Result(
        epoch=work.epoch,
        run=work.run,
        generation=work.generation,
        batch=work.batch,
        attempt=work.attempt,
        wid=wid,
        n=work.n,
        joints=shape.joints,
        descriptors=shape.descriptors,
        columns=columns,
        cpu_seconds=seconds,
        failures=failures,
    )


def slices(n: int) -> Iterator[slice]:
    """Cut n rows into pieces of `SLICE`."""
    for start in range(0, n, SLICE):
        yield slice(start, min(start + SLICE, n))


def _copy_results(source: Rows, target: Rows) -> None:
    for column in RESULT:
        target[column.name] = np.asarray(source[column.name])
