"""Where a run's rows go: to a recorder (`recorder_link`), or, where only a result is wanted, to memory."""

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np

from qdgrasp_coordinator.counts.stretch import Stretch
from qdgrasp_protocol.messages import (
    Opened,
    OpenRun,
    Recorded,
)
from qdgrasp_protocol.rows import Rows, Shape


class Record(ABC):
    """Takes the settled rows of a run, in journal order."""

    trouble: str = ""
    """Why rows cannot be written now, in words; empty when they can."""

    @abstractmethod
    def open(self, run: OpenRun, epoch: int, wait: Callable[[], None]) -> Opened:
        """Open the run: the epoch to use, and how many rows are recorded already.

        Parameters
        ----------
        epoch
            The coordinator's turn at the job; 0: one begins.
        wait
            Called between two tries; it may raise to end them.
        """

    @abstractmethod
    def recorded(self, first: int, wait: Callable[[], None]) -> Stretch:
        """Recorded rows from number `first` on, some at least if there are any."""

    @abstractmethod
    def push(self, stretch: Stretch) -> None:
        """Take rows that became final."""

    @abstractmethod
    def set_platform(self, platform: dict[str, str]) -> None:
        """Note the platform of this job's rows."""

    @abstractmethod
    def tick(self, now: float) -> None:
        """Send what is due."""

    @abstractmethod
    def heard(self, message: Recorded, now: float) -> None:
        """Take note of what a recorder reports."""

    @abstractmethod
    def recorder_up(self, now: float) -> None:
        """A recorder appeared."""

    @property
    @abstractmethod
    def durable(self) -> int:
        """How many rows of the run are safe."""

    @property
    @abstractmethod
    def is_full(self) -> bool:
        """So much is unconfirmed that nothing new should be asked."""

    @property
    @abstractmethod
    def is_empty(self) -> bool:
        """Everything taken is safe."""


class Memory(Record):
    """Keeps the rows: for a job whose result is wanted at once and not for later."""

    def __init__(self, shape: Shape) -> None:
        self._shape = shape
        self._parts: list[Rows] = []
        self.platform: dict[str, str] = {}
        """What the rows were made on; empty before a worker came."""

    @property
    def rows(self) -> Rows:
        """Everything taken, in journal order."""
        return np.concatenate([self._shape.empty(0), *self._parts])

    def open(self, run: OpenRun, epoch: int, wait: Callable[[], None]) -> Opened:
        """Begin: nothing is recorded."""
        return Opened(epoch=1, durable=[0], platform={})

    def recorded(self, first: int, wait: Callable[[], None]) -> Stretch:
        """Nothing is recorded."""
        return Stretch(first, self._shape.empty(0))

    def push(self, stretch: Stretch) -> None:
        """Keep the rows."""
        self._parts.append(stretch.rows)

    def set_platform(self, platform: dict[str, str]) -> None:
        """Note the platform."""
        self.platform = platform

    def tick(self, now: float) -> None:
        """Nothing is sent."""

    def heard(self, message: Recorded, now: float) -> None:
        """No recorder is listened to."""

    def recorder_up(self, now: float) -> None:
        """No recorder is needed."""

    @property
    def durable(self) -> int:
        """Everything taken."""
        return sum(map(len, self._parts))

    @property
    def is_full(self) -> bool:
        """Memory takes it all."""
        return False

    @property
    def is_empty(self) -> bool:
        """What is kept is safe."""
        return True
