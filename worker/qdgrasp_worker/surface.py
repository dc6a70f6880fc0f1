"""The surface S_c as decoding sees it: its points with their normals, and the nearest of them."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from qdgrasp_assets.scene import Scene
from qdgrasp_worker.rotation import Floats, unit


class Surface:
    """The surface points of a scene, CoM frame."""

    def __init__(self, scene: Scene) -> None:
        self.points: Floats = scene.surface_points.astype(np.float64)
        self.normals: Floats = unit(scene.surface_normals.astype(np.float64))
        self._tree = KDTree(self.points)

    def nearest(self, finders: Floats) -> NDArray[np.intp]:
        """The index (n,) of the surface point nearest to each of `finders` (n, 3) [m]."""
        _, indices = self._tree.query(np.nan_to_num(finders))
        return np.asarray(indices, dtype=np.intp)
