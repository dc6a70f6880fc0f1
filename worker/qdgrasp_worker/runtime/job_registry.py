"""The jobs that a worker serves: its joins, the batches it was leased, and whose turn it is.

Rules 2 and 3 of docs/bus.md. `JobSession`, `JoinState` and `JobRegistry` are pure: no bus, no clock; time is
passed in, in seconds of any steady clock. `JobMembership` meets coordinators, joins their jobs and leaves
them.
"""

import os
import random
import socket
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from math import inf
from typing import Self

import structlog

from qdgrasp_protocol.bus import Bus, Sample
from qdgrasp_protocol.errors import Refused
from qdgrasp_protocol.keys import Keys, job_of, last_chunk, parse_number
from qdgrasp_protocol.messages import VERSION, Control, Join, Joined, Work
from qdgrasp_worker.runtime.background_requests import BackgroundRequests, JoinAnswered


class JobSession:
    """One job at this worker.

    Work counts only if it belongs to the epoch and to the join that are in force (docs/bus.md, rule 3):
    without this fence, batches that were re-queued while the link was down would be evaluated twice.
    """

    def __init__(self, job: str) -> None:
        self.job = job
        self.epoch = -1
        self.number = 0
        self.is_orphaned = False
        """Its coordinator is gone; whoever comes next may count epochs anew."""
        self.is_draining = False
        """Its coordinator asked this worker to finish what it holds, and to leave."""
        self.dropped = 0
        self._held: OrderedDict[bytes, Work] = OrderedDict()
        self._begun: set[bytes] = set()

    @property
    def held(self) -> list[bytes]:
        """The batches that are leased and not yet answered, in the order they came."""
        return list(self._held)

    @property
    def has_joined(self) -> bool:
        """A coordinator that is there has let this worker in."""
        return self.epoch >= 0 and not self.is_orphaned

    def joining(self) -> int:
        """Begin another join; returns its number."""
        self.number += 1
        return self.number

    def joined(self, answer: Joined) -> bool:
        """Take the answer to a join; False when it comes from an older coordinator than the one known."""
        if answer.epoch < self.epoch and not self.is_orphaned:
            return False
        if answer.epoch != self.epoch:
            self._held.clear()
            self.is_draining = False
        self.epoch = answer.epoch
        self.is_orphaned = False
        self._drop(answer.drop)
        return True

    def follows(self, epoch: int) -> bool:
        """Whether a coordinator of this epoch may be joined."""
        return epoch >= self.epoch or self.is_orphaned

    def accept(self, work: Work) -> bool:
        """Take a leased batch; False when it is of another epoch or of an older join."""
        if work.epoch != self.epoch or work.join != self.number:
            self.dropped += 1
            return False
        self._held[work.batch] = work
        return True

    def control(self, message: Control) -> None:
        """Drop the batches that the coordinator takes back, and begin to leave where it asks for that."""
        if message.epoch == self.epoch:
            self._drop(message.drop)
            self.is_draining |= message.drain

    def holds(self, batch: bytes) -> bool:
        """Whether the result of a batch is waited for."""
        return batch in self._held

    @property
    def waiting(self) -> list[Work]:
        """The batches that are held and not begun, in the order they came."""
        return [work for batch, work in self._held.items() if batch not in self._begun]

    def next(self) -> Work | None:
        """The batch to begin now; None: none waits."""
        return next(iter(self.waiting), None)

    def begin(self) -> Work | None:
        """The batch to begin now, as begun; it stays held until it is answered or released."""
        work = self.next()
        if work is not None:
            self._begun.add(work.batch)
        return work

    def release(self, batch: bytes) -> None:
        """Forget a batch: its result is sent, or cannot be had here."""
        self._held.pop(batch, None)
        self._begun.discard(batch)

    def hand_back(self, keep: bytes | None) -> None:
        """Forget all batches but one; the next join, which lists what is held, has others evaluate them."""
        self._drop([batch for batch in self._held if batch != keep])

    def _drop(self, batches: list[bytes]) -> None:
        for batch in batches:
            self._held.pop(batch, None)


ABANDON_SECONDS = (
    60.0  # seconds without a coordinator after which an appointment is over, once nothing is held
)
RETRY_FIRST, RETRY_LAST = 0.05, 2.0
"""Seconds between tries to join, before jitter."""


class JoinState:
    """A job at this worker: its desk, and when to try to join next."""

    def __init__(self, job: str) -> None:
        self.desk = JobSession(job)
        self._there: set[int] = set()
        self._left_at = 0.0
        self.credit = 0
        """The credit that was asked for last."""
        self.is_asking = False
        """A join is under way."""
        self._is_refused = False
        self._patience = RETRY_FIRST
        self._join_at: float | None = None
        self._held_up: list[Sample] = []

    @property
    def alive(self) -> bool:
        """Whether a coordinator that it may follow is there."""
        return any(self.desk.follows(epoch) for epoch in self._there)

    @property
    def ends_at(self) -> float:
        """When it is over, as nobody is there and nothing is held; infinite: it goes on."""
        return inf if self._there or self.desk.held else self._left_at + ABANDON_SECONDS

    @property
    def join_at(self) -> float | None:
        """When to ask to join; None: there is no need, or nobody to ask."""
        return self._join_at if self.alive and not self.is_asking else None

    @property
    def has_share(self) -> bool:
        """Whether this job has a share of the worker."""
        return self.alive and not self._is_refused and not self.desk.is_draining

    @property
    def is_dismissed(self) -> bool:
        """The last coordinator that there is asked this worker to leave, and nothing is held any more."""
        is_last = max(self._there, default=-1) <= self.desk.epoch
        return self.desk.is_draining and is_last and not self.desk.held

    def is_due(self, now: float) -> bool:
        """Whether it is to be asked now."""
        return self.join_at is not None and self.join_at <= now

    def meet(self, epoch: int, alive: bool, now: float) -> None:
        """Hear that a coordinator's token is there, or is gone."""
        (self._there.add if alive else self._there.discard)(epoch)
        self._left_at = now
        is_left = not alive and epoch == self.desk.epoch
        self.desk.is_orphaned |= is_left
        if is_left or (alive and self.desk.follows(epoch)):
            self.join_soon(now)  # where it is left, whoever else is there: it may have answered for that one

    def join_soon(self, now: float) -> None:
        """Ask to join, again if need be: the link is new, or the worker is to be known otherwise."""
        self._is_refused = False
        self._patience = RETRY_FIRST
        self._join_at = now

    def join_later(self, now: float, jitter: float) -> None:
        """Ask to join, after a time that doubles, times the jitter."""
        self._join_at = now + self._patience * jitter
        self._patience = min(2 * self._patience, RETRY_LAST)

    def set_credit(self, credit: int, now: float) -> None:
        """Ask to join again if the credit is another one than was asked for last."""
        if self.desk.has_joined and not self._is_refused and credit != self.credit:
            self.join_soon(now)

    def ask(self, credit: int) -> int:
        """Begin a join; gives its number."""
        self.is_asking = True
        self.credit = credit
        self._join_at = None
        return self.desk.joining()

    def hold_up(self, sample: Sample) -> bool:
        """Keep a message that came while a join is under way: its answer decides what that is worth."""
        if self.is_asking:
            self._held_up.append(sample)
        return self.is_asking

    def let_go(self) -> list[Sample]:
        """The messages that were kept, in their order."""
        samples, self._held_up = self._held_up, []
        return samples

    def answered(self, answer: Joined, now: float, jitter: float) -> bool:
        """Take the answer to a join; False when it comes from an older coordinator than the one known.

        The one that is known has not heard of this join then, and what it leases would not be taken: ask it
        again, after a time that doubles, times the jitter.
        """
        self.is_asking = False
        is_current = self.desk.joined(answer)
        if is_current:
            self._patience = RETRY_FIRST
        else:
            self.join_later(now, jitter)
        self.desk.is_orphaned |= answer.epoch == self.desk.epoch and answer.epoch not in self._there
        return is_current

    def unanswered(self, now: float, jitter: float) -> None:
        """Hear that nobody answered: ask again later, after a time that doubles, times the jitter."""
        self.is_asking = False
        self.join_later(now, jitter)

    def refused(self) -> None:
        """Hear that the job does not take this worker: ask no more until something changes."""
        self.is_asking = False
        self._is_refused = True


CREDIT = 2
"""Batches outstanding at a worker, split among its jobs: one in work, one waiting. Each has one at least."""


class JobRegistry:
    """The appointments of a worker, by job."""

    def __init__(self) -> None:
        self._jobs: dict[str, JoinState] = {}
        self._number = 0
        """The highest number of a join to a job that is served no more: numbers go on from there."""

    def __iter__(self) -> Iterator[JoinState]:
        return iter(list(self._jobs.values()))

    def __bool__(self) -> bool:
        """Whether any job is served."""
        return bool(self._jobs)

    def get(self, job: str | None) -> JoinState | None:
        """The appointment with a job; None: there is none."""
        return self._jobs.get(job or "")

    def add(self, job: str) -> JoinState:
        """Begin to serve a job."""
        appointment = self._jobs[job] = JoinState(job)
        appointment.desk.number = self._number
        return appointment

    def end(self, job: str) -> None:
        """Serve a job no more."""
        self._number = max(self._number, self._jobs.pop(job).desk.number)

    @property
    def share(self) -> int:
        """The credit of each job."""
        return max(1, CREDIT // max(1, sum(appointment.has_share for appointment in self)))

    def turn(self, is_servable: Callable[[JobSession], bool]) -> JobSession | None:
        """The desk whose turn it is, of those that can be served now; its next turn is the last."""
        for job, appointment in self._jobs.items():
            if is_servable(appointment.desk):
                self._jobs[job] = self._jobs.pop(job)
                return appointment.desk
        return None

    def next_join(self) -> float:
        """When the next try to join is due; infinite: nothing is to be tried."""
        times = (appointment.join_at for appointment in self)
        return min((time for time in times if time is not None), default=inf)

    def next_end(self) -> float:
        """When the next appointment is over; infinite: all go on."""
        return min((appointment.ends_at for appointment in self), default=inf)


log = structlog.get_logger()


class RefusedByJob(Refused):
    """The only job this worker was meant for does not take it."""

    exit_code = 2

    def __init__(self, job: str, reason: object) -> None:
        super().__init__(f"Job '{job}' does not take this worker: {reason}")


class JobMembership:
    """What a worker is to the jobs on a bus; a context manager that hands its tokens in.

    Parameters
    ----------
    jobs
        The appointments, which are kept up here.
    only
        The only job to serve; None: every job there is.
    """

    def __init__(
        self, bus: Bus, errands: BackgroundRequests, jobs: JobRegistry, wid: str, only: str | None
    ) -> None:
        self._bus = bus
        self._errands = errands
        self._jobs = jobs
        self._wid = wid
        self._only = only
        self._tokens: dict[str, AbstractContextManager[None]] = {}
        self._left: dict[str, int] = {}
        """The epochs of coordinators that drained this worker, and are there, by job."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for job in list(self._tokens):
            self._hand_in(job)

    def meet(self, key: str, is_alive: bool, now: float) -> None:
        """Note that a job's coordinator is there, or is gone, by its token."""
        job, token = job_of(key), last_chunk(key)
        epoch = parse_number(token)
        if job is None or epoch is None:
            return
        appointment = self._jobs.get(job)
        left = self._left.get(job, -1)
        if epoch > left or (epoch == left and not is_alive):
            self._left.pop(job, None)
        if is_alive and appointment is None and epoch > left:
            appointment = self._open(job)
        if appointment is not None:
            appointment.meet(epoch, is_alive, now)

    def reconnected(self, now: float) -> None:
        """Hear that the link is up again: coordinators may have given this worker up."""
        for appointment in self._jobs:
            appointment.join_soon(now)

    def join_due(self, now: float, platform: dict[str, str], *, is_open: bool) -> None:
        """Join what is to be joined; a worker that is not open asks for no work."""
        for appointment in self._jobs:
            credit = self._jobs.share if is_open and not appointment.desk.is_draining else 0
            appointment.set_credit(credit, now)
            if appointment.is_due(now):
                self._join(appointment, credit, platform)

    def _join(self, appointment: JoinState, credit: int, platform: dict[str, str]) -> None:
        desk = appointment.desk
        request = Join(
            versions=[VERSION],
            wid=self._wid,
            number=appointment.ask(credit),
            credit=credit,
            held=desk.held,
            host=socket.gethostname(),
            pid=os.getpid(),
            platform=platform,
        )
        self._errands.join(desk.job, request)

    def answered(self, answered: JoinAnswered, now: float) -> list[Sample]:
        """Hear whether a job takes this worker; gives the messages that waited for this.

        Raises
        ------
        RefusedByJob
            It does not, and is the only one to serve.
        """
        appointment = self._jobs.get(answered.job)
        if appointment is None or answered.number != appointment.desk.number:
            return []
        desk, epoch = appointment.desk, appointment.desk.epoch
        match answered.answer:
            case Joined() as answer:
                if appointment.answered(answer, now, jitter()) and desk.epoch != epoch:
                    log.info("joined", job=desk.job, epoch=desk.epoch, worker=self._wid[:8])
            case Refused() as reason:
                appointment.refused()
                log.error("a job does not take this worker", job=desk.job, reason=str(reason))
                if self._only:
                    raise RefusedByJob(desk.job, reason)
            case _:
                appointment.unanswered(now, jitter())
        return appointment.let_go()

    def leave_drained(self) -> bool:
        """Leave the jobs whose coordinators asked for that, once nothing of them is held.

        Gives whether that ends this worker: there is no other job for it.
        """
        is_last = False
        for appointment in self._jobs:
            desk = appointment.desk
            if appointment.is_dismissed:
                log.info("left a job, as its coordinator asked", job=desk.job)
                if not desk.is_orphaned:
                    self._left[desk.job] = desk.epoch
                self._close(desk.job)
                is_last = self._only is not None
        return is_last

    def end_over(self, now: float) -> None:
        """End the appointments with jobs that have had no coordinator for long."""
        for appointment in self._jobs:
            if now >= appointment.ends_at:
                log.info("a job has no coordinator any more", job=appointment.desk.job)
                self._close(appointment.desk.job)

    def _open(self, job: str) -> JoinState:
        self._tokens[job] = self._bus.token(Keys(job).worker_token(self._wid))
        return self._jobs.add(job)

    def _close(self, job: str) -> None:
        self._jobs.end(job)
        self._hand_in(job)

    def _hand_in(self, job: str) -> None:
        self._tokens.pop(job).__exit__(None, None, None)


def jitter() -> float:
    """By how much a pause is stretched, so that not all workers ask at once: 0.5 to 1.5."""
    return random.uniform(0.5, 1.5)  # noqa: S311  # nothing is kept secret by it
