"""Spare tries: second tries in cells whose grasp is weak, where the frontier has less to offer.

A second try takes the best grasp from around the cell. How often it gives a robust one tells, about, the
share of the cell's 26 neighbours that hold one; what the tries so far gave corrects it. A robust grasp in
place of a weak one adds no cell: it counts `VALUE` of one, and is tried where that is more than what an
evaluation at the frontier brought lately. So a search whose frontier is rich makes no such try.
"""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats
from qdgrasp_coordinator.searches.frontier import NEIGHBOURS, Frontier, Places, top
from qdgrasp_coordinator.searches.hints import Hints

VALUE = 1 / 3
"""What a robust grasp in place of a weak one is worth, against a success in an empty cell."""
AGAIN = 0.5
"""The most such tries in a generation, as a share of those that count at the frontier."""
TRUST = 20.0
"""As many kept promises are taken for granted before the first try."""
FADING = 0.9
"""What an older generation weighs against the next, where it is asked what the frontier brought lately."""
NOTHING = np.zeros(0)


class Spare:
    """Tries for better grasps in cells whose grasp is not robust."""

    def __init__(self, frontier: Frontier, hints: Hints) -> None:
        self._frontier = frontier
        self._hints = hints
        self._robust = np.zeros(frontier.size, np.bool_)
        self._around = np.zeros(frontier.size, np.uint8)
        """How many of the neighbours of each cell hold a robust grasp."""
        self._open: dict[int, Floats] = {}
        """Of generations that are not told yet, what each of their tries promised."""
        self._promised = self._given = TRUST
        self._tries, self._successes = 1.0, 1.0
        """At the frontier, lately, and of one try before all that was taken for a success."""

    def ask(self, generation: int, generator: np.random.Generator) -> Places:
        """The weak cells to try in a generation."""
        weak, most = self._hints.weak, int(AGAIN * (1.0 - FADING) * self._tries)
        weak = top(weak, self.worth(weak), most, generator)
        tries: Places = weak[VALUE * self.worth(weak) > self._successes / self._tries]
        self._open[generation] = self._shares(tries)
        return tries

    def tell(self, generation: int, fresh: NDArray[np.bool_], again: NDArray[np.bool_]) -> None:
        """Hear what became of a generation.

        Parameters
        ----------
        fresh
            (n,): which of the tries in empty cells that count succeeded.
        again
            (m, 2): of rows that begin with the spare tries, which count, and which are robust grasps.
        """
        promised = self._open.pop(generation, NOTHING)
        counts, is_robust = again[: len(promised)].T
        self._promised += float(promised[counts].sum())
        self._given += float(np.count_nonzero(is_robust & counts))
        self._tries = FADING * self._tries + len(fresh)
        self._successes = FADING * self._successes + float(np.count_nonzero(fresh))

    def succeed(self, places: Places) -> None:
        """Hear of robust grasps in `places` (n,), in any order and repeated."""
        new = np.unique(places[~self._robust[places]])
        self._robust[new] = True
        np.add.at(self._around, self._frontier.around(new).ravel(), 1)

    def worth(self, places: Places) -> Floats:
        """How likely a try in each of `places` (n,) gives a robust grasp, over the tries there so far."""
        tries = np.maximum(self._frontier.spent(places), 1.0)
        likely: Floats = self._shares(places) * (self._given / self._promised) / tries
        return likely

    def _shares(self, places: Places) -> Floats:
        shares: Floats = self._around[places] / len(NEIGHBOURS)
        return shares
