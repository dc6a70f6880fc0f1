"""A worker's appointment with one job: whether its coordinator is there, and when to ask to join.

Rule 2 of docs/bus.md, decided without a bus. Time is passed in, in seconds of any steady clock.
"""

from qdgrasp_protocol.messages import Joined
from qdgrasp_worker.desk import Desk

RETRY_FIRST, RETRY_LAST = 0.05, 2.0
"""Seconds between tries to join, before jitter."""


class Appointment:
    """A job at this worker: its desk, and when to try to join next."""

    def __init__(self, job: str) -> None:
        self.desk = Desk(job)
        self.alive = True
        """Whether a coordinator that it may follow is there."""
        self._patience = RETRY_FIRST
        self._join_at: float | None = None

    @property
    def join_at(self) -> float | None:
        """When to ask to join; None: there is no need, or nobody to ask."""
        return self._join_at if self.alive else None

    def is_due(self, now: float) -> bool:
        """Whether it is to be asked now."""
        return self.join_at is not None and self.join_at <= now

    def meet(self, epoch: int, alive: bool, now: float) -> None:
        """Hear that a coordinator's token is there, or is gone."""
        if alive and self.desk.follows(epoch):
            self.alive = True
            self.join_soon(now)
        elif not alive and epoch == self.desk.epoch:
            self.alive = False
            self.desk.is_orphaned = True

    def join_soon(self, now: float) -> None:
        """Ask to join, again if need be: the link is new, or a batch was handed back."""
        self._patience = RETRY_FIRST
        self._join_at = now

    def answered(self, answer: Joined) -> bool:
        """Take the answer to a join; False when it comes from an older coordinator than the one known."""
        self._join_at = None
        return self.desk.joined(answer)

    def unanswered(self, now: float, jitter: float) -> None:
        """Hear that nobody answered: ask again later, after a time that doubles, times the jitter."""
        self._join_at = now + self._patience * jitter
        self._patience = min(2 * self._patience, RETRY_LAST)

    def refused(self) -> None:
        """Hear that the job does not take this worker: ask no more until something changes."""
        self._join_at = None
