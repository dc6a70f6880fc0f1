"""Stop criteria: what ends a run besides its budget, judged row by row in journal order.

A criterion is met by one nominal row, whoever evaluated what and when: that is a function of the journal,
so that a run ends with the same row however many workers it has, and however often it was resumed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.cells import cell_keys, cells
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import RunSpec

Flags = NDArray[np.bool_]
"""(n,): one for each row."""


@dataclass(frozen=True)
class StopCriteria:
    """Criteria that end a run before its budget is spent; None: no such criterion."""

    successes: int | None = None
    """Nominal successes after which it ends."""
    no_new_cell: int | None = None
    """Counted evaluations after which it ends, since the last new cell or since the beginning."""

    @classmethod
    def of(cls, spec: RunSpec) -> "StopCriteria":
        """Return the goals of a run."""
        return cls(spec.successes, spec.no_new_cell)


class StopTracker:
    """Progress of a run towards its goals; `cells` are the keys of cells with a success so far."""

    def __init__(self, goals: StopCriteria, cells: set[int]) -> None:
        self._goals = goals
        self._cells = cells
        self._stale = self._most_stale = 0  # evaluations since a new cell: now, and most before the last row

    def count(self, rows: Rows, is_counted: Flags) -> None:
        """Count the next nominal rows (n,), before their cells are known."""
        if self._goals.no_new_cell is not None and len(rows):
            stale = self._staleness(rows, is_counted)
            self._most_stale = max(self._most_stale, self._stale, int(stale[:-1].max(initial=0)))
            self._stale = int(stale[-1])

    def reached(self, successes: int) -> str | None:
        """Return the goal that is reached with so many successes, in words; None: no goal is."""
        if self._goals.successes is not None and successes >= self._goals.successes:
            return f"{self._goals.successes} successes are found"
        if self._goals.no_new_cell is not None and self._stale >= self._goals.no_new_cell:
            return f"the last {self._goals.no_new_cell} evaluations found no new cell"
        return None

    def rows_until_stop(self, rows: Rows, is_counted: Flags, successes: int) -> int:
        """Count the next nominal rows (n,) up to the first that reaches a goal; else all."""
        ends = [len(rows)]
        if self._goals.successes is not None:
            found = successes + np.cumsum(rows["outcome"] >= Outcome.DROPPED)
            ends.append(count_to_first(found >= self._goals.successes))
        if self._goals.no_new_cell is not None:
            ends.append(count_to_first(self._staleness(rows, is_counted) >= self._goals.no_new_cell))
        return min(ends)

    def check(self, successes: int, is_last: bool) -> None:
        """Raise `ImpossibleValue` if a goal was reached before the last row that was counted.

        `is_last` says whether that row is a success.
        """
        least = successes + (not is_last)
        if self._goals.successes is not None and self._goals.successes < least:
            raise ImpossibleValue("successes", self._goals.successes, f"at least {least}, which are recorded")
        if self._goals.no_new_cell is not None and self._goals.no_new_cell <= self._most_stale:
            raise ImpossibleValue(
                "no_new_cell",
                self._goals.no_new_cell,
                f"at least {self._most_stale + 1}: so long a stretch without a new cell is recorded",
            )

    def _staleness(self, rows: Rows, is_counted: Flags) -> NDArray[np.int64]:
        """Counted evaluations since the last new cell at each row: (n,)."""
        done = np.cumsum(is_counted)
        fresh = np.where(self._is_new(rows), done, -self._stale)
        return done - np.maximum.accumulate(fresh)

    def _is_new(self, rows: Rows) -> Flags:
        """Flag the rows that reach a new cell: (n,)."""
        found = np.flatnonzero(rows["outcome"] >= Outcome.DROPPED)
        reached, places = np.unique(cell_keys(cells(rows["descriptor"][found, :3])), return_index=True)
        is_unknown = [key not in self._cells for key in reached.tolist()]
        is_new = np.zeros(len(rows), dtype=bool)
        is_new[found[places[is_unknown]]] = True
        return is_new


def count_to_first(reached: Flags) -> int:
    """Count rows up to the first that reaches something, that one included; else all."""
    return int(reached.argmax()) + 1 if reached.any() else len(reached)
