"""The outbox of one run: final rows on their way to the recorder, kept until they are durable.

A put is no promise: what was sent may be lost, repeated or overtaken. The outbox knows the number up to
which the recorder has reported rows durable, and sends everything behind it again when the recorder is new or
stands still (docs/bus.md, rule 8). Time is passed in, in seconds of any steady clock.
"""

from collections import deque

from qdgrasp_coordinator.counts.stretch import Stretch, joined
from qdgrasp_protocol.errors import RecorderFellBack

SLICE = 1024
"""The most rows in one message."""
BOUND = 20_000
"""With more unconfirmed rows than this, the run stops asking."""
RESEND_AFTER = 2.0
"""Seconds without progress after which everything unconfirmed is sent again."""
DOUBT = 3.0
"""Seconds for which nothing but lower numbers must be heard before they are believed: one may be late."""


class Outbox:
    """Unconfirmed rows of one run.

    Parameters
    ----------
    durable
        How many rows were durable when the recorder opened the run.
    """

    def __init__(self, durable: int = 0) -> None:
        self.confirmed = durable
        """Rows that the recorder reported durable."""
        self._kept: deque[Stretch] = deque()
        self._end = durable
        self._sent = durable
        self._progress = 0.0
        self._lower_since: float | None = None

    @property
    def unconfirmed(self) -> int:
        """How many rows are not known to be durable."""
        return self._end - self.confirmed

    @property
    def is_empty(self) -> bool:
        """Whether all rows are durable."""
        return not self.unconfirmed

    @property
    def is_full(self) -> bool:
        """Whether the run is to stop asking until the recorder catches up."""
        return self.unconfirmed > BOUND

    def push(self, stretch: Stretch) -> None:
        """Take the next rows of the journal."""
        if stretch.first != self._end:
            raise ValueError(f"row {self._end} was to be next, got {stretch.first}")
        if len(stretch):
            self._kept.append(stretch)
            self._end = stretch.stop

    def due(self, now: float) -> list[Stretch]:
        """What is to be sent now, in slices; it counts as sent."""
        if self._is_waiting and now >= self._progress + RESEND_AFTER:
            self._resend(now)
        if self._sent == self._end:
            return []
        if not self._is_waiting:
            self._progress = now
        parts = [kept.part(self._sent, self._end) for kept in self._kept if kept.stop > self._sent]
        rest = joined(parts)
        self._sent = self._end
        return [rest.part(first, first + SLICE) for first in range(rest.first, rest.stop, SLICE)]

    def durable(self, number: int, now: float) -> None:
        """Hear that `number` rows are durable.

        Raises
        ------
        RecorderFellBack
            The recorder has fewer rows than it reported before, or more than were ever sent: start again
            from its journal. A lower number may also have been overtaken by a higher one on its way, so
            it is believed only when nothing else was heard for `DOUBT` seconds.
        """
        if number < self.confirmed or number > self._end:
            self._doubt(number, now)
            return
        self._lower_since = None
        if number > self.confirmed:
            self._progress = now
            self._forget(number)

    def recorder_up(self, now: float) -> None:
        """Hear that a recorder has just appeared: it may have missed what was sent."""
        self._resend(now)

    @property
    def _is_waiting(self) -> bool:
        """Whether rows are sent that are not confirmed."""
        return self._sent > self.confirmed

    def _resend(self, now: float) -> None:
        self._sent = self.confirmed
        self._progress = now

    def _forget(self, number: int) -> None:
        self.confirmed = number
        self._sent = max(self._sent, number)
        while self._kept and self._kept[0].stop <= number:
            self._kept.popleft()

    def _doubt(self, number: int, now: float) -> None:
        if self._lower_since is None:
            self._lower_since = now
        elif now >= self._lower_since + DOUBT:
            raise RecorderFellBack(number, self.confirmed, self._end)
