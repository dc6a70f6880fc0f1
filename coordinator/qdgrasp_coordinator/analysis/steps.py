"""Steps: a number that grows with some of a run's evaluations."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Steps:
    """A number that changes at some of a run's evaluations; 0 at its beginning."""

    evaluations: NDArray[np.int64]
    """(n,), ascending: counted evaluations at which it changes."""
    totals: NDArray[np.int64]
    """(n,): what it is from there on."""

    def after(self, evaluations: ArrayLike) -> NDArray[np.int64]:
        """What it is after so many counted evaluations."""
        place = np.searchsorted(self.evaluations, evaluations, side="right")
        return np.append(0, self.totals)[place]

    @property
    def end(self) -> int:
        """What it is in the end."""
        return int(self.totals[-1]) if len(self.totals) else 0


def steps(evaluations: NDArray[np.int64], changes: NDArray[np.integer] | NDArray[np.bool_]) -> Steps:
    """Add `changes` (n,) up, each of which came with the counted evaluation of that number (n,)."""
    some = np.flatnonzero(changes)
    return Steps(evaluations[some], np.cumsum(changes[some], dtype=np.int64))
