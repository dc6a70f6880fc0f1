"""The jobs of a worker: joining and leaving them, the batches held, and the next to serve.

Rules 2 and 3 of docs/bus.md. `JobSession` is pure: no bus, no clock; time is passed in, in seconds of any
steady clock. `JobRegistry` opens sessions as coordinators appear, and joins and leaves jobs on the bus.
"""

import random
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from math import inf
from typing import Self, TypeVar

import msgspec
import structlog

from qdgrasp_protocol.build_messages import Build
from qdgrasp_protocol.bus import Bus, Sample
from qdgrasp_protocol.errors import Refused
from qdgrasp_protocol.keys import Keys, job_of, last_chunk, parse_number
from qdgrasp_protocol.messages import Control, Join, Joined, Work
from qdgrasp_worker.runtime.background_tasks import BackgroundRequests, JoinAnswered

ABANDON_SECONDS = 60.0  # Seconds without a coordinator after which a job without held batches is closed
AnyWork = TypeVar("AnyWork", Work, Build)
RETRY_FIRST, RETRY_LAST = 0.05, 2.0  # Seconds between tries to join, before jitter


class JobSession:
    """One job at this worker: the batches that it holds, and when to ask to join.

    Work counts only if it belongs to the epoch and to the join that are in force (docs/bus.md, rule 3):
    without this fence, batches that were re-queued while the link was down would be evaluated twice.
    """

    def __init__(self, job: str, number: int = 0) -> None:
        self.job = job
        self.epoch = -1
        self.number = number
        """The number of the last join."""
        self.credit = 0
        """The credit that was asked for last."""
        self.is_asking = False
        """A join is under way."""
        self.is_orphaned = False
        """Its coordinator is gone; the next one may count epochs anew."""
        self.is_draining = False
        """Its coordinator asked this worker to finish what it holds, and to leave."""
        self._held: dict[bytes, Work | Build] = {}
        self._begun: set[bytes] = set()
        self._coordinators: set[int] = set()  # Epochs of the present coordinators
        self._left_at = 0.0
        self._is_refused = False
        self._retry_pause = RETRY_FIRST
        self._join_at = inf
        self._deferred: list[Sample] = []

    @property
    def held(self) -> list[bytes]:
        """The batches that are leased and not yet answered, in the order they came."""
        return list(self._held)

    @property
    def has_coordinator(self) -> bool:
        """True if a coordinator that this worker may follow is there."""
        return any(self.follows(epoch) for epoch in self._coordinators)

    @property
    def ends_at(self) -> float:
        """The time at which it is given up, without coordinator or batch; infinite: it goes on."""
        return inf if self._coordinators or self._held else self._left_at + ABANDON_SECONDS

    @property
    def join_at(self) -> float:
        """The time to ask to join; infinite: there is no need, or no coordinator to ask."""
        return self._join_at if self.has_coordinator and not self.is_asking else inf

    @property
    def has_share(self) -> bool:
        """True if this job has a share of the worker."""
        return self.has_coordinator and not self._is_refused and not self.is_draining

    @property
    def is_drained(self) -> bool:
        """True if the latest coordinator asked this worker to leave, and no batch is held any more."""
        is_last = max(self._coordinators, default=-1) <= self.epoch
        return self.is_draining and is_last and not self._held

    def follows(self, epoch: int) -> bool:
        """Return whether a coordinator of this epoch may be joined."""
        return epoch >= self.epoch or self.is_orphaned

    def on_coordinator(self, epoch: int, is_alive: bool, now: float) -> None:
        """Note that a coordinator's token is there, or is gone."""
        (self._coordinators.add if is_alive else self._coordinators.discard)(epoch)
        self._left_at = now
        is_left = not is_alive and epoch == self.epoch
        self.is_orphaned |= is_left
        if is_left or (is_alive and self.follows(epoch)):
            self.join_soon(now)  # also where another one is there: it may have answered for the one that left

    def join_soon(self, now: float) -> None:
        """Ask to join, again if needed: the link is new, or the worker's join has changed."""
        self._is_refused = False
        self._retry_pause = RETRY_FIRST
        self._join_at = now

    def join_later(self, now: float, jitter: float) -> None:
        """Ask to join, after a time that doubles, times the jitter."""
        self._join_at = now + self._retry_pause * jitter
        self._retry_pause = min(2 * self._retry_pause, RETRY_LAST)

    def set_credit(self, credit: int, now: float) -> None:
        """Ask to join again if the credit differs from the one asked for last."""
        has_joined = self.epoch >= 0 and not self.is_orphaned
        if has_joined and not self._is_refused and credit != self.credit:
            self.join_soon(now)

    def ask(self, credit: int) -> int:
        """Begin another join; returns its number."""
        self.is_asking = True
        self.credit = credit
        self._join_at = inf
        self.number += 1
        return self.number

    def on_answer(self, answer: Joined, now: float, jitter: float) -> bool:
        """Take the answer to a join; False if it is of an older coordinator than the one known.

        The known one has then not received this join, and its leases would not be accepted: ask it again,
        after a time that doubles, times the jitter. The same holds where the coordinator that answered is
        gone by now, and another one is there.
        """
        self.is_asking = False
        is_current = self.follows(answer.epoch)
        if is_current:
            if answer.epoch != self.epoch:
                self._held.clear()
                self.is_draining = False
            self.epoch = answer.epoch
            self.is_orphaned = answer.epoch not in self._coordinators
            self._drop(answer.drop)
        if is_current and not self.is_orphaned:
            self._retry_pause = RETRY_FIRST
        else:
            self.join_later(now, jitter)
        return is_current

    def on_no_answer(self, now: float, jitter: float) -> None:
        """Ask again later, as no coordinator answered."""
        self.is_asking = False
        self.join_later(now, jitter)

    def on_refusal(self) -> None:
        """Ask no more until something changes: the job does not take this worker."""
        self.is_asking = False
        self._is_refused = True

    def defer(self, sample: Sample) -> bool:
        """Keep a message that came while a join is under way: the answer decides whether it counts."""
        if self.is_asking:
            self._deferred.append(sample)
        return self.is_asking

    def take_deferred(self) -> list[Sample]:
        """Return the messages that were kept, in their order, and forget them."""
        samples, self._deferred = self._deferred, []
        return samples

    def accept(self, work: Work | Build) -> bool:
        """Take a leased batch or build; False when it is of another epoch or of an older join."""
        if work.epoch != self.epoch or work.join != self.number:
            return False
        self._held[work.batch] = work
        return True

    def on_control(self, message: Control) -> None:
        """Drop the batches that the coordinator takes back; begin to leave if it asks for that."""
        if message.epoch == self.epoch:
            self._drop(message.drop)
            self.is_draining |= message.drain

    def waiting(self, kind: type[AnyWork]) -> list[AnyWork]:
        """The batches, or builds, that are held and not begun, in the order they came."""
        unbegun = (work for batch, work in self._held.items() if batch not in self._begun)
        return [work for work in unbegun if isinstance(work, kind)]

    def begin(self, kind: type[AnyWork]) -> AnyWork:
        """Begin the first one that waits; it stays held until it is answered or released."""
        work = self.waiting(kind)[0]
        self._begun.add(work.batch)
        return work

    def release(self, batch: bytes) -> None:
        """Forget a batch: its result is sent, or cannot be had here."""
        self._held.pop(batch, None)
        self._begun.discard(batch)

    def hand_back(self, keep: bytes | None) -> None:
        """Forget all batches but one; by the next join, which lists those held, others take them."""
        self._drop([batch for batch in self._held if batch != keep])

    def _drop(self, batches: list[bytes]) -> None:
        for batch in batches:
            self._held.pop(batch, None)


CREDIT = 2  # Batches outstanding at a worker, split among its jobs, at least one each: one waits
log = structlog.get_logger()


class RefusedByJob(Refused):
    """The only job for this worker does not accept it."""

    exit_code = 2

    def __init__(self, job: str, reason: object) -> None:
        super().__init__(f"Job '{job}' does not take this worker: {reason}.")


class JobRegistry:
    """The jobs that a worker serves, or `only` one; a context manager that withdraws its tokens.

    `join` says all of the worker that is the same in every join.
    """

    def __init__(self, bus: Bus, requests: BackgroundRequests, join: Join, only: str | None) -> None:
        self._bus = bus
        self._requests = requests
        self._join = join
        self._only = only
        self._sessions: dict[str, JobSession] = {}  # By job; the one that was served last stands last
        self._tokens: dict[str, AbstractContextManager[None]] = {}
        self._left: dict[str, int] = {}
        """The epochs of coordinators that drained this worker, and are there, by job."""
        self._last_number = 0
        """The highest number of a join to a job that is no longer served: numbers go on from there."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for job in list(self._tokens):
            self._close(job)

    def __iter__(self) -> Iterator[JobSession]:
        return iter(list(self._sessions.values()))

    def get(self, job: str | None) -> JobSession | None:
        """The session of a job; None: it is not served."""
        return self._sessions.get(job or "")

    @property
    def share(self) -> int:
        """The credit of each job."""
        return max(1, CREDIT // max(1, sum(session.has_share for session in self)))

    @property
    def next_join(self) -> float:
        """The time of the next try to join; infinite: nothing is to be tried."""
        return min((session.join_at for session in self), default=inf)

    @property
    def next_end(self) -> float:
        """The time at which the next job is given up; infinite: all go on."""
        return min((session.ends_at for session in self), default=inf)

    def next_session(self, is_servable: Callable[[JobSession], bool]) -> JobSession | None:
        """The first session that can be served now, which moves to the end: jobs are served in turn."""
        for job, session in self._sessions.items():
            if is_servable(session):
                self._sessions[job] = self._sessions.pop(job)
                return session
        return None

    def on_coordinator(self, key: str, is_alive: bool, now: float) -> None:
        """Note that a job's coordinator is there, or is gone, by its token."""
        job, epoch = job_of(key), parse_number(last_chunk(key))
        if job is None or epoch is None:
            return
        left = self._left.get(job, -1)
        if epoch > left or (epoch == left and not is_alive):
            self._left.pop(job, None)
        if is_alive and job not in self._sessions and epoch > left:
            self._tokens[job] = self._bus.token(Keys(job).worker_token(self._join.wid))
            self._sessions[job] = JobSession(job, self._last_number)
        if job in self._sessions:
            self._sessions[job].on_coordinator(epoch, is_alive, now)

    def on_link_up(self, now: float) -> None:
        """Join all jobs again: their coordinators may have given this worker up."""
        for session in self:
            session.join_soon(now)

    def join_due(self, now: float, platform: dict[str, str], *, is_open: bool) -> None:
        """Join the jobs that are due; a worker that is not open asks for no work."""
        for session in self:
            credit = self.share if is_open and not session.is_draining else 0
            session.set_credit(credit, now)
            if session.join_at <= now:
                number, held = session.ask(credit), session.held
                more = {"number": number, "credit": credit, "held": held, "platform": platform}
                self._requests.join(session.job, msgspec.structs.replace(self._join, **more))

    def on_join_answered(self, answered: JoinAnswered, now: float) -> list[Sample]:
        """Take the answer to a join, or its error; return the messages that waited for it.

        RefusedByJob if the job does not take this worker, and is the only one to serve.
        """
        session = self._sessions.get(answered.job)
        if session is None or answered.number != session.number:
            return []
        epoch = session.epoch
        match answered.answer:
            case Joined() as answer:
                if session.on_answer(answer, now, jitter()) and session.epoch != epoch:
                    log.info("joined", job=session.job, epoch=session.epoch, worker=self._join.wid[:8])
            case Refused() as reason:
                session.on_refusal()
                log.error("a job does not take this worker", job=session.job, reason=str(reason))
                if self._only:
                    raise RefusedByJob(session.job, reason)
            case _:
                session.on_no_answer(now, jitter())
        return session.take_deferred()

    def leave_drained(self) -> bool:
        """Leave the jobs that drained this worker; True where that was the only one to serve."""
        is_last = False
        for session in self:
            if session.is_drained:
                log.info("left a job, as its coordinator asked", job=session.job)
                if not session.is_orphaned:
                    self._left[session.job] = session.epoch
                self._close(session.job)
                is_last = self._only is not None
        return is_last

    def end_abandoned(self, now: float) -> None:
        """Give up the jobs that have had no coordinator for long."""
        for session in self:
            if now >= session.ends_at:
                log.info("a job has no coordinator any more", job=session.job)
                self._close(session.job)

    def _close(self, job: str) -> None:
        self._last_number = max(self._last_number, self._sessions.pop(job).number)
        self._tokens.pop(job).__exit__(None, None, None)


def jitter() -> float:
    """A random factor of a pause, 0.5 to 1.5, so that workers do not all ask at once."""
    return random.uniform(0.5, 1.5)  # noqa: S311  # nothing is kept secret by it
