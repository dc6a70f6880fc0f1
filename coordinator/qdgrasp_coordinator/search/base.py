"""The interface of a search, the space of its genomes, and keyed random numbers.

Random numbers are keyed, so that one spec gives one stream of genomes.
"""

import hashlib
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from qdgrasp_assets.genes import archive_box, layout
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import Genomes, Layout, Rows

PositionBox: TypeAlias = tuple[ArrayLike, ArrayLike]
"""Low and high corner (3,) [m], CoM frame: `genes.archive_box`."""


def keyed_generator(seed: int, purpose: str, generation: int) -> np.random.Generator:
    """Return the generator of one purpose ("initial", "parents" ...) in a generation of a run.

    Draw whole arrays over the index from it: the numbers of a genome then depend on (seed, purpose,
    generation, index) alone, never on earlier draws for another purpose or generation. Seeds are 0 or
    greater, generations below 2**32.
    """
    digest = hashlib.sha256(purpose.encode()).digest()
    words = tuple(int.from_bytes(digest[i : i + 4], "little") for i in (0, 4, 8, 12))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(*words, generation)))


@dataclass(frozen=True)
class SearchSpace:
    """Genes and cells of one search."""

    layout: Layout
    """The genes of its genomes."""
    box: PositionBox
    """The box of hand positions that are kept."""
    scene: Scene
    """The scene, for searches that know what a pose is."""

    @property
    def genes(self) -> int:
        """Number of genes of a genome."""
        return len(self.layout)


def search_space(scene: Scene, prior: str) -> SearchSpace:
    """Return the space of genomes of `prior` in a scene.

    Raises `JawNeeded` where the prior is for two-finger hands, and this hand has another number of them.
    """
    return SearchSpace(layout(scene, prior), archive_box(scene, prior), scene)


class SearchAlgorithm(Protocol):
    """Interface of every search."""

    def ask(self, generation: int) -> Genomes:
        """Return a generation's genomes: (lambda, d), float32; no rows when nothing is left to ask.

        Called once per generation, in order.
        """

    def tell(self, generation: int, rows: Rows) -> None:
        """Learn from the results of a whole generation: its nominal rows, by index.

        Called once per generation, in order.
        """
