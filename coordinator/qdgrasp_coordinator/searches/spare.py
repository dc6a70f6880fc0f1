"""Spare tries: what a generation does where the frontier has little to offer."""

import numpy as np

from qdgrasp_coordinator.searches.frontier import Frontier, Places
from qdgrasp_coordinator.searches.hints import Hints

POOR = 0.05
"""What an empty cell must be worth; for less, a weak grasp is tried again."""
AGAIN = 0.5
"""The greatest share of a generation for weak grasps."""


class Spare:
    """Tries for better grasps in cells whose grasp is not robust, those with the fewest tries first."""

    def __init__(self, frontier: Frontier, hints: Hints) -> None:
        self._frontier = frontier
        self._hints = hints

    def targets(self, best: Places, n: int, generator: np.random.Generator) -> Places:
        """The cells to try instead of some of the `best` empty ones, in a generation that aims `n` times."""
        is_poor = self._frontier.worth(best) < POOR
        spare = min(int(np.count_nonzero(is_poor)), int(AGAIN * n))
        return self._frontier.rarest(self._hints.weak, spare, generator)
