"""The docket: which batches are at the simulator, and what becomes of them when it speaks, or ends. Pure.

Time is passed in, in seconds of any steady clock.
"""

from collections import deque

from qdgrasp_worker.serving.frames import Begun, Lacking, Part, Said, Unfit
from qdgrasp_worker.serving.task import Task

AHEAD = 2
"""Batches at the simulator: the one that it works on, and one that waits, so that it is never idle."""


class Docket:
    """Batches in the order in which the simulator has them."""

    def __init__(self) -> None:
        self._there: deque[Task] = deque()
        self._again: deque[Task] = deque()

    @property
    def head(self) -> Task | None:
        """What the simulator works on; None: nothing."""
        return self._there[0] if self._there else None

    @property
    def has_room(self) -> bool:
        """Another batch may go to the simulator."""
        return len(self._there) < AHEAD

    @property
    def tasks(self) -> list[Task]:
        """All batches, those first that are to be sent again."""
        return [*self._again, *self._there]

    @property
    def next_again(self) -> Task | None:
        """The batch that is to be sent again before any other; None: there is none."""
        return self._again[0] if self._again else None

    def send(self, task: Task, now: float) -> None:
        """Note that a batch goes to the simulator, for the first time or again."""
        if task is self.next_again:
            self._again.popleft()
        task.since = now
        self._there.append(task)

    def drop(self, task: Task) -> None:
        """Forget a batch that was to be sent again."""
        self._again.remove(task)

    def hear(self, frame: Said, now: float) -> Task | None:
        """Take what the simulator says of the batch that it works on; gives it when it is done."""
        task = self.head
        if task is None:
            return None
        match frame:
            case Begun():
                task.is_loading = False
            case Part():
                task.add(frame)
            case Unfit(reason=reason):
                task.fail(reason)
            case Lacking():
                self._again.append(self._there.popleft())
        if not task.is_done:
            return None
        self._there.popleft()
        if self.head is not None:
            self.head.since = now
        return task

    def stumble(self, reason: str) -> Task | None:
        """Hear that the simulator ended of what it was at; gives that batch if it is done with.

        The others go to the next simulator, as does the rest of that one.
        """
        task = self.head
        if task is None:
            return None
        task.stumble(reason)
        if task.is_done:
            self._there.popleft()
        self.again()
        return task if task.is_done else None

    def again(self) -> None:
        """Have all batches that are there go to the next simulator."""
        self._again.extendleft(reversed(self._there))
        self._there.clear()

    def lose(self) -> list[Task]:
        """Hear that the simulator was killed from outside; gives the batches that were there."""
        lost = list(self._there)
        self._there.clear()
        return lost
