"""How an outcome archive grew: successes and their cells over the evaluations of a run."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.cells import cells, keys
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows


@dataclass(frozen=True)
class Growth:
    """After each evaluation of a run, (n,)."""

    successes: NDArray[np.int64]
    cells: NDArray[np.int64]
    """Distinct 1 cm cells with a success."""


def growth(rows: Rows) -> Growth:
    """Count along rows in journal order; nominal evaluations, overlaps included."""
    nominal = rows[rows["trial"] == 0]
    success = nominal["outcome"] >= Outcome.DROPPED
    places = np.flatnonzero(success)
    _, first = np.unique(keys(cells(nominal["descriptor"][places])), return_index=True)
    new = np.zeros(len(nominal), dtype=bool)
    new[places[first]] = True
    return Growth(np.cumsum(success), np.cumsum(new))
