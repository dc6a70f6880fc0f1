"""The tally of a run: what its journal's rows add up to, and whether they make it complete."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.cells import cells, keys
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import Overlaps, RunSpec

BARREN = 20
"""A run ends when so many generations in a row counted nothing."""


def counted(rows: Rows, overlaps: Overlaps) -> NDArray[np.bool_]:
    """Which rows count as evaluations: (n,).

    "count": every nominal row, as every pose was given to the simulator or its filters (the paper's
    "evaluated samples"). "redraw": those that were simulated. Trials above 0 never count.
    """
    nominal: NDArray[np.bool_] = rows["trial"] == 0
    return nominal if overlaps == "count" else nominal & (rows["outcome"] >= Outcome.MISSED)


class Tally:
    """Sums over the rows of a journal in its order; outcomes are those of nominal rows.

    Parameters
    ----------
    budget
        Counted evaluations after which the run is over.
    overlaps
        Whether overlaps count as evaluations.
    """

    rows: int = 0
    evaluations: int = 0
    """Counted evaluations: what the budget limits."""
    proposals: int = 0
    """Poses that decoding screened."""

    def __init__(self, budget: int, overlaps: Overlaps) -> None:
        self.budget = budget
        self._overlaps = overlaps
        self._barren = 0
        self._before = 0
        self._outcomes = np.zeros(len(Outcome), dtype=np.int64)
        self._cells: set[int] = set()

    def count(self, rows: Rows) -> None:
        """Count the next rows."""
        nominal = rows[rows["trial"] == 0]
        self.rows += len(rows)
        self.evaluations += int(np.count_nonzero(counted(rows, self._overlaps)))
        self.proposals += int(nominal["proposals"].sum(dtype=np.int64))
        self._outcomes += np.bincount(nominal["outcome"], minlength=len(Outcome))
        successes = nominal[nominal["outcome"] >= Outcome.DROPPED]
        if len(successes):
            self._cells.update(keys(cells(successes["descriptor"][:, :3])).tolist())

    def end_generation(self) -> None:
        """Hear that the rows counted so far end a generation."""
        self._barren = self._barren + 1 if self.evaluations == self._before else 0
        self._before = self.evaluations

    @property
    def left(self) -> int:
        """Counted evaluations that the budget still allows."""
        return self.budget - self.evaluations

    @property
    def finished(self) -> str | None:
        """Why the run is over, in words; None while it is not."""
        if self.left <= 0:
            return f"the budget of {self.budget} evaluations is spent"
        if self._barren >= BARREN:
            return f"the last {BARREN} generations counted no evaluation"
        return None

    def _from(self, outcome: Outcome) -> int:
        return int(self._outcomes[outcome:].sum())

    @property
    def cells(self) -> int:
        """Distinct 1 cm cells with a success."""
        return len(self._cells)

    @property
    def errors(self) -> int:
        """Rows on which the simulator failed three times."""
        return int(self._outcomes[Outcome.ERROR])

    @property
    def dead_ends(self) -> int:
        """Rows for which decoding found no pose."""
        return int(self._outcomes[Outcome.DEAD_END])

    @property
    def overlaps(self) -> int:
        """Rows whose open hand overlapped the object."""
        return int(self._outcomes[Outcome.OVERLAP])

    @property
    def simulated(self) -> int:
        """Rows whose hand closed."""
        return self._from(Outcome.MISSED)

    @property
    def successes(self) -> int:
        """Rows with a finger on the object after closing."""
        return self._from(Outcome.DROPPED)

    @property
    def grasps(self) -> int:
        """Successes that survived a shake."""
        return self._from(Outcome.SHAKEN)

    @property
    def robust(self) -> int:
        """Successes that survived both shakes."""
        return self._from(Outcome.HELD)


def tally(spec: RunSpec, blocks: Iterable[Rows]) -> Tally:
    """The tally of a journal of nominal rows, in its order, in blocks of any length."""
    total = Tally(spec.evaluations, spec.overlaps)
    for block in blocks:
        for number in np.unique(block["generation"]):
            rows = block[block["generation"] == number]
            total.count(rows)
            if (rows["index"] == spec.population - 1).any():
                total.end_generation()
    return total
