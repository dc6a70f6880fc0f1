"""Goals: what ends a run besides its budget, judged row by row in journal order.

A goal is reached by one nominal row, whoever evaluated what and when: that is a function of the journal, so
that a run ends with the same row however many workers it has, and however often it was resumed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qdgrasp_protocol.spec import RunSpec


@dataclass(frozen=True)
class Goals:
    """What ends a run before its budget is spent; None: nothing of that kind."""

    successes: int | None = None
    """So many nominal successes."""
    no_new_cell: int | None = None
    """So many counted evaluations since the last one that reached a new cell, or since the beginning."""

    @classmethod
    def of(cls, spec: RunSpec) -> "Goals":
        """Those of a run."""
        return cls(spec.successes, spec.no_new_cell)

    def reached(self, successes: int, stale: int) -> str | None:
        """Which is reached, in words; None: none is.

        Parameters
        ----------
        successes
            Nominal successes so far.
        stale
            Counted evaluations since the last one that reached a new cell.
        """
        if self.successes is not None and successes >= self.successes:
            return f"{self.successes} successes are found"
        if self.no_new_cell is not None and stale >= self.no_new_cell:
            return f"the last {self.no_new_cell} evaluations found no new cell"
        return None


def stale(done: NDArray[np.int64], is_new: NDArray[np.bool_], fresh: int) -> NDArray[np.int64]:
    """Counted evaluations since the last new cell, at each row: (n,).

    Parameters
    ----------
    done
        Counted evaluations so far, each row's own included: (n,).
    is_new
        Which rows reached a new cell: (n,).
    fresh
        Counted evaluations when the last new cell before these rows was reached.
    """
    since: NDArray[np.int64] = done - np.maximum.accumulate(np.where(is_new, done, fresh))
    return since


def first(reached: NDArray[np.bool_]) -> int:
    """How many rows there are up to the first that reaches something, that one included; else all."""
    return int(reached.argmax()) + 1 if reached.any() else len(reached)
