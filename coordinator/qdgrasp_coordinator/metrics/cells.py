"""Cells, orientations and niches, in which hands are counted, and the reader of genomes.

Cells are cubes of 1 cm. S_G, the paper's reference set, holds positions rounded to 1 cm; everything that
counts or keeps positions by cell (archive, coverage, progress, `info`) makes its cells here, and all agree.

Orientations are 60 bins. A rotation belongs to the nearest of the 60 that turn an icosahedron into itself.
They lie in the rotations as evenly as 60 can: every bin is congruent to every other, a regular
dodecahedron of unit quaternions. A rotation is 29.5 degrees from the middle of its bin on average and 44.5
at most, and the middles of bins that share a face are 72 degrees apart (Coxeter 1973, "Regular Polytopes":
the 600-cell and its dual).

Niches are bins of position, orientation and synergy. The paper's archive and S_G tell grasps apart by
position alone; a data set wants more: hands in one cell that look elsewhere, are rolled, or close other
fingers.
"""

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_assets.genes import layout
from qdgrasp_assets.geometry.rotation import Floats, multiply, unit
from qdgrasp_assets.scene import Scene, SceneGripper
from qdgrasp_protocol.rows import GIVEN, NO_SYNERGY, Genomes, Layout, Rows

PER_METRE = 100  # Cells in a metre: an edge is 1 cm, cell k is from k - 0.5 to k + 0.5 cm
_REACH = 1 << 20  # `cell_keys` distinguishes cells with components below this: positions within 10 km


def cells(positions: ArrayLike) -> NDArray[np.int64]:
    """Return the cell (n, 3) of each position (n, 3) [m].

    `round(100 x)`, halves to even, computed in float64 as S_G was rounded.
    """
    return np.rint(np.asarray(positions, dtype=np.float64) * PER_METRE).astype(np.int64)


def cell_keys(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """One number per cell (n, 3), equal for equal cells only: (n,), for sets and for counting."""
    shifted = cells + _REACH
    return (shifted[:, 0] << 42) | (shifted[:, 1] << 21) | shifted[:, 2]


def first_occurrences(keys: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Flag the first occurrence of each number (n,): (n,)."""
    first = np.zeros(len(keys), dtype=bool)
    first[np.unique(keys, return_index=True)[1]] = True
    return first


BINS = 60
TURN = (-2.0, -2.0, -2.0, 3.0)
"""Rotation of the bin middles, a quaternion xyzw before normalisation.

With it, the 24 rotations that put a hand's axes on those of the object are all at least 17 degrees from a
border. Without it, 12 of them lie where four bins meet, and rounding would spread them.
"""
GOLDEN = (1.0 + np.sqrt(5.0)) / 2.0


def orientations(quaternions: ArrayLike) -> NDArray[np.int64]:
    """Return the bin (n,), 0 to 59, of each rotation (n, 4), quaternion xyzw; of ties the first.

    Written out in products and sums of float64, so that it is the same on every machine.
    """
    x, y, z, w = np.asarray(quaternions, dtype=np.float64).T[..., None]
    a, b, c, d = MIDDLES.T
    nearest: NDArray[np.int64] = np.abs(x * a + y * b + z * c + w * d).argmax(axis=1)
    return nearest


def _icosahedral() -> Floats:
    """The rotations (60, 4) of an icosahedron; of a quaternion and its negative, the first."""
    axes = np.eye(4)
    halves = np.array(list(product((0.5, -0.5), repeat=4)))
    golden = np.array([(p * GOLDEN, q, r / GOLDEN, 0.0) for p, q, r in product((0.5, -0.5), repeat=3)])
    others = [golden[:, order] for order in permutations(range(4)) if _is_even(order)]
    vertices = np.concatenate([axes, -axes, halves, *others])
    leading = vertices[np.arange(len(vertices)), (vertices != 0).argmax(axis=1)]
    chosen: Floats = vertices[leading > 0]
    return chosen


def _is_even(order: tuple[int, ...]) -> bool:
    swaps = sum(first > second for i, first in enumerate(order) for second in order[i + 1 :])
    return swaps % 2 == 0


MIDDLES: Floats = multiply(_icosahedral(), np.broadcast_to(unit(np.array([TURN])), (BINS, 4)))
"""(60, 4): the middle of each bin."""

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
