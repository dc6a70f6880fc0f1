"""Ranking: what is known of a pose before it is simulated, and which of several is tried first."""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.genes import FEATURES
from qdgrasp_assets.rotation import Floats, dot
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_worker.grasp import Grasps
from qdgrasp_worker.solid import Solid
from qdgrasp_worker.swath import Swaths

UNTAUGHT = np.array([0.25, 1.0, 0.0, 0.0, 0.0, 0.0])
"""The weights of a genome whose own are all zero: what is swept, and above all from opposite sides."""


class Ranking:
    """The features (docs/methods.md) of a scene's poses."""

    def __init__(self, gripper: SceneGripper, solid: Solid, swaths: Swaths) -> None:
        self._gripper = gripper
        self._solid = solid
        self._swaths = swaths
        self._points = solid.points.astype(np.float32)

    def features(self, grasps: Grasps, places: NDArray[np.intp]) -> NDArray[np.float32]:
        """The features (p, 6) of those of a batch of grasps that are at `places` (p,).

        All but the last are between 0 and 1, or -1 and 1.
        """
        features = np.ones((len(places), len(FEATURES)), dtype=np.float32)
        features[:, :2] = self._swaths.shares(self._points, grasps, places)
        features[:, 2:5] = self._geometry(grasps, places)
        return features

    def _geometry(self, grasps: Grasps, places: NDArray[np.intp]) -> Floats:
        """Cos nu, d in its interval, and the contact's height along the approach in object radii: (p, 3)."""
        points = grasps.surface_points[places].astype(np.float64)
        offsets = grasps.positions[places] - points
        distances = np.sqrt(dot(offsets, offsets))
        low, high = self._gripper.standoff
        d = (distances - self._gripper.palm_offset - low) / max(high - low, 1e-9)
        height = dot(points, offsets) / distances / self._solid.radius
        return np.stack([np.cos(grasps.nu[places].astype(np.float64)), d, height], axis=1)


def are_choosy(weights: Floats) -> NDArray[np.bool_]:
    """Which genomes (n,), by their weights (n, f), want a score of 0 or more of what is simulated.

    Those with a weight for the constant, which changes no order: it says what is not worth a simulation.
    """
    choosy: NDArray[np.bool_] = (weights[:, -1:] != 0.0).any(axis=1)
    return choosy


def scores(features: NDArray[np.float32], weights: Floats) -> Floats:
    """How promising poses are: (p,), of their features (p, f) and the weights (p, f) of their genomes."""
    weights = np.where(weights.any(axis=1, keepdims=True), weights, UNTAUGHT)
    total = np.zeros(len(features))
    for i in range(features.shape[1]):
        total += weights[:, i] * features[:, i]
    return total
