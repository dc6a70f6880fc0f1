"""The end of a job before it is done: when asked to, or when its time is over.

Time is passed in, in seconds of any steady clock.
"""

from math import inf

from qdgrasp_protocol.errors import EndedEarly

LEAST_STOP_SECONDS = 0.2  # Shortest time that an ending takes [s], so that the asker gets its answer
MOST_STOP_SECONDS = 5.0  # Longest wait for a recorder [s]; rows unrecorded by then are evaluated again


class EarlyStop:
    """Decides when a job ends early: when asked to, or by itself after `seconds`; None: never."""

    reason: EndedEarly | None = None
    """Reason of a requested end; None: not requested."""

    def __init__(self, seconds: float | None, now: float) -> None:
        self.deadline = inf if seconds is None else now + seconds
        """When it is to begin by itself; infinite: never, or it has begun."""
        self._began: float | None = None

    def begin(self, now: float, reason: EndedEarly | None = None) -> None:
        """Begin the ending: no more work is asked or handed out."""
        self._began, self.reason, self.deadline = now, reason, inf

    @property
    def has_begun(self) -> bool:
        """True if nothing is asked or leased any more; what was found is still recorded."""
        return self._began is not None

    def is_due(self, now: float) -> bool:
        """True if it is to begin by itself now."""
        return now >= self.deadline

    def is_over(self, now: float, *, is_safe: bool) -> bool:
        """True if the job may end now; `is_safe`: all results are recorded."""
        if self._began is None:
            return False
        return now >= self._began + (LEAST_STOP_SECONDS if is_safe else MOST_STOP_SECONDS)
