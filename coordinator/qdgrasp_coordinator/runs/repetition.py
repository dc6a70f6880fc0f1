"""A repetition: recorded rows that are evaluated again, each in its trial, and compared as they come back."""

from collections.abc import Callable, Sequence

import numpy as np

from qdgrasp_coordinator.counts.curve import Trail
from qdgrasp_coordinator.counts.stretch import Stretch
from qdgrasp_coordinator.counts.tally import Tally
from qdgrasp_coordinator.runs.generation import Generation
from qdgrasp_protocol.messages import Failure
from qdgrasp_protocol.rows import Rows

Compare = Callable[[int, np.void, str], None]
"""Takes a row as it was evaluated now, by its place among the recorded ones, and why it failed if it did."""


class Repetition:
    """The `Agenda` of rows that are evaluated once more; nothing of it becomes final.

    On the way each has its place in place of its key: a generation of its own, and as index its number there.

    Parameters
    ----------
    recorded
        (n,), in any order.
    compare
        Called once for each of them.
    """

    def __init__(self, recorded: Rows, compare: Compare) -> None:
        self.tally = Tally(len(recorded), "count")
        """What was evaluated so far; trials count as what they are, evaluations."""
        self.trail = Trail()
        self._recorded = recorded
        self._compare = compare
        self._is_due = True
        self._is_missing = np.ones(len(recorded), dtype=bool)

    @property
    def finished(self) -> str | None:
        """Why it is over, in words; None while rows are missing."""
        return None if self._is_missing.any() else "all rows were evaluated again"

    def ask(self) -> Generation | None:
        """All of the rows at first; None from then on."""
        if not self._is_due:
            return None
        self._is_due = False
        indices = np.arange(len(self._recorded), dtype=np.uint32)
        return Generation(0, indices, self._recorded["trial"], self._recorded["genome"])

    def settle(self, rows: Rows, cpu_seconds: float = 0.0, failures: Sequence[Failure] = ()) -> Stretch:
        """Compare evaluated rows with the recorded ones; none is given back."""
        reasons = {failure.row: failure.reason for failure in failures}
        fresh = np.flatnonzero(self._is_missing[rows["index"]])
        self._is_missing[rows["index"]] = False
        for place in fresh.tolist():
            self._compare(int(rows["index"][place]), rows[place], reasons.get(place, ""))
        counted = rows[fresh]
        counted["trial"] = 0
        self.tally.count(counted)
        return Stretch(0, rows[:0])

    def replay(self, rows: Rows) -> None:
        """Nothing of it is ever recorded."""
