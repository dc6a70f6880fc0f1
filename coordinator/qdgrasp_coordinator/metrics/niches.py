"""Niches: bins of hand position, orientation and synergy, and the reader of genomes.

The paper's archive and S_G tell grasps apart by position alone. A data set wants more: hands in one cell
that look elsewhere, are rolled, or close other fingers. That archive stays as it is.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import Scene, SceneGripper
from qdgrasp_coordinator.metrics.cells import cells, orientations
from qdgrasp_protocol.rows import GIVEN, NO_SYNERGY, Genomes, Layout, Rows

NicheKeys = NDArray[np.int64]
"""(n,): one number for each niche, ascending by cell, then synergy, then orientation."""
SYNERGY = "synergy"
ORIENTATION_BITS, SYNERGY_BITS, CELL_BITS = 6, 9, 16
_FARTHEST = (1 << (CELL_BITS - 1)) - 1
"""Greatest cell index on an axis, 327 m from the centre of mass; farther ones are clipped."""


@dataclass(frozen=True)
class GenomeReader:
    """Reader of the synergy and the finger joints of genomes, as evaluation reads them."""

    layout: Layout
    hand: SceneGripper | None = None
    """None: its joints are not known."""

    @classmethod
    def of(cls, scene: Scene, prior: str) -> "GenomeReader":
        """Return the reader for genomes of a prior in a scene."""
        return cls(layout(scene, prior), scene.gripper)

    def values(self, genomes: Genomes) -> NDArray[np.floating]:
        """Return the values (n, d) of the genes of each genome."""
        genes = genomes[:, : len(self.layout)]
        return genes if self.layout.prior == GIVEN else self.layout.values(genes)

    def labels(self, genomes: Genomes) -> NDArray[np.int64]:
        """Return the label (n,) of the synergy of each genome, or `NO_SYNERGY`."""
        if SYNERGY not in self.layout.names:
            return np.full(len(genomes), NO_SYNERGY)
        labels = self.values(genomes)[:, self.layout.names.index(SYNERGY)]
        return np.asarray(np.rint(labels), dtype=np.int64)

    def postures(self, rows: Rows) -> NDArray[np.float32]:
        """Return start positions (n, j) of joints [rad or m]: open, free joints from the genomes.

        Of an unknown hand they are those after closing.
        """
        if self.hand is None:
            return np.asarray(rows["joints"])
        if not (free := len(self.hand.free_joints)):
            return opened(self.hand, np.zeros((len(rows), 0)))
        return opened(self.hand, self.values(rows["genome"])[:, -free:])


def opened(hand: SceneGripper, spreads: NDArray[np.floating]) -> NDArray[np.float32]:
    """The joint positions (n, j) of the open posture, with free joints at `spreads` (n, k)."""
    names = [joint.name for joint in hand.joints]
    starts = np.tile(np.array([joint.opened for joint in hand.joints], np.float32), (len(spreads), 1))
    starts[:, [names.index(joint.name) for joint in hand.free_joints]] = spreads
    return starts


UNKNOWN_GENOMES = GenomeReader(Layout("", ()))  # Reader for an unknown scene: one synergy is taken for all


def niches(rows: Rows, reader: GenomeReader) -> NicheKeys:
    """The niche of each row's pose: (n,)."""
    found = np.clip(cells(rows["descriptor"][:, :3]), -_FARTHEST, _FARTHEST) + _FARTHEST
    labels = reader.labels(rows["genome"]) - NO_SYNERGY
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
