"""Aims: what the genomes of the prior `aimed` say, in metres and radians, before they are genomes."""

from dataclasses import dataclass, replace

import numpy as np

from qdgrasp_assets.genes import FEATURES
from qdgrasp_assets.rotation import Floats
from qdgrasp_coordinator.counts.cells import PER_METRE
from qdgrasp_protocol.genome import Genomes, Layout

TARGET, CONTACT, ROLL, LOOSENESS, CANDIDATES = slice(0, 3), slice(3, 6), 6, 7, 8
"""Where a genome of the prior has its genes (assets, `genes`)."""
WEIGHTS = slice(9, 9 + len(FEATURES))
OWN = WEIGHTS.stop
"""The prior's own genes; the posture, which is the synergy and the free joints, is behind them."""
SYNERGY = "synergy"
WITHIN = 0.5
"""The inner part of a cell that a scattered target may be in, along each axis."""
POINT_SIGMA = 0.002
"""How far a scattered contact point is from its own, along each axis [m]."""
ROLL_SIGMA = 0.05  # rad


@dataclass(frozen=True)
class Aims:
    """Cells to aim at, each with the grasp to try there."""

    targets: Floats
    """(n, 3) [m]: the middles of the cells."""
    contacts: Floats
    """(n, 3) [m]: the surface points to look at, nearly."""
    rolls: Floats
    """(n,) [rad]: about the direction from target to contact."""
    looseness: Floats
    """(n,): 0 keeps to contact and roll, 1 takes any."""
    postures: Floats
    """(n, k): genes of synergy and free joints."""

    def __len__(self) -> int:
        return len(self.targets)

    def genomes(self, layout: Layout, candidates: int, weights: Floats) -> Genomes:
        """Their genomes (n, d).

        Parameters
        ----------
        candidates
            How many candidates are drawn for each.
        weights
            (n, features): what the candidates of each are ranked by.
        """
        values = np.zeros((len(self), OWN))
        values[:, TARGET], values[:, CONTACT] = self.targets, self.contacts
        values[:, ROLL], values[:, LOOSENESS] = self.rolls, self.looseness
        values[:, CANDIDATES], values[:, WEIGHTS] = candidates, weights
        own = Layout(layout.prior, layout.genes[:OWN]).genomes(values)
        return np.concatenate([own, self.postures.astype(np.float32)], axis=1)


def directions(targets: Floats, contacts: Floats) -> Floats:
    """The unit vectors (n, 3) from targets to contacts; along z where both are one point."""
    ways = contacts - targets
    lengths = np.sqrt((ways * ways).sum(axis=1))[:, None]
    along: Floats = np.tile([0.0, 0.0, 1.0], (len(ways), 1))
    np.divide(ways, lengths, out=along, where=lengths > 0)
    return along


def joined(one: Aims, other: Aims) -> Aims:
    """The aims of both, one after the other."""
    return Aims(*(np.concatenate([vars(one)[name], vars(other)[name]]) for name in vars(one)))


def scattered(aims: Aims, generator: np.random.Generator) -> Aims:
    """The same aims, each a little beside: for genomes of one candidate, which the prior does not scatter.

    It is less than the prior's scatter, where the best of many candidates is taken.
    """
    n = len(aims)
    return replace(
        aims,
        targets=aims.targets + WITHIN / PER_METRE * generator.uniform(-0.5, 0.5, (n, 3)),
        contacts=aims.contacts + POINT_SIGMA * generator.standard_normal((n, 3)),
        rolls=aims.rolls + ROLL_SIGMA * generator.standard_normal(n),
    )
