"""Hints: the grasp that each successful cell passes on to its neighbours.

It is the contact point, the roll and the posture of the best success in the cell. The roll is kept as a
vector of the hand, so that it can be read about the direction in which a neighbour will look: as a number it
belongs to a frame that jumps between directions (`rotation.tangents`).
"""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats, rolls, rotate, tangents, unit
from qdgrasp_assets.scene import Vector
from qdgrasp_coordinator.searches.frontier import Places
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows

CHANCE = 3.0
"""What chance adds to a rank at most: so much that a dropped success is followed now and then where a held
one is near, and that equals are all followed in turn."""
NONE = -1
"""The slot of a place without a hint."""
FIRST = 256
"""Hints that there is room for at first; the room doubles."""


class Hints:
    """The best success of each place, by outcome and then fitness; of equals the elder.

    Parameters
    ----------
    places
        How many places there are.
    axis
        The hand's approach axis, base frame.
    posture
        How many genes, the last ones of a genome, are the posture: synergy and free joints.
    """

    def __init__(self, places: int, axis: Vector, posture: int) -> None:
        self._axis = np.array([axis], dtype=np.float64)
        self._slots = np.full(places, NONE, np.int32)
        fields = [("place", "i8"), ("outcome", "u1"), ("rank", "f8")]
        vectors = [("point", "f8", (3,)), ("aside", "f8", (3,)), ("posture", "f4", (posture,))]
        self._kept = np.zeros(FIRST, [*fields, *vectors])
        self._size = 0

    def __len__(self) -> int:
        """How many places have a hint."""
        return self._size

    def learn(self, places: Places, rows: Rows) -> None:
        """Offer the successes `rows` (n,), elder ones first, found in `places` (n,)."""
        best = _best(places, rows)
        best = best[_ranks(rows[best]) > self.ranks(places[best])]
        self._keep(self._rooms(places[best]), places[best], rows[best])

    def points(self, places: Places) -> Floats:
        """The surface points (n, 3) [m] that the grasps at `places` (n,) look at."""
        return self._at("point", places)

    def distances(self, options: Places, points: Floats) -> Floats:
        """How far the surface points of `options` (n, k) are from points (n, 3): (n, k) [m]."""
        ways = self._at("point", options) - points[:, None]
        distances: Floats = np.sqrt((ways * ways).sum(axis=2))
        return distances

    def rolls(self, places: Places, directions: Floats) -> Floats:
        """The rolls (n,) [rad] of the grasps at `places` (n,), read about other unit `directions` (n, 3)."""
        return rolls(self._at("aside", places), directions)

    def postures(self, places: Places) -> Floats:
        """Their genes of synergy and free joints: (n, k)."""
        return self._at("posture", places)

    def ranks(self, places: Places) -> Floats:
        """How good they are, for comparison alone: (n,), below zero where there is none."""
        slots = self._slots[places]
        return np.where(slots == NONE, -1.0, self._kept["rank"][slots])

    def preference(self, options: Places, generator: np.random.Generator) -> Floats:
        """How far each of `options` (n, k) is preferred, by outcome and by chance: (n, k).

        -1 where there is none.
        """
        ranks = self.ranks(options)
        return np.where(ranks < 0, -1.0, ranks + CHANCE * generator.random(options.shape))

    @property
    def weak(self) -> Places:
        """The places whose best success is not robust, in the order of discovery."""
        kept = self._kept[: self._size]
        places: Places = kept["place"][kept["outcome"] < Outcome.HELD]
        return places

    def _at(self, name: str, places: Places) -> Floats:
        values: Floats = self._kept[name][self._slots[places]].astype(np.float64)
        return values

    def _rooms(self, places: Places) -> NDArray[np.int32]:
        """The slots of distinct `places`; those that have none get the next ones."""
        new = places[self._slots[places] == NONE]
        while self._size + len(new) > len(self._kept):
            self._kept = np.concatenate([self._kept, np.zeros_like(self._kept)])
        self._slots[new] = np.arange(self._size, self._size + len(new))
        self._size += len(new)
        return self._slots[places]

    def _keep(self, slots: NDArray[np.int32], places: Places, rows: Rows) -> None:
        behind = self._kept["posture"].shape[1]
        rotations = unit(rows["base_to_object"][:, 3:].astype(np.float64))
        first, _ = tangents(np.broadcast_to(self._axis, (len(rows), 3)))
        columns = {
            "place": places,
            "outcome": rows["outcome"],
            "rank": _ranks(rows),
            "point": rows["surface_point"],
            "aside": rotate(rotations, first),
            "posture": rows["genome"][:, rows["genome"].shape[1] - behind :],
        }
        for name, values in columns.items():
            self._kept[name][slots] = values


def _ranks(rows: Rows) -> Floats:
    """A number for each of `rows` that orders them by outcome and then by fitness."""
    fitness = rows["fitness"].astype(np.float64)
    ranks: Floats = rows["outcome"] + fitness / (1.0 + fitness)
    return ranks


def _best(places: Places, rows: Rows) -> NDArray[np.intp]:
    """For each distinct one of `places` (n,) its best row, of equals the first: (m,), as indices."""
    best_first = np.argsort(-_ranks(rows), kind="stable")
    _, first = np.unique(places[best_first], return_index=True)
    return best_first[first]
