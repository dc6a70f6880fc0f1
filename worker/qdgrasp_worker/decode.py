"""Decode: genomes to hand poses with initial postures, a batch at a time.

It ends by rounding to float32. Trigonometry in float64 differs in the last bits between processors; rounded
it does not, and exactly the rounded pose is simulated, stored and exported (docs/reproducibility.md).
"""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.genes import layout
from qdgrasp_assets.rotation import Floats
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import UnknownName
from qdgrasp_protocol.genome import NO_SYNERGY
from qdgrasp_worker.grasp import Grasps
from qdgrasp_worker.priors import PRIORS
from qdgrasp_worker.surface import Surface


class Decoder:
    """What genomes of one prior mean in one scene.

    Raises
    ------
    UnknownName
        There is no such prior.
    JawNeeded
        The prior is for two-finger hands, and the scene's is none.
    """

    def __init__(self, scene: Scene, prior: str, surface: Surface) -> None:
        if prior not in PRIORS:
            raise UnknownName("prior", prior, PRIORS)
        self.layout = layout(scene, prior)
        self._prior = PRIORS[prior]
        self._hand = scene.gripper
        self._surface = surface
        self._opened = np.array([joint.opened for joint in self._hand.joints])
        names = [joint.name for joint in self._hand.joints]
        self._free = [names.index(joint.name) for joint in self._hand.free_joints]
        self._own = len(self.layout) - len(self._free) - bool(self._hand.synergies)

    def __call__(self, genomes: NDArray[np.float32]) -> Grasps:
        """The candidates for the grasps that genomes (n, d) stand for; NaN where a genome stands for none."""
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            drawn = self._prior.drawn(self._prior.values(self.layout, genomes), genomes, self._surface)
            values = drawn.genes
            poses = self._prior.poses(values[:, : self._own], self._surface, self._hand)
        return Grasps(
            positions=poses.positions.astype(np.float32),
            quaternions=poses.quaternions.astype(np.float32),
            joints=self._postures(values).astype(np.float32),
            synergies=self._synergies(values),
            surface_points=poses.surface_points.astype(np.float32),
            nu=poses.nu.astype(np.float32),
            dead_ends=poses.dead_ends,
            rows=drawn.rows,
            weights=drawn.weights,
        )

    def _synergies(self, values: Floats) -> NDArray[np.int64]:
        """The labels (n,) that stand behind the prior's own genes."""
        if not self._hand.synergies:
            return np.full(len(values), NO_SYNERGY)
        return np.rint(np.nan_to_num(values[:, self._own])).astype(np.int64)

    def _postures(self, values: Floats) -> Floats:
        """Initial joint positions (n, j): open, with the free joints at their genes."""
        postures = np.tile(self._opened, (len(values), 1))
        if self._free:
            postures[:, self._free] = values[:, -len(self._free) :]
        return postures
