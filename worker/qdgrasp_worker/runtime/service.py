"""The worker on the bus: join, evaluate, answer.

One thread does everything; callbacks of the bus, the simulator and errands only fill its inbox, and it waits
for nothing else. A worker has no state but caches: whatever it loses is evaluated again elsewhere, with the
same bytes.
"""

import os
import secrets
import signal
import socket
import time
from contextlib import ExitStack
from math import inf
from queue import Empty

import msgspec
import structlog

from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus, Channel, DropCounter, Sample
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.keys import AnyJob, Keys, job_of
from qdgrasp_protocol.messages import Control, Heartbeat, Work, shorten
from qdgrasp_protocol.process import Stop
from qdgrasp_worker.runtime.background_requests import (
    BackgroundRequests,
    CoordinatorSeen,
    Event,
    Inbox,
    JoinAnswered,
    LinkChanged,
    SceneAnswered,
    SceneCache,
    SceneStore,
    StopRequested,
)
from qdgrasp_worker.runtime.batch_queue import BatchProgress
from qdgrasp_worker.runtime.batch_runner import BatchRunner, GracefulShutdown
from qdgrasp_worker.runtime.job_registry import JobMembership, JobRegistry
from qdgrasp_worker.runtime.process_limits import process_stats
from qdgrasp_worker.runtime.simulator_supervisor import SimulatorEnded, SimulatorSaid, SimulatorSupervisor

log = structlog.get_logger()

HEARTBEAT_INTERVAL = 1.0  # seconds between two signs of progress


class WorkerService:
    """Serves the jobs on a bus until it is asked to stop.

    Parameters
    ----------
    bus
        An open session.
    workshop
        Evaluates; its news come to `inbox`.
    inbox
        What this service waits on.
    bundles
        Where scenes come from.
    job
        The only job to serve; None: every job there is.
    grace
        Seconds that the batch in work may still take after SIGTERM.
    """

    def __init__(
        self,
        bus: Bus,
        stop: Stop,
        workshop: SimulatorSupervisor,
        inbox: Inbox,
        *,
        bundles: SceneStore,
        job: str | None,
        grace: float,
    ) -> None:
        self.wid = secrets.token_hex(16)
        self._bus = bus
        self._stop = stop
        self._workshop = workshop
        self._inbox = inbox
        errands = BackgroundRequests(bus, bundles, inbox.put)
        self._jobs = JobRegistry()
        self._memberships = JobMembership(bus, errands, self._jobs, self.wid, job)
        self._keys = Keys(job) if job else AnyJob()
        self._leave = GracefulShutdown(grace)
        self._belt = BatchRunner(self._jobs, workshop, SceneCache(errands), self._leave, self._send)
        self._drops = DropCounter()
        self._sign_at = 0.0

    def run(self) -> None:
        """Serve until asked to stop.

        Raises
        ------
        RefusedByJob
            The only job to serve does not take this worker.
        NoSimulator, OtherPlatform
            Nothing can be evaluated here, or no longer.
        """
        self._stop.tell(lambda: self._inbox.put(StopRequested()))
        if self._stop.is_set:
            return
        with ExitStack() as stack:
            stack.enter_context(self._memberships)
            stack.enter_context(self._bus.subscribe(self._keys.work(self.wid), self._inbox.put))
            stack.enter_context(self._bus.subscribe(self._keys.ctl(self.wid), self._inbox.put))
            stack.enter_context(self._bus.on_link(lambda up: self._inbox.put(LinkChanged(up))))
            stack.enter_context(self._bus.watch(self._keys.coordinator_token(), self._met))
            while not self._leave.is_over(time.monotonic()):
                self._hear(self._patience(time.monotonic()))
                self._act(time.monotonic())

    def _act(self, now: float) -> None:
        """Do what is due."""
        self._workshop.tick(now)
        self._belt.feed(now)
        if self._leave.is_late(now):
            self._hand_back_all(now)
        if self._workshop.platform is not None:
            is_open = self._workshop.is_ready and not self._leave.has_begun
            self._memberships.join_due(now, self._workshop.platform, is_open=is_open)
        self._memberships.end_over(now)
        if self._memberships.leave_drained():
            self._leave.at_once()
        if now >= self._sign_at:
            self._sign_at = now + HEARTBEAT_INTERVAL
            self._give_sign()

    # Events come in.

    def _met(self, key: str, is_alive: bool) -> None:
        self._inbox.put(CoordinatorSeen(key, is_alive))

    def _patience(self, now: float) -> float | None:
        """Seconds to wait for the inbox; None: for ever."""
        join_at = inf if self._workshop.platform is None else self._jobs.next_join()
        sign_at = self._sign_at if self._jobs else inf
        end_at = self._jobs.next_end()
        first = min(join_at, end_at, self._leave.deadline, self._workshop.tick_at, sign_at)
        return None if first == inf else max(0.0, first - now)

    def _hear(self, patience: float | None) -> None:
        """Take everything out of the inbox, waiting at most `patience` seconds for the first."""
        try:
            self._take(self._inbox.get(timeout=patience), time.monotonic())
            while True:
                self._take(self._inbox.get_nowait(), time.monotonic())
        except Empty:
            return

    def _take(self, event: Event, now: float) -> None:
        match event:
            case Sample():
                self._read(event)
            case SimulatorSaid() | SimulatorEnded():
                self._belt.settle(self._workshop.hear(event, now), now)
            case SceneAnswered():
                self._belt.scene_came(event, now)
            case JoinAnswered():
                self._take_answer(event, now)
            case CoordinatorSeen(key, is_alive):
                self._memberships.meet(key, is_alive, now)
            case LinkChanged(is_up) if is_up:
                self._memberships.reconnected(now)
            case StopRequested():
                self._asked(now)

    def _read(self, sample: Sample) -> None:
        appointment = self._jobs.get(job_of(sample.key))
        if appointment is None or appointment.hold_up(sample):
            return
        desk = appointment.desk
        try:
            if sample.key == Keys(desk.job).work(self.wid):
                desk.accept(messages.decode_sample(sample, Work))
            else:
                desk.control(messages.decode_sample(sample, Control))
        except MessageError as error:
            self._drops.note(sample.key, error)

    def _take_answer(self, answered: JoinAnswered, now: float) -> None:
        for sample in self._memberships.answered(answered, now):
            self._read(sample)
        appointment = self._jobs.get(answered.job)
        if appointment is None or not appointment.credit:
            self._leave.heard(answered.job)

    def _asked(self, now: float) -> None:
        """Leave: after SIGTERM with the batch in work if that fits, after SIGINT, before or then, at once."""
        if self._stop.latest != signal.SIGTERM:
            self._leave.at_once()
        elif not self._leave.has_begun:
            self._leave.begin(self._belt.head, now)
            self._hand_back_all(now)

    def _hand_back_all(self, now: float) -> None:
        """Hand all batches back but the one that is to be finished in time."""
        if self._leave.is_late(now):
            self._leave.kept = None
        kept = self._leave.kept
        for appointment in self._jobs:
            if appointment.alive and appointment.desk.held:
                appointment.desk.hand_back(keep=kept.work.batch if kept else None)
                appointment.join_soon(now)
                self._leave.tell(appointment.desk.job)

    # Messages are sent.

    def _send(self, task: BatchProgress) -> None:
        result = task.result(self.wid)
        key = Keys(task.job).result(self.wid)
        self._bus.put(key, messages.encode(result), encoding=messages.encoding(type(result)))

    def _give_sign(self) -> None:
        """Show how this worker is, and whether the batch in work goes on: so its lease does not pass."""
        head, moved = self._workshop.head, self._workshop.look()
        sign = Heartbeat(
            wid=self.wid,
            host=shorten(socket.gethostname()),
            run=head.work.run if head else "",
            rows=head.work.n if head else 0,
            progressed=moved and head is not None,
            memory=self._workshop.memory + process_stats(os.getpid()).memory,
            restarts=self._workshop.restarts,
        )
        for appointment in self._jobs:
            key = Keys(appointment.desk.job).stat(f"worker/{self.wid}")
            payload = msgspec.json.encode(sign)
            self._bus.put(key, payload, encoding="application/json", channel=Channel.MONITOR)
