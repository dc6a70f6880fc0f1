"""What is evaluated: hand poses with the fingers' initial posture, decoded and rounded."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Pose:
    """One pose and posture, in the plain Python numbers that Bullet takes quickest."""

    position: list[float]
    quaternion: list[float]
    joints: list[float]
    synergy: int


@dataclass(frozen=True)
class Grasps:
    """A batch of poses and postures, rounded to float32: exactly these are simulated and stored.

    A genome has one of them, or several, of which one is chosen (`screen`).
    """

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
    """(n,) [rad], between the normal there and the direction to the hand; 0 where there is none."""
    dead_ends: NDArray[np.bool_]
    """(n,): which of them are no pose; zeros are in its place."""
    rows: NDArray[np.intp]
    """(n,): the genome of the batch that each belongs to, ascending."""
    weights: NDArray[np.float64]
    """(genomes, f): how a genome ranks its candidates by their features; f is 0 where there is no choice."""

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def are_finite(self) -> NDArray[np.bool_]:
        """(n,): whether pose and posture are numbers."""
        columns = np.concatenate([self.positions, self.quaternions, self.joints], axis=1)
        finite: NDArray[np.bool_] = np.isfinite(columns).all(axis=1)
        return finite

    def __getitem__(self, i: int) -> Pose:
        return Pose(
            self.positions[i].tolist(),
            self.quaternions[i].tolist(),
            self.joints[i].tolist(),
            int(self.synergies[i]),
        )
