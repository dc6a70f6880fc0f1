"""How a worker leaves: at once, or when the batch in work is done if that fits into its grace. Pure.

Time is passed in, in seconds of any steady clock.
"""

from math import inf

from qdgrasp_worker.serving.task import Task


class Leave:
    """A worker's leave.

    Parameters
    ----------
    grace
        Seconds that the batch in work may still take.
    """

    def __init__(self, grace: float) -> None:
        self._grace = grace
        self._deadline = inf
        self._kept: Task | None = None
        self._told: set[str] = set()

    @property
    def has_begun(self) -> bool:
        """Nothing new is begun any more."""
        return self._deadline < inf

    def at_once(self) -> None:
        """Leave whatever there is."""
        self._deadline = -inf

    def begin(self, head: Task | None, jobs: set[str], now: float) -> Task | None:
        """Leave soon; gives the batch that is finished before, if there is one.

        Parameters
        ----------
        head
            The batch in work.
        jobs
            Who is to hear which batches are handed back.
        """
        self._deadline = now + self._grace
        self._kept = head if head is not None and seconds_left(head) <= self._grace else None
        self._told = set(jobs)
        return self._kept

    def finished(self, task: Task) -> None:
        """Hear that a batch is done with."""
        if task is self._kept:
            self._kept = None

    def heard(self, job: str) -> None:
        """Hear that a job knows, or cannot know, what is handed back."""
        self._told.discard(job)

    def is_over(self, now: float) -> bool:
        """Whether it is time to go."""
        return now >= self._deadline or (self.has_begun and self._kept is None and not self._told)

    @property
    def deadline(self) -> float:
        """When it is time to go at the latest; infinite: nobody asked."""
        return self._deadline


def seconds_left(task: Task) -> float:
    """What the rest of a batch takes by what its rows took [CPU s]; 0 while nobody knows."""
    return task.cpu_seconds / task.done * (task.work.n - task.done) if task.done else 0.0
