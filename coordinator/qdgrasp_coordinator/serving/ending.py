"""The ending of a job before it is done: when it begins, and how long it takes; decided without a clock.

Time is passed in, in seconds of any steady clock.
"""

from math import inf

from qdgrasp_protocol.errors import EndedEarly

LEAST = 0.2
"""Seconds that it takes at least: whoever asked for it is to hear the answer."""
MOST = 5.0
"""Seconds for which a recorder is waited for; what it has not recorded by then is evaluated again."""


class Ending:
    """Whether a job ends early.

    Parameters
    ----------
    seconds
        After so long it does by itself; None: never.
    """

    reason: EndedEarly | None = None
    """Why somebody ended it; None where nobody did."""

    def __init__(self, seconds: float | None, now: float) -> None:
        self._due_at = inf if seconds is None else now + seconds
        self._began: float | None = None

    def begin(self, now: float, reason: EndedEarly | None = None) -> None:
        """Note that nothing is asked or handed out any more."""
        self._began, self.reason = now, reason

    def is_due(self, now: float) -> bool:
        """Whether it is to begin by itself."""
        return self._began is None and now >= self._due_at

    def is_over(self, now: float, *, is_safe: bool) -> bool:
        """Whether the job may end now; `is_safe`: all that was found is recorded."""
        if self._began is None:
            return False
        return now >= self._began + (LEAST if is_safe else MOST)

    @property
    def deadline(self) -> float:
        """When it is to begin by itself; infinite: never, or it has begun."""
        return inf if self._began is not None else self._due_at
