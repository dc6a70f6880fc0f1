"""The frontier of cells that a search may aim at, and the best grasp of each success cell.

The worth of a try in a cell is promise / (tries + dead ends / 2 + 1), where a try is a simulated pose and a
dead end a genome of which no pose could be simulated. Two models learn the promise of a cell from the
distance between the cell and the contact point of the nearest success beside it, and from its 26 neighbours.
They begin with weights of other runs: in units of a hand's reach, they are nearly the same for all hands and
objects.

A successful cell passes on to its neighbours the contact point, the roll and the posture of its best
success. The roll is kept as a vector of the hand, so that it can be read about the direction in which a
neighbour will look: as a number it belongs to a frame that jumps between directions (`rotation.tangents`).
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_assets.genes import TOUCH_VALUE
from qdgrasp_assets.geometry.rotation import Floats, dot, rolls, rotate, tangents, unit
from qdgrasp_assets.scene import Vector
from qdgrasp_coordinator.metrics.cells import PER_METRE, cells
from qdgrasp_coordinator.search.base import PositionBox
from qdgrasp_coordinator.search.success_model import NO_WEIGHTS, first_model
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import FirstWeights

Places = NDArray[np.intp]  # (n,): cells of a frontier, as places in its grid
FULL_QUALITY = 0.9  # Quality from which a cell's possible gain is not worth a try
DEAD_END = 0.5  # Weight of a dead end against a try: it costs no simulation, and the next may do better
ANYWHERE = (0.0, np.inf)
NEIGHBOURS = np.array([step for step in np.ndindex(3, 3, 3) if step != (1, 1, 1)]) - 1
"""(26, 3): the steps from a cell to those around it."""


class Frontier:
    """All cells of a box, enlarged to whole cells, with the tries and the best quality in them.

    `reach` is the greatest distance from the hand to the surface point that it looks at [m], `within` the
    least and the greatest distance [m] from a success's contact point of a cell to aim at; the models begin
    with the weights `first`. Every step visits only the cells that it concerns, never all: a large hand
    around a large object has some 400 000.
    """

    def __init__(
        self,
        box: PositionBox,
        reach: float,
        within: tuple[float, float] = ANYWHERE,
        first: FirstWeights = NO_WEIGHTS,
    ) -> None:
        self._low, self._high = cells(np.stack([np.asarray(corner) for corner in box]))
        # One more cell on every side: no step leaves it.
        self._shape = tuple((self._high - self._low + 3).tolist())
        size = int(np.prod(self._shape))
        self._around = NEIGHBOURS @ np.array([self._shape[1] * self._shape[2], self._shape[2], 1])
        self._tries = np.zeros(size, np.int32)
        self._dead_ends = np.zeros(size, np.int32)
        self.successful = np.zeros(size, np.bool_)  # Flags, by place, of the cells that hold a success
        self._neighbours = np.zeros(size, np.uint8)
        self._distances = np.full(size, np.inf, np.float32)
        self._farthest = np.zeros(size, np.float32)
        self._reach = reach
        self._within = within
        self.touch = first_model("cell_touch", first.cell_touch)
        self.quality = first_model("cell_quality", first.cell_quality)
        self._best = np.zeros(size)
        self._best_around = np.zeros(size)
        self._is_known = np.zeros(size, np.bool_)
        inside = np.zeros(self._shape, np.bool_)
        inside[1:-1, 1:-1, 1:-1] = True
        self._inside = inside.reshape(-1)
        self.edge: Places = np.zeros(0, np.intp)
        """The cells that may be aimed at, in the order in which they became so."""

    @property
    def size(self) -> int:
        """Number of places: the cells of the box, and those around it, which stay empty."""
        return len(self._tries)

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

    def block(self, places: Places) -> Places:
        """The 26 neighbours of cells (n,), followed by the cells themselves: (n, 27)."""
        return np.concatenate([self.around(places), places[:, None]], axis=1)

    def count_tries(self, places: Places) -> None:
        """Count a try in each of `places` (n,), which may repeat, before its result is known."""
        np.add.at(self._tries, places, 1)

    def count_dead_ends(self, places: Places) -> None:
        """Count tries in `places` (n,) as dead ends instead."""
        np.add.at(self._tries, places, -1)
        np.add.at(self._dead_ends, places, 1)

    def _keep_distances(self, places: NDArray[np.intp], contacts: Floats) -> None:
        """Keep the nearest and farthest of contact points (n, 3) [m] from cells (n, k) beside each."""
        ways = self.centres(places.ravel()) - np.repeat(contacts, places.shape[1], axis=0)
        distances = np.sqrt(dot(ways, ways)).astype(np.float32)
        np.minimum.at(self._distances, places.ravel(), distances)
        np.maximum.at(self._farthest, places.ravel(), distances)

    def add_grasps(self, places: Places, contacts: Floats, quality: Floats) -> None:
        """Record successes in `places` (n,), repeated in any order, at `contacts` (n, 3) [m]."""
        new, first = np.unique(places, return_index=True)
        is_new = ~self.successful[new]
        self._open_cells(new[is_new], contacts[first[is_new]])
        before = self._best[new]
        np.maximum.at(self._best, places, quality)
        gain = self._best[new] - before
        np.add.at(self._best_around, self.around(new).ravel(), np.repeat(gain, len(NEIGHBOURS)))
        self.edge = self.edge[self._is_open(self.edge)]

    def _is_open(self, places: Places) -> NDArray[np.bool_]:
        """Return which of `places` (n,) may still gain something."""
        is_open: NDArray[np.bool_] = self._best[places] < FULL_QUALITY
        return is_open

    def _open_cells(self, new: Places, contacts: Floats) -> None:
        """Add distinct cells with their first success, and those around them, to the edge."""
        self.successful[new] = True
        around = self.around(new)
        np.add.at(self._neighbours, around.ravel(), 1)
        block = self.block(new)
        self._keep_distances(block, contacts)
        reached = block.ravel()
        fresh = np.unique(reached[~self._is_known[reached] & self._inside[reached]])
        self._is_known[fresh] = True
        self.edge = np.concatenate([self.edge, fresh])

    def features(self, places: Places) -> Floats:
        """Return the features (n, 6) of cells (n,), known before they are tried.

        The distance to the nearest contact point in units of the hand's reach, its square, the share of
        successful neighbours, the mean of the neighbours' best qualities, whether it has a success, and 1.
        """
        distances = np.minimum(self._distances[places].astype(np.float64) / self._reach, 2.0)
        return np.stack(
            [
                distances,
                distances * distances,
                self._neighbours[places] / len(NEIGHBOURS),
                self._best_around[places] / len(NEIGHBOURS),
                self.successful[places],
                np.ones(len(places)),
            ],
            axis=1,
        )

    def learn_quality(self, features: Floats, is_success: NDArray[np.bool_], quality: Floats) -> None:
        """Learn from tries in cells with such `features` (n, 6) when they were aimed at."""
        self.touch.learn(features, is_success)
        self.quality.learn(features[is_success], quality[is_success])

    def worth(self, places: Places) -> Floats:
        """Return the expected gain of a try in each of `places` (n,), over the tries spent there.

        A success of expected quality q raises a best of b by at most q (1 - b): exactly that, where a quality
        is 0 or 1.
        """
        features = self.features(places)
        touch = TOUCH_VALUE * (1.0 - features[:, 4])
        gain = self.quality.likely(features) * (1.0 - self._best[places])
        value = self.touch.likely(features) * (touch + (1.0 - TOUCH_VALUE) * gain)
        worth: Floats = value / (self.spent(places) + 1.0)
        return worth

    def best(self, n: int, generator: np.random.Generator) -> Places:
        """Return the `n` of the edge that are worth most; fewer if there are fewer.

        Among equals `generator` draws.
        """
        places, (least, greatest) = self.edge, self._within
        # Only cells that may be at a wanted distance from a contact point.
        places = places[(self._farthest[places] >= least) & (self._distances[places] <= greatest)]
        worth = self.worth(places)
        if len(places) <= n or not n:
            return places[:n]
        bound = np.partition(worth, -n)[-n]
        sure, equal = places[worth > bound], places[worth == bound]
        return np.concatenate([sure, generator.choice(equal, n - len(sure), replace=False)])

    def dead_ends(self, positions: Floats) -> NDArray[np.int32]:
        """Return the number of dead ends in the cells of `positions` (n, 3) [m]; 0 outside the box."""
        places = self.places(positions)
        return np.where(places >= 0, self._dead_ends[places], 0)

    def spent(self, places: Places) -> Floats:
        """Return the tries spent on each of `places` (n,); a dead end counts `DEAD_END`."""
        return self._tries[places] + DEAD_END * self._dead_ends[places]


RANK_NOISE = 3.0
"""Greatest random addition to a rank.

It is large enough that a dropped success is followed now and then where a held one is near, and that equals
are all followed in turn.
"""


class EliteStore:
    """The best success of each place; among equals the elder.

    `axis` is the hand's approach axis, base frame. The last `posture` genes are synergy and free joints.
    """

    def __init__(self, places: int, axis: Vector, posture: int) -> None:
        self._axis = np.array([axis], dtype=np.float64)
        vectors = [("point", "f8", (3,)), ("aside", "f8", (3,)), ("posture", "f4", (posture,))]
        self._kept = self._room(places, np.dtype([("rank", "f8"), *vectors]))

    @staticmethod
    def _room(places: int, kind: "np.dtype[np.void]") -> NDArray[np.void]:
        """Room for the elites of so many places, which have none."""
        room = np.zeros(places, kind)
        room["rank"] = -1.0
        return room

    def __len__(self) -> int:
        """Return the number of places that have an elite."""
        return int(np.count_nonzero(self._kept["rank"] >= 0))

    def offer(self, places: Places, rows: Rows, ranks: Floats) -> None:
        """Offer the successes `rows` (n,), elder ones first, found in `places` (n,).

        Their `ranks` (n,) are between `Outcome.DROPPED` and a little over `Outcome.HELD`.
        """
        best_first = np.argsort(-ranks, kind="stable")
        _, first = np.unique(places[best_first], return_index=True)
        best = best_first[first]  # the best row of each distinct place, of ties the first
        best = best[ranks[best] > self.ranks(places[best])]
        self._keep(places[best], rows[best], ranks[best])

    def points(self, places: Places) -> Floats:
        """The surface points (n, 3) [m] that the grasps at `places` (n,) look at."""
        return self._at("point", places)

    def distances(self, places: Places, points: Floats) -> Floats:
        """Return the distances [m] of surface points at places (n, ...) from points (n, ..., 3)."""
        ways = self._at("point", places) - points
        distances: Floats = np.sqrt((ways * ways).sum(axis=-1))
        return distances

    def rolls(self, places: Places, directions: Floats) -> Floats:
        """Return rolls (n,) [rad] of the grasps at `places`, about other unit `directions` (n, 3)."""
        return rolls(self._at("aside", places), directions)

    def postures(self, places: Places) -> Floats:
        """Return the genes of synergy and free joints at `places`: (n, k)."""
        return self._at("posture", places)

    def ranks(self, places: Places) -> Floats:
        """Return ranks, for comparison alone: (n,), below zero where there is no elite."""
        ranks: Floats = self._kept["rank"][places]
        return ranks

    def preference(self, options: Places, generator: np.random.Generator) -> Floats:
        """Return the preference of each of `options` (n, k), by outcome and by chance: (n, k).

        It is -1 where there is no elite.
        """
        ranks = self.ranks(options)
        return np.where(ranks < 0, -1.0, ranks + RANK_NOISE * generator.random(options.shape))

    def _at(self, name: str, places: Places) -> Floats:
        return self._kept[name][places].astype(np.float64)

    def _keep(self, places: Places, rows: Rows, ranks: Floats) -> None:
        behind = self._kept["posture"].shape[1]
        rotations = unit(rows["base_to_object"][:, 3:].astype(np.float64))
        first, _ = tangents(np.broadcast_to(self._axis, (len(rows), 3)))
        columns = {
            "rank": ranks,
            "point": rows["surface_point"],
            "aside": rotate(rotations, first),
            "posture": rows["genome"][:, rows["genome"].shape[1] - behind :],
        }
        for name, values in columns.items():
            self._kept[name][places] = values


def outcome_ranks(rows: Rows) -> Floats:
    """A number for each of `rows` that orders them by outcome and then by fitness."""
    fitness = rows["fitness"].astype(np.float64)
    return rows["outcome"] + fitness / (1.0 + fitness)
