"""The knowledge of a search: the grasps that hold by cell, and the tries.

Poses are told apart in three ways that are known before a pose is simulated: by the 1 cm cell of the hand; by
the cell and its orientation bin, a niche; and by the *grip*, the region of the middle of the expected
contacts with the side that the hand is on. Each is open while no grasp holds in it and it was tried less than
`MOST_TRIES` times.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_assets.geometry.rotation import Floats, dot, rotate, tangents, unit
from qdgrasp_coordinator.metrics.arrays import take_rows
from qdgrasp_coordinator.metrics.cells import BINS, PER_METRE, cells, first_occurrences, orientations
from qdgrasp_coordinator.metrics.contact_niches import combined_niches, contact_niches, link_contacts
from qdgrasp_coordinator.metrics.grasp_quality import object_motion
from qdgrasp_coordinator.search.base import PositionBox, SearchSpace
from qdgrasp_coordinator.search.paper_searches import CellBox
from qdgrasp_protocol.rows import Genomes, Outcome, Rows
from qdgrasp_protocol.spec import RunSpec

Places = NDArray[np.intp]  # (n,): cells of a grid, as places in it
NEIGHBOURS = np.array([step for step in np.ndindex(3, 3, 3) if step != (1, 1, 1)]) - 1
"""(26, 3): the steps from a cell to those around it."""
MOST_TRIES = 2
MANY_TRIES = 24  # Of a cell beside one in which a grasp holds, before nothing else is expected there
GUESSED_TRIES = 2.0  # What the average chance counts for in that of a grip
CELL_OPEN, TRIED_OFTEN, SECOND, NOTHING_NEW = range(1, 5)
"""Levels of poses.

Up to `CELL_OPEN` in an open cell (0: of an open grip too); in a cell that was tried often, beside one that
holds; with a second orientation in a cell; of which nothing new is expected.
"""
STILL = 0.004
"""Motion of the object while the hand closes [m] that halves the preference for a still grasp.

Grasps whose fingers meet at once hardly move it; they are surer, and cheaper to build on.
"""


@dataclass(frozen=True)
class Proposals:
    """Poses that an emitter proposes."""

    genomes: Genomes
    """(n, d), of the prior `given`."""
    middles: Floats
    """(n, 3) [m]: the middle of the expected contacts, CoM frame."""

    def __len__(self) -> int:
        return len(self.genomes)

    def __getitem__(self, places: NDArray[np.intp]) -> "Proposals":
        return Proposals(self.genomes[places], self.middles[places])

    def joined(self, other: "Proposals") -> "Proposals":
        """These poses, and then those of `other`."""
        return Proposals(
            np.concatenate([self.genomes, other.genomes]), np.concatenate([self.middles, other.middles])
        )


class CellGrid(CellBox):
    """The cells of a box as places in a grid, with a rim of one cell that no step leaves."""

    def __init__(self, box: PositionBox) -> None:
        super().__init__(box)
        self._shape = tuple((self.high - self.low + 3).tolist())
        self.size = int(np.prod(self._shape))
        self._around = NEIGHBOURS @ np.array([self._shape[1] * self._shape[2], self._shape[2], 1])
        inside = np.zeros(self._shape, np.bool_)
        inside[1:-1, 1:-1, 1:-1] = True
        self.inside: NDArray[np.bool_] = inside.reshape(-1)
        """Flags of the places that are not on the rim."""

    def places(self, positions: ArrayLike) -> Places:
        """The place (n,) of each position (n, 3) [m]; outside the box that of a corner of the rim."""
        found = cells(positions)
        shifted = np.where(self.contains(found)[:, None], found - self.low + 1, 0)
        places: Places = np.ravel_multi_index(tuple(shifted.T), self._shape)
        return places

    def middles(self, places: Places) -> Floats:
        """The middle (n, 3) [m] of the cells at `places` (n,)."""
        indices = np.stack(np.unravel_index(places, self._shape), axis=1)
        middles: Floats = (indices - 1 + self.low) / PER_METRE
        return middles

    def around(self, places: Places) -> Places:
        """The 26 neighbours (n, 26) of cells that are in the box."""
        around: Places = places[:, None] + self._around
        return around


class Explored:
    """Niches or grips: the tries in each, those that held, and those that found a contact niche."""

    def __init__(self) -> None:
        self._held, self._tries = Counter[int](), Counter[int]()
        self.found = Counter[int]()

    def is_open(self, keys: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Flag those of `keys` (n,) that are open, at their first occurrence: (n,)."""
        return self._flags(keys, lambda key: key not in self._held and self._tries[key] < MOST_TRIES)

    def chances(self, keys: NDArray[np.integer]) -> tuple[Floats, Floats]:
        """Return the shares (n,) of tries expected to hold, and to find a contact niche.

        What was not tried is expected to hold as the average does, and all that holds there to be new.
        """
        average = max(self._held.total(), 1) / max(self._tries.total(), 50)
        counts = [(self._held[key], self.found[key], self._tries[key]) for key in keys.tolist()]
        held, found, tries = np.array(counts, np.float64).reshape(-1, 3).T
        guessed = GUESSED_TRIES * average
        return (held + guessed) / (tries + GUESSED_TRIES), (found + guessed) / (tries + GUESSED_TRIES)

    def count_tries(self, keys: NDArray[np.integer]) -> None:
        """Count a try in each of `keys` (n,)."""
        self._tries.update(keys.tolist())

    def hold(self, keys: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Record grasps that hold; flag those (n,) that are the first of their key."""
        is_first = self._flags(keys, lambda key: key not in self._held)
        self._held.update(keys.tolist())
        return is_first

    def __len__(self) -> int:
        """Return the number of those that hold a grasp."""
        return len(self._held)

    @staticmethod
    def _flags(keys: NDArray[np.integer], chosen: Callable[[int], bool]) -> NDArray[np.bool_]:
        found = first_occurrences(keys)
        found[found] = [chosen(key) for key in keys[found].tolist()]
        return found


class GraspMap:
    """The grasps that hold, the best of each cell in a pyribs archive, and the tries so far."""

    def __init__(self, spec: RunSpec, space: SearchSpace) -> None:
        self.grid = CellGrid(space.box)
        self.held = np.zeros(self.grid.size, np.bool_)
        """Flags, by place, of the cells in which a grasp holds."""
        self.neighbours = np.zeros(self.grid.size, np.uint8)
        """The number of such cells around each."""
        self.tries = np.zeros(self.grid.size, np.int32)
        self.niches, self.grips, self.contacts = Explored(), Explored(), Explored()
        """Niches and grips of poses, and the contact niches that were found."""
        self._least = Outcome.DROPPED if spec.aim_for == "touch" else Outcome.HELD
        self._by = spec.diversity or "position"
        hand = space.scene.gripper
        self._axis, self._reach = np.array([hand.approach_axis]), hand.reach
        fields = {"middle": ((3,), np.float64), "line": ((3,), np.float64)}
        make = partial(self.grid.archive, space.genes, dtype=np.float64, extra_fields=fields)
        self._archive = cache(make)  # pyribs is loaded when the first grasp holds
        self._set_elites(np.empty((0, space.genes)), np.empty((0, 3)), np.empty((0, 3)))

    def __len__(self) -> int:
        """Return the number of cells in which a grasp holds."""
        return len(self.genomes)

    def levels(self, proposals: Proposals) -> NDArray[np.intp]:
        """Return how little each pose promises that is new: (n,), 0 the most, up to `NOTHING_NEW`."""
        places, niches, grips = self._keys(proposals)
        is_first = first_occurrences(places)
        by_cell = is_first & ~self.held[places] & (self.tries[places] < MOST_TRIES)
        by_niche, by_grip = self.niches.is_open(niches), self.grips.is_open(grips)
        wanted = {"position": by_cell, "orientation": by_niche, "contact": by_grip}[self._by]
        levels = np.where(by_niche, SECOND, NOTHING_NEW)
        levels[is_first & self.worth_many_tries(places)] = TRIED_OFTEN
        levels[wanted] = np.where(by_grip, 0, CELL_OPEN)[wanted]
        return np.where(self.grid.inside[places], levels, NOTHING_NEW)

    def expected_gains(self, proposals: Proposals) -> Floats:
        """Return the gain (n,) that open cells may be expected to bring, by how grips did."""
        _, _, grips = self._keys(proposals)
        return self._gains(*self.grips.chances(grips))

    def worth_many_tries(self, places: Places) -> NDArray[np.bool_]:
        """Flag the cells (n,) beside one that holds that were tried less than `MANY_TRIES` times."""
        is_worth: NDArray[np.bool_] = (
            (self.neighbours[places] > 0) & ~self.held[places] & (self.tries[places] < MANY_TRIES)
        )
        return is_worth

    def count_tries(self, proposals: Proposals) -> None:
        """Count a try of each pose, before its result is known."""
        places, niches, grips = self._keys(proposals)
        np.add.at(self.tries, places, 1)
        self.niches.count_tries(niches)
        self.grips.count_tries(grips)

    def learn(self, rows: Rows, middles: Floats) -> Floats:
        """Learn from rows with contacts expected about `middles` (n, 3) [m]; return gains (n,).

        A gain is the relative growth of the number of cells (niches by orientation), and of that of contact
        niches: so both are worth the same, however many there are. Where touching is the objective, contacts
        count for nothing: it is the paper's measure, which knows cells alone.
        """
        (places,) = np.nonzero((rows["outcome"] >= self._least) & self._is_inside(rows))
        held, gains = take_rows(rows, places), np.zeros(len(rows))
        found, niches, grips = self._keys(Proposals(held["genome"], middles[places]))
        is_new_cell = self._hold(found)
        is_new_niche, touches = self.niches.hold(niches), contact_niches(held)
        self.grips.hold(grips)
        is_new = is_new_niche if self._by == "orientation" else is_new_cell
        is_new_contact = self.contacts.hold(touches) & (touches > 0)
        self.grips.found.update(grips[is_new_contact].tolist())
        gains[places] = self._gains(is_new, is_new_contact)
        self._offer(held)
        return gains

    def _gains(self, new_cells: ArrayLike, new_contacts: ArrayLike) -> Floats:
        """Return the relative growth (n,) by new cells (n,) and new contact niches (n,)."""
        n = len(self.niches) if self._by == "orientation" else int(np.count_nonzero(self.held))
        weight = 1.0 if self._least is Outcome.HELD else 0.0
        contacts = weight * np.asarray(new_contacts) / max(len(self.contacts), 20)
        gains: Floats = np.asarray(new_cells) / max(n, 50) + contacts
        return gains

    def _is_inside(self, rows: Rows) -> NDArray[np.bool_]:
        return self.grid.inside[self.grid.places(rows["genome"][:, :3])]

    def _keys(self, proposals: Proposals) -> tuple[Places, NDArray[np.integer], NDArray[np.integer]]:
        """Return the place, the niche and the grip (n,) of poses."""
        positions, middles = proposals.genomes[:, :3].astype(np.float64), proposals.middles
        places = self.grid.places(positions)
        niches = places * BINS + orientations(proposals.genomes[:, 3:7])
        is_point = np.ones((len(places), 1), np.bool_)
        return places, niches, combined_niches(middles[:, None], is_point, positions - middles)

    def _hold(self, places: Places) -> NDArray[np.bool_]:
        """Record grasps that hold in cells; flag those (n,) that are the first in theirs."""
        is_new = first_occurrences(places) & ~self.held[places]
        new = places[is_new]
        self.held[new] = True
        np.add.at(self.neighbours, self.grid.around(new).ravel(), 1)
        return is_new

    def _offer(self, rows: Rows) -> None:
        """Offer grasps that hold to the archive, the one with the least motion wins."""
        if not len(rows):
            return
        moved = np.nan_to_num(object_motion(rows)[:, 0])
        ranks = rows["outcome"] + np.rint(1000.0 / (1.0 + moved / STILL)) / 2000.0
        middles, lines = self._grip_lines(rows)
        measures = cells(rows["genome"][:, :3])
        self._archive().add(rows["genome"], ranks, measures, middle=middles, line=lines)
        held = self._archive().data(["index", "solution", "middle", "line"])
        order = np.argsort(held["index"])
        self._set_elites(held["solution"][order], held["middle"][order], held["line"][order])

    def _grip_lines(self, rows: Rows) -> tuple[Floats, Floats]:
        """Return the middle of contacts (n, 3) [m] and the line of the two farthest apart (n, 3).

        Without contacts the middle is in reach along the approach axis; with fewer than two the line is any
        across that axis.
        """
        poses = rows["genome"].astype(np.float64)
        approach = rotate(poses[:, 3:7], np.repeat(self._axis, len(poses), axis=0))
        middles, lines = poses[:, :3] + self._reach * approach, tangents(approach)[0]
        if not rows.dtype["contact_links"].shape[0]:
            return middles, lines
        means, is_link = link_contacts(rows)
        for row, (points, is_point) in enumerate(zip(means, is_link, strict=True)):
            if len(points := points[is_point]):
                middles[row] = points.sum(axis=0) / len(points)
            if len(points) > 1:
                ways = (points[:, None] - points).reshape(-1, 3)
                lines[row] = unit(ways[None, dot(ways, ways).argmax()])[0]
        return middles, lines

    def _set_elites(self, genomes: Floats, middles: Floats, lines: Floats) -> None:
        """Take over the elites of the archive, in the order of its cells."""
        self.genomes = genomes
        """(m, d): the best grasp of each cell that holds one."""
        self.middles = middles
        """(m, 3) [m]: the middle of its contacts, CoM frame."""
        self.lines = lines
        """(m, 3): unit vectors along which its fingers press."""
        self.elite_of = np.full(self.grid.size, -1, np.intp)
        """(cells,): the row of these that is in a cell; -1: none."""
        self.elite_of[self.grid.places(self.genomes[:, :3])] = np.arange(len(genomes))
