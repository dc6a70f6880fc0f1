"""Silence: how long a simulator has said nothing while it was at work. Pure.

Time in which it stood still (SIGSTOP), or its worker did, is none: silence is counted in slices, and one that
took longer, because nobody looked, counts as one. Time is passed in, in seconds of any steady clock.
"""

SLICE = 1.0
"""Seconds between two looks at a simulator that is at work."""


class Silence:
    """The silence of a simulator."""

    def __init__(self) -> None:
        self.seconds = 0.0
        """How long it has lasted."""
        self._looked_at: float | None = None

    def begin(self, now: float) -> None:
        """Hear that the simulator said something, or was given something to do."""
        self.seconds, self._looked_at = 0.0, now

    @property
    def look_at(self) -> float:
        """When to look next."""
        return 0.0 if self._looked_at is None else self._looked_at + SLICE

    def look(self, now: float, *, is_stopped: bool) -> None:
        """Look at the simulator, which may stand still now."""
        before, self._looked_at = self._looked_at, now
        if not (before is None or is_stopped):
            self.seconds += min(now - before, SLICE)
