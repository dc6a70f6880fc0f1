"""Diversity: how many different grasps a run found, told apart by position, orientation and synergy.

S_G holds positions alone, so that there is no share of it to give: these are counts. They grow with the
evaluations, and compare runs of one hand on one object after equally many.
"""

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_coordinator.counts.niches import (
    UNKNOWN,
    Keys,
    NicheArchive,
    Synergies,
    cell_of,
    synergies,
    without_orientation,
    without_synergy,
)
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.searches.search import method
from qdgrasp_protocol.outcome import Outcome


class Diversity(Struct, frozen=True, kw_only=True):
    """Occupied niches, and how many of them share a cell. Means are None without a success."""

    niches: int
    """Those with a success."""
    grasp_niches: int
    """Those with a grasp (fitness 1 or more)."""
    robust_niches: int
    """Those with a robust grasp (fitness 2)."""
    orientations: float | None
    """Mean number of orientation bins with a success in a cell with one, 1 to 60."""
    synergies: float | None
    """Mean number of synergies with a success in a cell with one."""

    @property
    def words(self) -> str:
        """The figures for a person."""
        if self.orientations is None or self.synergies is None:
            return "none"
        return (
            f"{self.niches} niches, {self.grasp_niches} with a grasp, {self.robust_niches} robust; "
            f"{self.orientations:.2f} orientations and {self.synergies:.2f} synergies in a cell"
        )


def synergies_of(folder: RunFolder) -> Synergies:
    """How the genomes of a run name synergies; without its scene all are taken for one."""
    known = folder.has_bundle()
    return synergies(folder.scene(), method(folder.spec.method).prior) if known else UNKNOWN


def niche_archive(folder: RunFolder) -> NicheArchive:
    """An empty archive for the rows of a run."""
    return NicheArchive(synergies_of(folder))


def diversity(archive: NicheArchive) -> Diversity:
    """Count the niches of an archive."""
    elites = archive.elites
    keys: Keys = elites["niche"]
    cells = _distinct(cell_of(keys))
    return Diversity(
        niches=len(keys),
        grasp_niches=_at_least(elites, Outcome.SHAKEN),
        robust_niches=_at_least(elites, Outcome.HELD),
        orientations=_distinct(without_synergy(keys)) / cells if cells else None,
        synergies=_distinct(without_orientation(keys)) / cells if cells else None,
    )


def _at_least(elites: NDArray[np.void], outcome: Outcome) -> int:
    return int(np.count_nonzero(elites["outcome"] >= outcome))


def _distinct(keys: Keys) -> int:
    return len(np.unique(keys))
