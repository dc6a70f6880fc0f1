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

from qdgrasp_protocol import codec
from qdgrasp_protocol.bus import Bus, Channel, Sample
from qdgrasp_protocol.drops import Drops
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.keys import AnyJob, Keys, job_of
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.messages import Control, Work, short
from qdgrasp_protocol.sign import Sign
from qdgrasp_worker.serving.belt import Belt
from qdgrasp_worker.serving.bundles import Bundles
from qdgrasp_worker.serving.errands import Answered, Errands, Fetched
from qdgrasp_worker.serving.events import Asked, CoordinatorSeen, Event, Inbox, LinkChanged
from qdgrasp_worker.serving.leave import Leave
from qdgrasp_worker.serving.memberships import Memberships
from qdgrasp_worker.serving.rota import Rota
from qdgrasp_worker.serving.scenes import Scenes
from qdgrasp_worker.serving.simulator import Ended, Heard
from qdgrasp_worker.serving.task import Task
from qdgrasp_worker.serving.vitals import vitals
from qdgrasp_worker.serving.workshop import Workshop

log = structlog.get_logger()

SIGN_INTERVAL = 1.0  # seconds between two signs of progress


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
        workshop: Workshop,
        inbox: Inbox,
        *,
        bundles: Bundles,
        job: str | None,
        grace: float,
    ) -> None:
        self.wid = secrets.token_hex(16)
        self._bus = bus
        self._stop = stop
        self._workshop = workshop
        self._inbox = inbox
        errands = Errands(bus, bundles, inbox.put)
        self._jobs = Rota()
        self._memberships = Memberships(bus, errands, self._jobs, self.wid, job)
        self._keys = Keys(job) if job else AnyJob()
        self._leave = Leave(grace)
        self._belt = Belt(self._jobs, workshop, Scenes(errands), self._leave, self._send)
        self._drops = Drops()
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
        self._stop.tell(lambda: self._inbox.put(Asked()))
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
            self._sign_at = now + SIGN_INTERVAL
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
            case Heard() | Ended():
                self._belt.settle(self._workshop.hear(event, now), now)
            case Fetched():
                self._belt.scene_came(event, now)
            case Answered():
                self._take_answer(event, now)
            case CoordinatorSeen(key, is_alive):
                self._memberships.meet(key, is_alive, now)
            case LinkChanged(is_up) if is_up:
                self._memberships.reconnected(now)
            case Asked():
                self._asked(now)

    def _read(self, sample: Sample) -> None:
        appointment = self._jobs.get(job_of(sample.key))
        if appointment is None or appointment.hold_up(sample):
            return
        desk = appointment.desk
        try:
            if sample.key == Keys(desk.job).work(self.wid):
                desk.accept(codec.decoded(sample, Work))
            else:
                desk.control(codec.decoded(sample, Control))
        except MessageError as error:
            self._drops.note(sample.key, error)

    def _take_answer(self, answered: Answered, now: float) -> None:
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

    def _send(self, task: Task) -> None:
        result = task.result(self.wid)
        key = Keys(task.job).result(self.wid)
        self._bus.put(key, codec.encode(result), encoding=codec.encoding(type(result)))

    def _give_sign(self) -> None:
        """Show how this worker is, and whether the batch in work goes on: so its lease does not pass."""
        head, moved = self._workshop.head, self._workshop.look()
        sign = Sign(
            wid=self.wid,
            host=short(socket.gethostname()),
            run=head.work.run if head else "",
            rows=head.work.n if head else 0,
            progressed=moved and head is not None,
            memory=self._workshop.memory + vitals(os.getpid()).memory,
            restarts=self._workshop.restarts,
        )
        for appointment in self._jobs:
            key = Keys(appointment.desk.job).stat(f"worker/{self.wid}")
            payload = msgspec.json.encode(sign)
            self._bus.put(key, payload, encoding="application/json", channel=Channel.MONITOR)
