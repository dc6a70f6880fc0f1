"""How a worker leaves: at once, or when the batch in work is done if that fits into its grace. Pure.

Time is passed in, in seconds of any steady clock.
"""

from math import inf

from qdgrasp_worker.serving.task import Task

HAND_BACK = 0.5
"""The last seconds of a grace, in which a batch that was not finished is handed back."""


class Leave:
    """A worker's leave.

    Parameters
    ----------
    grace
        Seconds until the batch in work is finished or handed back.
    """

    def __init__(self, grace: float) -> None:
        self._grace = grace
        self._finish_by = inf
        self._gone_by = inf
        self._told: set[str] = set()
        self.kept: Task | None = None
        """The batch that is to be finished before."""

    @property
    def has_begun(self) -> bool:
        """Nothing new is begun any more."""
        return self._gone_by < inf

    @property
    def deadline(self) -> float:
        """When something is to be done at the latest; infinite: nobody asked."""
        return self._gone_by if self.kept is None else self._finish_by

    def at_once(self) -> None:
        """Leave whatever there is."""
        self._gone_by = -inf

    def begin(self, head: Task | None, now: float) -> None:
        """Leave soon, with `head`, the batch in work, finished before if that fits."""
        self._finish_by = now + self._grace - HAND_BACK
        self._gone_by = now + max(self._grace, HAND_BACK)
        if head is not None and now + head.seconds_left(now) <= self._finish_by:
            self.kept = head

    def is_late(self, now: float) -> bool:
        """Whether the batch that is kept has to be handed back now."""
        return self.kept is not None and now >= self._finish_by

    def forget(self, task: Task) -> None:
        """Hear that a batch is done with, or handed back."""
        if task is self.kept:
            self.kept = None

    def tell(self, job: str) -> None:
        """Wait for a job to hear what is handed back."""
        self._told.add(job)

    def heard(self, job: str) -> None:
        """Hear that a job knows, or cannot know, what is handed back."""
        self._told.discard(job)

    def is_over(self, now: float) -> bool:
        """Whether it is time to go."""
        return now >= self._gone_by or (self.has_begun and self.kept is None and not self._told)
