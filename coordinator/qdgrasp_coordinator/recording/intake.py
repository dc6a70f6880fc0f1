"""What a recorder takes of the rows that arrive, and when it commits them: decided without a disk or a bus.

Messages may be lost, repeated, overlap, or come from a coordinator that was replaced (docs/bus.md, rule 8).
Time is passed in, in seconds of any steady clock.
"""

from enum import Enum
from math import inf

from qdgrasp_coordinator.counts.stretch import Stretch, joined

GROUP_ROWS = 2048
"""With this many rows waiting, they are committed at once."""
GROUP_SECONDS = 0.25
"""The longest that a row waits for its commit."""
CAPACITY = 65_536
"""The most rows that wait while nothing can be committed; more than a coordinator sends unconfirmed."""


class Arrival(Enum):
    """What became of rows that arrived."""

    TAKEN = "taken"
    """They, or the part that was not known, wait for their commit."""
    DUPLICATE = "known already"
    GAP = "rows before them are missing"
    STALE = "of a coordinator that was replaced"
    FULL = "more than can wait"


class Intake:
    """Rows of one run between their arrival and their commit.

    Parameters
    ----------
    epoch
        The coordinator's; rows of a lower one are refused, a higher one is adopted.
    durable
        How many rows of the run are committed.
    """

    def __init__(self, epoch: int, durable: int) -> None:
        self.epoch = epoch
        self.durable = durable
        self._waiting: list[Stretch] = []
        self._since = 0.0

    @property
    def expected(self) -> int:
        """The number of the next row."""
        return self._waiting[-1].stop if self._waiting else self.durable

    def offer(self, epoch: int, stretch: Stretch, now: float) -> Arrival:
        """Take what is new of consecutive rows."""
        if epoch < self.epoch:
            return Arrival.STALE
        self.epoch = epoch
        if stretch.first > self.expected:
            return Arrival.GAP
        if stretch.stop <= self.expected:
            return Arrival.DUPLICATE
        if stretch.stop - self.durable > CAPACITY:
            return Arrival.FULL
        if not self._waiting:
            self._since = now
        self._waiting.append(stretch.part(self.expected, stretch.stop))
        return Arrival.TAKEN

    @property
    def deadline(self) -> float:
        """When the waiting rows are to be committed; infinite where none wait."""
        if self.expected - self.durable >= GROUP_ROWS:
            return -inf
        return self._since + GROUP_SECONDS if self._waiting else inf

    @property
    def group(self) -> Stretch | None:
        """The waiting rows as one; None where none wait."""
        return joined(self._waiting) if self._waiting else None

    def committed(self) -> None:
        """Note that the waiting rows are durable."""
        self.durable = self.expected
        self._waiting.clear()
