"""Genomes that come from a program: looked at before anybody evaluates them."""

import numpy as np
from numpy.typing import ArrayLike

from qdgrasp_assets.genes import OWN, layout
from qdgrasp_assets.scene import Scene, SceneGripper
from qdgrasp_coordinator.counts.poses import Names, Poses
from qdgrasp_protocol.errors import ImpossibleValue, InputError, UnknownName
from qdgrasp_protocol.genome import GIVEN, Genomes, Layout

POSES = Names("genomes (x y z)", "genomes (qx qy qz qw)", "genomes (synergy)", "genomes (free joints)")
"""What columns of genomes are called where a pose is told as it is."""


def layout_of(scene: Scene, prior: str) -> Layout:
    """The genes that a prior has with a scene.

    Raises
    ------
    UnknownName
        There is no such prior.
    JawNeeded
        It is for two-finger hands, and this hand is none.
    """
    if prior not in OWN:
        raise UnknownName("prior", prior, OWN)
    return layout(scene, prior)


def checked(values: ArrayLike, layout: Layout) -> Genomes:
    """Genomes (n, d) as float32.

    Raises
    ------
    ImpossibleValue
        They have another shape, or hold a number that is not finite or, but for the prior `given`, outside
        [-1, 1].
    """
    expected = f"numbers of shape (n, {len(layout)}): {', '.join(layout.names)}"
    try:
        genomes: Genomes = np.array(values, dtype=np.float32, order="C")
    except (TypeError, ValueError) as error:
        raise InputError(f"genomes must be {expected}; {error}.") from None
    if genomes.ndim != 2 or genomes.shape[1] != len(layout):
        raise ImpossibleValue("genomes", genomes.shape, expected)
    limit = np.inf if layout.prior == GIVEN else 1.0
    wrong = genomes[~(np.isfinite(genomes) & (np.abs(genomes) <= limit))]
    if len(wrong):
        bounds = "finite" if layout.prior == GIVEN else "in [-1, 1]"
        raise ImpossibleValue("genomes", float(wrong[0]), f"{bounds} ({len(wrong)} numbers are not)")
    return genomes


def check_given(genomes: Genomes, hand: SceneGripper) -> None:
    """Check that genomes (n, d) of the prior `given` are poses, and synergies that a hand has.

    Raises
    ------
    InputError
        A quaternion is of length zero, a position is beyond all measure, or there is no such synergy.
    """
    labels = genomes[:, 7] if hand.synergies else None
    Poses.of(POSES, genomes[:, :3], genomes[:, 3:7], labels).check(hand)
