"""Decoding of genomes to hand poses with initial postures, a batch at a time.

The last step rounds to float32. Trigonometry in float64 differs in its last bits between processors; rounded
it does not, and exactly the rounded pose is simulated, stored and exported (docs/reproducibility.md).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.genes import layout
from qdgrasp_assets.geometry.object_surface import ObjectSurface
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.grippers.reachability import Hands
from qdgrasp_assets.priors import PRIORS
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import UnknownName
from qdgrasp_protocol.rows import NO_SYNERGY


@dataclass(frozen=True)
class HandPose:
    """One pose and posture, as plain Python numbers, which Bullet reads fastest."""

    position: list[float]
    quaternion: list[float]
    joints: list[float]
    synergy: int

    @property
    def axes(self) -> tuple[tuple[float, float, float], ...]:
        """The axes of its frame: unit vectors in the frame of its position."""
        x, y, z, w = self.quaternion
        return (
            (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
            (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
            (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
        )


@dataclass(frozen=True)
class DecodedGrasps:
    """A batch of poses and postures, rounded to float32: exactly these are simulated and stored."""

    positions: NDArray[np.float32]
    """(n, 3) [m], the hand's root link in the object's CoM frame."""
    quaternions: NDArray[np.float32]
    """(n, 4) xyzw, unit, of the same frame."""
    joints: NDArray[np.float32]
    """(n, j) [rad or m], initial positions in the gripper's joint order."""
    synergies: NDArray[np.int64]
    """(n,) labels; `NO_SYNERGY`: every driven joint closes."""
    surface_points: NDArray[np.float32]
    """(n, 3) [m], CoM frame; zeros where the prior aims at none."""
    nu: NDArray[np.float32]
    """(n,) [rad], from the normal at that point to the direction to the hand; 0 without a point."""
    dead_ends: NDArray[np.bool_]
    """(n,): True where there is no pose; its values are zeros."""

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def are_finite(self) -> NDArray[np.bool_]:
        """(n,): whether pose and posture are numbers."""
        columns = np.concatenate([self.positions, self.quaternions, self.joints], axis=1)
        finite: NDArray[np.bool_] = np.isfinite(columns).all(axis=1)
        return finite

    def hands(self, places: NDArray[np.intp]) -> Hands:
        """Positions (p, 3), quaternions (p, 4) and joints (p, j) at places (p,) in the batch."""
        return self.positions[places], self.quaternions[places], self.joints[places]

    def __getitem__(self, i: int) -> HandPose:
        return HandPose(
            self.positions[i].tolist(),
            self.quaternions[i].tolist(),
            self.joints[i].tolist(),
            int(self.synergies[i]),
        )


class Decoder:
    """Decodes genomes of one prior in one scene.

    UnknownName if there is no such prior, JawNeeded if it is for two-finger hands and the scene's is another.
    """

    def __init__(self, scene: Scene, prior: str, surface: ObjectSurface) -> None:
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

    def __call__(self, genomes: NDArray[np.float32]) -> DecodedGrasps:
        """Decode genomes (n, d) to a grasp each; NaN where a genome stands for no pose."""
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            values = self._prior.values(self.layout, genomes)
            poses = self._prior.poses(values[:, : self._own], self._surface, self._hand)
        return DecodedGrasps(
            positions=poses.positions.astype(np.float32),
            quaternions=poses.quaternions.astype(np.float32),
            joints=self._postures(values).astype(np.float32),
            synergies=self._synergies(values),
            surface_points=poses.surface_points.astype(np.float32),
            nu=poses.nu.astype(np.float32),
            dead_ends=poses.dead_ends,
        )

    def _synergies(self, values: Floats) -> NDArray[np.int64]:
        """The synergy labels (n,) in the genes behind the prior's own."""
        if not self._hand.synergies:
            return np.full(len(values), NO_SYNERGY)
        return np.rint(np.nan_to_num(values[:, self._own])).astype(np.int64)

    def _postures(self, values: Floats) -> Floats:
        """Initial joint positions (n, j): open, with the free joints at their genes."""
        postures = np.tile(self._opened, (len(values), 1))
        if self._free:
            postures[:, self._free] = values[:, -len(self._free) :]
        return postures
