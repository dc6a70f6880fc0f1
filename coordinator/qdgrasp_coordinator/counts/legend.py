"""The legend of a journal: what one must know to read its successes, beside its rows."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.counts.niches import UNKNOWN, Synergies
from qdgrasp_coordinator.counts.scores import eta, known
from qdgrasp_coordinator.counts.tally import successful
from qdgrasp_protocol.genome import NO_SYNERGY
from qdgrasp_protocol.rows import Rows

NO_ETA = -1.0
"""Where it is not known."""


@dataclass(frozen=True)
class Legend:
    """How the rows of a journal are read."""

    trials: int = 0
    """How many trials a success has."""
    parts: tuple[tuple[int, Synergies], ...] = ((0, UNKNOWN),)
    """How genomes name synergies, and the number behind the last row of which this holds; of all rows
    behind that of the last part, its own holds."""

    def synergies(self, rows: Rows, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """The labels (n,) of rows with these journal numbers (n,); `NO_SYNERGY` where there is none."""
        ends = [end for end, _ in self.parts]
        whose = np.minimum(np.searchsorted(ends, numbers, side="right"), len(ends) - 1)
        labels = np.full(len(rows), NO_SYNERGY)
        for part in np.unique(whose).tolist():
            labels[whose == part] = self.parts[part][1].labels(rows["genome"][whose == part])
        return labels

    def etas(self, rows: Rows) -> NDArray[np.float64]:
        """Of each nominal success among consecutive rows (n,); `NO_ETA` where trials are missing."""
        if not self.trials:
            return np.full(int(np.count_nonzero(successful(rows))), NO_ETA)
        return np.nan_to_num(eta(known(rows, self.trials), self.trials), nan=NO_ETA)
