"""How an outcome archive grew: successes and their cells over the evaluations of a run."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.counts.cells import cells, keys
from qdgrasp_coordinator.counts.tally import counted
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import Overlaps


@dataclass(frozen=True)
class Growth:
    """Sums over the rows of a journal, before its first row and after each: (n + 1,)."""

    evaluations: NDArray[np.int64]
    """Counted evaluations."""
    successes: NDArray[np.int64]
    cells: NDArray[np.int64]
    """Distinct 1 cm cells with a success."""


def growth(rows: Rows, overlaps: Overlaps = "count") -> Growth:
    """Sum along rows in journal order; trials above 0 add nothing."""
    success = (rows["trial"] == 0) & (rows["outcome"] >= Outcome.DROPPED)
    places = np.flatnonzero(success)
    new = np.zeros(len(rows), dtype=bool)
    new[places] = first_times(keys(cells(rows["descriptor"][places, :3])))
    return Growth(*(np.cumsum(np.r_[0, steps]) for steps in (counted(rows, overlaps), success, new)))


def first_times(keys: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Where each number (n,) occurs for the first time: (n,)."""
    first = np.zeros(len(keys), dtype=bool)
    first[np.unique(keys, return_index=True)[1]] = True
    return first
