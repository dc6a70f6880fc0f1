"""The object as the solid that Bullet has: what is surely inside it, and points of its inside."""

from functools import cached_property

import numpy as np

from qdgrasp_assets.hulls import groups
from qdgrasp_assets.rotation import Floats
from qdgrasp_assets.scene import Scene
from qdgrasp_worker.convex import hulls
from qdgrasp_worker.voxels import Voxels

PITCH = 1e-3
"""The side of a voxel [m]; larger for an object of more than `MOST` voxels."""
MOST = 1 << 24
SAFE = 1e-4
"""How far within a part a voxel must be [m]. Bullet's hulls are larger than ours by a margin of 1 mm."""
POINTS = 512
DRAWS = 8192
ROUNDS = 64


class Solid:
    """The convex parts of a scene's object, CoM frame."""

    def __init__(self, scene: Scene) -> None:
        parts = list(groups(scene.object.collision.decode()))
        self.hulls = hulls(parts)
        """The parts."""
        self.is_whole = 0 < len(self.hulls) == len(parts)
        """Whether all of the object is in them; flat parts are left out."""
        self._surface = scene.surface_points.astype(np.float64)
        self.radius = float(np.sqrt((self._surface**2).sum(axis=1).max()))
        """How far the surface is from the centre of mass at most [m]."""

    @cached_property
    def inside(self) -> Voxels:
        """Level 1: the whole voxel is surely inside one of the parts."""
        low, high = self.box
        pitch = max(PITCH, float(np.prod(high - low) / MOST) ** (1 / 3))
        voxels = Voxels(low, high, pitch)
        for hull in self.hulls:
            reach = np.abs(hull.normals).sum(axis=1) * (pitch / 2)
            voxels.mark(hull.shrunk(reach + SAFE), 1)
        return voxels

    @cached_property
    def points(self) -> Floats:
        """(512, 3) [m]: points drawn uniformly from the inside; of the surface where there is hardly any."""
        random = np.random.default_rng(0)
        low, high = self.box
        found = [self._surface[:0]]
        for _ in range(ROUNDS):
            drawn = random.uniform(low, high, (DRAWS, 3))
            found.append(drawn[np.any([hull.contains(drawn) for hull in self.hulls], axis=0)])
            if sum(map(len, found)) >= POINTS:
                break
        some = self._surface[random.integers(len(self._surface), size=POINTS)]
        return np.concatenate([*found, some])[:POINTS]

    @cached_property
    def box(self) -> tuple[Floats, Floats]:
        """The corners (3,) of the box around it and its centre of mass [m]."""
        lows, highs = [hull.low for hull in self.hulls], [hull.high for hull in self.hulls]
        origin = np.zeros((1, 3))
        return np.min([*lows, *origin], axis=0), np.max([*highs, *origin], axis=0)
