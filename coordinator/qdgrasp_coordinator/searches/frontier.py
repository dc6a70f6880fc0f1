"""The frontier: the empty cells beside successes, and which of them to try next.

A cell is worth a try when it is likely to hold a success and little was spent on it:
likelihood / (tries + dead ends / 2 + 1), where a try is a simulated pose and a dead end a genome of which
nothing could be simulated. How likely it is, the search learns, from the distance between the cell and the
contact point of the nearest success beside it, and from how many of its 26 neighbours hold a success. It does
not begin from nothing: in units of a hand's reach, all hands and objects teach nearly the same.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_assets.rotation import Floats, dot
from qdgrasp_coordinator.counts.cells import PER_METRE, cells
from qdgrasp_coordinator.searches.archive import Box
from qdgrasp_coordinator.searches.logistic import Logistic

Places = NDArray[np.intp]
"""(n,): cells of a frontier, as places in its grid."""
DEAD_END = 0.5
"""What a dead end weighs against a try: it costs no simulation, and the next draw may be none."""
USUAL = (1.0, -5.0, 3.0, 2.0)
"""What `features` weigh before the first fit: what finished runs of all hands and objects nearly agree on."""
ANYWHERE = (0.0, np.inf)
NEIGHBOURS = np.array([step for step in np.ndindex(3, 3, 3) if step != (1, 1, 1)]) - 1
"""(26, 3): the steps from a cell to those around it."""


class Frontier:
    """All cells of a box, with what was tried in them.

    Every step costs what it concerns, never a pass over all cells: a large hand around a large object has
    some 400 000.

    Parameters
    ----------
    box
        The box of positions, enlarged to whole cells.
    reach
        The greatest distance from the hand to the surface point that it looks at [m].
    within
        The least and the greatest distance of a cell from a success's contact point beside it, for it to be
        aimed at [m].
    """

    def __init__(self, box: Box, reach: float, within: tuple[float, float] = ANYWHERE) -> None:
        self._low, self._high = cells(np.stack([np.asarray(corner) for corner in box]))
        self._shape = tuple(
            (self._high - self._low + 3).tolist()
        )  # one more on every side: no step leaves it
        size = int(np.prod(self._shape))
        self._around = NEIGHBOURS @ np.array([self._shape[1] * self._shape[2], self._shape[2], 1])
        self._tries = np.zeros(size, np.int32)
        self._dead_ends = np.zeros(size, np.int32)
        self._successful = np.zeros(size, np.bool_)
        self._neighbours = np.zeros(size, np.uint8)
        self._distances = np.full(size, np.inf, np.float32)
        self._farthest = np.zeros(size, np.float32)
        self._reach = reach
        self._within = within
        self._model = Logistic(USUAL)
        inside = np.zeros(self._shape, np.bool_)
        inside[1:-1, 1:-1, 1:-1] = True
        self._inside = inside.reshape(-1)
        self._edge: Places = np.zeros(0, np.intp)

    @property
    def size(self) -> int:
        """How many places there are: the cells of the box, and those around it, which stay empty."""
        return len(self._tries)

    @property
    def edge(self) -> Places:
        """The empty cells beside a success, those that became so first in front."""
        return self._edge

    @property
    def successful(self) -> NDArray[np.bool_]:
        """Which cells, by place, hold a success."""
        return self._successful

    def places(self, positions: ArrayLike) -> Places:
        """The cell (n,) of each position (n, 3) [m]; -1 outside the box."""
        found = cells(positions)
        inside = ((found >= self._low) & (found <= self._high)).all(axis=1)
        shifted = np.where(inside[:, None], found - self._low + 1, 0)
        return np.where(inside, np.ravel_multi_index(tuple(shifted.T), self._shape), -1)

    def centres(self, places: Places) -> NDArray[np.float64]:
        """The middle (n, 3) [m] of cells (n,)."""
        indices = np.stack(np.unravel_index(places, self._shape), axis=1)
        centres: NDArray[np.float64] = (indices - 1 + self._low) / PER_METRE
        return centres

    def around(self, places: Places) -> Places:
        """The 26 neighbours (n, 26) of cells (n,); those beyond the box never hold a success."""
        around: Places = places[:, None] + self._around
        return around

    def aim(self, places: Places) -> None:
        """Count a try in each of `places` (n,), which may repeat; until it is heard of, it counts as one."""
        np.add.at(self._tries, places, 1)

    def fail(self, places: Places) -> None:
        """Hear that tries in `places` (n,) were dead ends."""
        np.add.at(self._tries, places, -1)
        np.add.at(self._dead_ends, places, 1)

    def succeed(self, places: Places, contacts: Floats) -> None:
        """Hear that `places` (n,), in any order and repeated, hold successes at `contacts` (n, 3) [m]."""
        new, first = np.unique(places, return_index=True)
        is_new = ~self._successful[new]
        new, contacts = new[is_new], contacts[first[is_new]]
        if not len(new):
            return
        self._successful[new] = True
        around = self.around(new).ravel()
        ways = self.centres(around) - np.repeat(contacts, len(NEIGHBOURS), axis=0)
        distances = np.sqrt(dot(ways, ways)).astype(np.float32)
        np.minimum.at(self._distances, around, distances)
        np.maximum.at(self._farthest, around, distances)
        touched = np.unique(around[(self._neighbours[around] == 0) & self._inside[around]])
        np.add.at(self._neighbours, around, 1)
        edge = np.concatenate([self._edge, touched])
        self._edge = edge[~self._successful[edge]]

    def features(self, places: Places) -> Floats:
        """What is known of cells (n,) beside successes before they are tried: (n, 4).

        The distance in units of the hand's reach, its square, the share of successful neighbours, and 1.
        """
        distances = self._distances[places].astype(np.float64) / self._reach
        shares = self._neighbours[places] / len(NEIGHBOURS)
        return np.stack([distances, distances * distances, shares, np.ones(len(places))], axis=1)

    def learn(self, features: Floats, successes: NDArray[np.bool_]) -> None:
        """Hear what became of tries in cells with such `features` (n, 4) when they were aimed at."""
        self._model.learn(features, successes)

    def worth(self, places: Places) -> Floats:
        """What a try in each of `places` (n,) promises, 0 to 1."""
        worth: Floats = self._model.likely(self.features(places)) / (self.spent(places) + 1.0)
        return worth

    def best(self, n: int, generator: np.random.Generator, among: Places | None = None) -> Places:
        """The `n` of the edge, or of `among`, that are worth most; fewer where there are not so many.

        Among equals `generator` draws.
        """
        places = self._edge[self._are_near(self._edge)] if among is None else among
        return top(places, self.worth(places), n, generator)

    def _are_near(self, places: Places) -> NDArray[np.bool_]:
        """Which of cells (n,) may be as far from a contact point as is wanted."""
        least, greatest = self._within
        return (self._farthest[places] >= least) & (self._distances[places] <= greatest)

    def dead_ends(self, positions: Floats) -> NDArray[np.int32]:
        """How many dead ends there were in the cells of `positions` (n, 3) [m]; none outside the box."""
        places = self.places(positions)
        return np.where(places >= 0, self._dead_ends[places], 0)

    def spent(self, places: Places) -> Floats:
        """What was spent on each of `places` (n,): tries, and dead ends for less."""
        spent: Floats = self._tries[places] + DEAD_END * self._dead_ends[places]
        return spent


def top(places: Places, worth: NDArray[np.float64], n: int, generator: np.random.Generator) -> Places:
    """The `n` of `places` with the greatest worth; among equals `generator` draws."""
    if len(places) <= n or not n:
        return places[:n]
    least = np.partition(worth, -n)[-n]
    sure, equal = places[worth > least], places[worth == least]
    return np.concatenate([sure, generator.choice(equal, n - len(sure), replace=False)])
