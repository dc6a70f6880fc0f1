"""Spare tries: second tries in cells whose grasp is weak, where the frontier has less to offer.

A second try takes the best grasp from around the cell. How often it gives a robust one tells, about, the
share of the cell's 26 neighbours that hold one; what the tries so far gave corrects it. A robust grasp in
place of a weak one adds no cell: it counts `VALUE` of one, and is tried where that beats what the empty cells
promise. So a search whose frontier is rich makes no such try, and one whose frontier is spent makes many.
"""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats
from qdgrasp_coordinator.searches.frontier import NEIGHBOURS, Frontier, Places, top
from qdgrasp_coordinator.searches.hints import Hints

VALUE = 0.25
"""What a robust grasp in place of a weak one is worth, against a success in an empty cell."""
AGAIN = 0.5
"""The greatest share of a generation for weak grasps."""
TRUST = 20.0
"""As many kept promises are taken for granted before the first try."""
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

    def ask(self, generation: int, best: Places, generator: np.random.Generator) -> Places:
        """The weak cells to try in a generation, instead of as many of the `best` empty ones."""
        weak = self._hints.weak
        weak = top(weak, self.worth(weak), int(AGAIN * len(best)), generator)
        weak = weak[np.argsort(-self.worth(weak), kind="stable")]
        empty = np.sort(self._frontier.worth(best))[: len(weak)]
        is_better = VALUE * self.worth(weak) > empty
        tries: Places = weak[: len(weak) if is_better.all() else is_better.argmin()]
        self._open[generation] = self._shares(tries)
        return tries

    def tell(self, generation: int, robust: NDArray[np.bool_], told: NDArray[np.bool_]) -> None:
        """Hear what became of a generation, its spare tries in front.

        Parameters
        ----------
        robust
            (n,): which of its rows are robust grasps.
        told
            (n,): which count as tried.
        """
        promised = self._open.pop(generation, NOTHING)
        told, robust = told[: len(promised)], robust[: len(promised)]
        self._promised += float(promised[told].sum())
        self._given += float(np.count_nonzero(robust & told))

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
