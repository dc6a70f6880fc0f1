"""The one interface of all priors."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_protocol.genome import Layout
from qdgrasp_worker.surface import Surface


@dataclass(frozen=True)
class Drawn:
    """The candidates that genomes stand for; most priors have one for each genome."""

    rows: NDArray[np.intp]
    """(m,): the genome that each is a candidate for, ascending; every genome has one at least."""
    genes: Floats
    """(m, d): what its genes stand for, in m and rad."""
    weights: Floats
    """(n, f): how each genome ranks its candidates by their features; f is 0 where there is no choice."""


@dataclass(frozen=True)
class Poses:
    """Hand poses before they are rounded; the hand's root link in the object's CoM frame."""

    positions: Floats
    """(n, 3) [m]."""
    quaternions: Floats
    """(n, 4) xyzw, unit; NaN where the genes name no rotation."""
    surface_points: Floats
    """(n, 3) [m]; zeros where the prior aims at none."""
    nu: Floats
    """(n,) [rad]; zero where the prior aims at none."""
    dead_ends: NDArray[np.bool_]
    """(n,): which genomes stand for no pose, though all of their genes do; their poses are zeros."""


class Prior(ABC):
    """How the leading genes of a genome become a hand pose."""

    name: str

    def values(self, layout: Layout, genomes: NDArray[np.float32]) -> Floats:
        """What genomes (n, d) in [-1, 1] stand for, in m and rad; (n, d)."""
        return layout.values(genomes)

    def drawn(self, genes: Floats, genomes: NDArray[np.float32], surface: Surface) -> Drawn:
        """The candidates of genomes (n, d) whose genes stand for `genes` (n, d)."""
        return Drawn(np.arange(len(genes)), genes, np.zeros((len(genes), 0)))

    @abstractmethod
    def poses(self, genes: Floats, surface: Surface, hand: SceneGripper) -> Poses:
        """The poses that the prior's own genes (n, k) stand for, one for each row."""
