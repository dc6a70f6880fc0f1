"""The surface S_c as decoding sees it: its points with their normals, the nearest, and the opposite ones."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from qdgrasp_assets.rotation import Floats, unit
from qdgrasp_assets.scene import Scene
from qdgrasp_worker.exits import cross, last_exits


@dataclass(frozen=True)
class Opposites:
    """For each surface point the last point of the surface straight behind it, within the hand's opening."""

    distances: Floats
    """(n,) [m]; NaN where there is none."""
    normals: Floats
    """(n, 3): the outward unit normals there; any where there is none."""


class Surface:
    """The surface points of a scene, CoM frame."""

    def __init__(self, scene: Scene) -> None:
        self.points: Floats = scene.surface_points.astype(np.float64)
        self.normals: Floats = unit(scene.surface_normals.astype(np.float64))
        self._tree = KDTree(self.points)
        self._scene = scene

    def nearest(self, finders: Floats) -> NDArray[np.intp]:
        """The index (n,) of the surface point nearest to each of `finders` (n, 3) [m]."""
        _, indices = self._tree.query(np.nan_to_num(finders))
        return np.asarray(indices, dtype=np.intp)

    @cached_property
    def opposites(self) -> Opposites:
        """What the hand's jaw would close on with each surface point; without a jaw nothing."""
        jaw, corners = self._scene.gripper.jaw, self._scene.object.triangles.astype(np.float64)
        opening = 0.0 if jaw is None else jaw.opening
        distances, triangles = last_exits(self.points, -self.normals, corners, opening)
        first, second, third = np.moveaxis(corners[triangles], 1, 0)
        return Opposites(distances, unit(cross(second - first, third - first)))
