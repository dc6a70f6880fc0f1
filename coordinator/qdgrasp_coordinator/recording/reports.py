"""Which runs a recorder reports, and when: decided without a bus.

A run is reported at once when there is news of it, and then each second until nothing was heard of it for a
while: a report may be lost. Later ones are owed to nobody: a coordinator that still misses one sends its rows
again, and these are news. Time is passed in, in seconds of any steady clock.
"""

from math import inf

INTERVAL = 1.0
"""Seconds between two reports of a run when nothing happens."""
MEMORY = 10.0
"""Seconds for which a run is reported after the last that was heard of it."""


class Reports:
    """The reports that are due."""

    def __init__(self) -> None:
        self._due: dict[str, float] = {}
        self._until: dict[str, float] = {}

    def heard(self, run: str, now: float) -> None:
        """Note that something was heard of a run: it is reported each second for a while."""
        self._due.setdefault(run, now + INTERVAL)
        self._until[run] = now + MEMORY

    def news(self, run: str, now: float) -> None:
        """Note that there is something to report of a run at once."""
        self._due[run] = now
        self._until[run] = now + MEMORY

    def repeat(self, now: float) -> None:
        """Let every run that is remembered be reported at once."""
        self._due = dict.fromkeys(self._due, now)

    @property
    def deadline(self) -> float:
        """When the next report is due; infinite: none is."""
        return min(self._due.values(), default=inf)

    def due(self, now: float) -> list[str]:
        """The runs to report now; they count as reported."""
        runs = [run for run, at in self._due.items() if at <= now]
        for run in runs:
            if now + INTERVAL <= self._until[run]:
                self._due[run] = now + INTERVAL
            else:
                del self._due[run], self._until[run]
        return runs
