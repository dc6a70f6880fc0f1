"""Niches: bins of hand position, orientation and synergy, and the best success of each.

The paper's archive and S_G tell grasps apart by position alone. A data set wants more: hands in one cell
that look elsewhere, are rolled, or close other fingers. That archive stays as it is.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics.cells import cells, orientations
from qdgrasp_coordinator.metrics.run_stats import successes
from qdgrasp_protocol.rows import GIVEN, NO_SYNERGY, Genomes, Layout, Rows

NicheKeys = NDArray[np.int64]
"""(n,): one number for each niche, ascending by cell, then synergy, then orientation."""
SYNERGY = "synergy"
ORIENTATION_BITS, SYNERGY_BITS, CELL_BITS = 6, 9, 16
_FARTHEST = (1 << (CELL_BITS - 1)) - 1
"""Greatest cell index on an axis, 327 m from the centre of mass; farther ones are clipped."""


@dataclass(frozen=True)
class SynergyReader:
    """Reader of the synergy that a genome closes the hand with."""

    layout: Layout

    def labels(self, genomes: Genomes) -> NDArray[np.int64]:
        """Return the label (n,) of each genome (n, d), as evaluation reads it, or `NO_SYNERGY`."""
        if SYNERGY not in self.layout.names:
            return np.full(len(genomes), NO_SYNERGY)
        place = self.layout.names.index(SYNERGY)
        gene, column = Layout(self.layout.prior, self.layout.genes[place : place + 1]), genomes[:, [place]]
        values = column if self.layout.prior == GIVEN else gene.values(column)
        return np.rint(values[:, 0]).astype(np.int64)


def synergies(scene: Scene, prior: str) -> SynergyReader:
    """Return the reader of synergies for genomes of a prior in a scene."""
    return SynergyReader(layout(scene, prior))


UNKNOWN_SYNERGIES = SynergyReader(Layout("", ()))  # Reader for an unknown scene: one synergy is taken for all


def niches(rows: Rows, synergies: SynergyReader) -> NicheKeys:
    """The niche of each row's pose: (n,)."""
    found = np.clip(cells(rows["descriptor"][:, :3]), -_FARTHEST, _FARTHEST) + _FARTHEST
    labels = synergies.labels(rows["genome"]) - NO_SYNERGY
    keys: NicheKeys = found[:, 0]
    for more, bits in (
        (found[:, 1], CELL_BITS),
        (found[:, 2], CELL_BITS),
        (labels, SYNERGY_BITS),
        (orientations(rows["base_to_object"][:, 3:]), ORIENTATION_BITS),
    ):
        keys = (keys << bits) | more
    return keys


def cell_of(keys: NicheKeys) -> NicheKeys:
    """One number for the cell of each niche: (n,)."""
    return keys >> (ORIENTATION_BITS + SYNERGY_BITS)


def without_orientation(keys: NicheKeys) -> NicheKeys:
    """One number for the cell and the synergy of each niche: (n,)."""
    return keys >> ORIENTATION_BITS


def without_synergy(keys: NicheKeys) -> NicheKeys:
    """One number for the cell and the orientation of each niche: (n,)."""
    orientation = keys & ((1 << ORIENTATION_BITS) - 1)
    return (cell_of(keys) << ORIENTATION_BITS) | orientation


TAKEN = ("outcome", "fitness", "contacts", "penetration", "generation", "index")
ITEMS = ("u1", "<f4", "u1", "<f4", "<u4", "<u4")
ELITE = np.dtype([("niche", "<i8"), *zip(TAKEN, ITEMS, strict=True)])
"""Stored fields of a niche's best success; (generation, index) is its row in the journal."""


class NicheArchive:
    """The best nominal success of each niche, 26 bytes each; at most one per success.

    One is better than another by its outcome; of equals by fitness; of equals with less penetration; of
    equals with more contacts; of equals the earlier one in the journal. In which order rows are offered
    does not matter.
    """

    def __init__(self, synergies: SynergyReader) -> None:
        self._synergies = synergies
        self._kept = np.zeros(0, ELITE)
        self._waiting: list[NDArray[np.void]] = []
        self._n_waiting = 0

    def inserting(self, blocks: Iterable[Rows]) -> Iterator[Rows]:
        """Yield the same blocks, each offered as it passes."""
        for block in blocks:
            self.insert(block)
            yield block

    def insert(self, rows: Rows) -> None:
        """Offer rows; only nominal successes are kept."""
        found = successes(rows)
        if len(found):
            self._waiting.append(self._elites(found))
            self._n_waiting += len(found)
        if self._n_waiting > max(4096, len(self._kept) // 4):  # each is sorted in a few times, not every time
            self._settle()

    def joined(self, other: "NicheArchive") -> "NicheArchive":
        """Merge two archives, which may read synergies from other genes; of equals this one's stays."""
        both = NicheArchive(self._synergies)
        both._kept = best_per_niche(np.concatenate([self.elites, other.elites]))
        return both

    @property
    def elites(self) -> NDArray[np.void]:
        """The best of each niche (n,), `ELITE`, ascending by niche."""
        self._settle()
        return self._kept

    def __len__(self) -> int:
        return len(self.elites)

    def _settle(self) -> None:
        if self._waiting:
            self._kept = best_per_niche(np.concatenate([self._kept, *self._waiting]))
            self._waiting, self._n_waiting = [], 0

    def _elites(self, found: Rows) -> NDArray[np.void]:
        elites = np.zeros(len(found), ELITE)
        elites["niche"] = niches(found, self._synergies)
        for name in TAKEN:
            elites[name] = found[name]
        return elites


def best_per_niche(elites: NDArray[np.void]) -> NDArray[np.void]:
    """The best one of each niche, ascending by niche; see `NicheArchive`."""
    order = np.lexsort((
        elites["index"], elites["generation"], -elites["contacts"].astype(np.int64), elites["penetration"],
        -elites["fitness"], -elites["outcome"].astype(np.int64), elites["niche"],
    ))  # fmt: skip
    ranked = elites[order]
    _, first = np.unique(ranked["niche"], return_index=True)
    return ranked[first]
