"""given: poses that are scored as they are; the genes are x y z [m], qx qy qz qw, the CoM frame."""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_protocol import genome
from qdgrasp_protocol.genome import Layout
from qdgrasp_worker.priors.prior import Poses, Prior
from qdgrasp_worker.surface import Surface

ROUNDING = 1e-6
"""How far float32 may take a unit quaternion's length from one: such poses are left as they are stored."""


class Given(Prior):
    """A prior without a choice of its own."""

    name = genome.GIVEN

    def values(self, layout: Layout, genomes: NDArray[np.float32]) -> Floats:
        """The genes as they are."""
        return genomes.astype(np.float64)

    def poses(self, genes: Floats, surface: Surface, hand: SceneGripper) -> Poses:
        """The poses (n, 7) themselves; a quaternion longer or shorter than one is brought to one."""
        given = genes[:, 3:7]
        lengths = np.sqrt((given * given).sum(axis=1, keepdims=True))
        quaternions = np.where(np.abs(lengths - 1.0) < ROUNDING, given, given / lengths)
        n = len(genes)
        return Poses(genes[:, :3], quaternions, np.zeros((n, 3)), np.zeros(n), np.zeros(n, dtype=bool))


GIVEN = Given()
