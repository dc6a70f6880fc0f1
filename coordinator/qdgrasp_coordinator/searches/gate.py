"""The gate: how likely a success a candidate must be for a simulation to be spent on it.

Screening candidates costs less than simulating one, so that it pays to draw more of them and to be choosy; up
to a point, which is a share of genomes that are simulated. A cell that gave no candidate is asked again, and
for less each time.
"""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats

WANTED = 0.8
"""What is asked of a cell's first candidates."""
LESS = 0.5
"""How much less for each dead end: wanted / (dead ends * LESS + 1)."""
SHARE = 0.1
"""The least share of genomes that are to be simulated; where it is less, less is wanted."""
STEP = 0.9
"""What a generation changes."""
LEAST = 1e-3
"""What is asked of a candidate at the least."""


class Gate:
    """Opens and closes by how many poses get through."""

    def __init__(self) -> None:
        self._wanted = WANTED
        self.share = 1.0
        """The share of the last generation's genomes that got through, `SHARE` at the least."""

    def wanted(self, dead_ends: NDArray[np.int32]) -> Floats:
        """How likely a success must be for a simulation, in cells (n,) with so many dead ends."""
        wanted: Floats = np.maximum(LEAST, self._wanted / (LESS * dead_ends.astype(np.float64) + 1.0))
        return wanted

    def tell(self, through: NDArray[np.bool_]) -> None:
        """Hear which genomes (n,) of a generation became evaluations."""
        is_narrow = np.count_nonzero(through) < SHARE * len(through)
        self.share = max(SHARE, float(through.mean()))
        wanted = self._wanted * STEP if is_narrow else self._wanted / STEP
        self._wanted = min(WANTED, max(LEAST, wanted))
