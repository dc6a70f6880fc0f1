"""A worker's appointment with one job: whether its coordinator is there, and when to ask to join.

Rule 2 of docs/bus.md, decided without a bus. Time is passed in, in seconds of any steady clock.
"""

from math import inf

from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.messages import Joined
from qdgrasp_worker.serving.desk import Desk

LAST = 60.0  # seconds without a coordinator after which an appointment is over, once nothing is held
RETRY_FIRST, RETRY_LAST = 0.05, 2.0
"""Seconds between tries to join, before jitter."""


class Appointment:
    """A job at this worker: its desk, and when to try to join next."""

    def __init__(self, job: str) -> None:
        self.desk = Desk(job)
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
        return inf if self._there or self.desk.held else self._left_at + LAST

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
