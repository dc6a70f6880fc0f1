"""The skin: points on and in the collision shapes of the open hand, the first of them wide apart."""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_worker.convex import Hull
from qdgrasp_worker.skeleton import Skeleton
from qdgrasp_worker.voxels import Singles

POINTS = 1024
DRAWN = 4096
"""How many points are drawn; of them those are kept that are farthest apart."""
DEEP = 0.4
"""The share of points that are drawn from within a part, and not from under its surface."""
UNDER = 0.98
"""How far from a part's centre its surface is taken to be: points of the edge would be on either side."""


class Skin:
    """Sample points of a hand, link by link."""

    def __init__(self, gripper: SceneGripper) -> None:
        self._skeleton = Skeleton(gripper)
        self._names = list(self._skeleton.hulls)
        opened = np.array([[joint.opened for joint in gripper.joints]])
        self._opened = self._skeleton.frames(opened)
        self._links, self._points = self._sample()

    def points(self, postures: NDArray[np.float32], some: slice) -> Singles:
        """`some` of the points in the hand frame [m], for joints at `postures` (n, j): (n, p, 3).

        (1, p, 3) where the postures are all the same.
        """
        links, points = self._links[some], self._points[some]
        if (postures == postures[:1]).all():
            postures = postures[:1]
        frames = self._skeleton.frames(postures.astype(np.float64))
        placed = np.empty((len(postures), len(points), 3), dtype=np.float32)
        for link in np.unique(links):
            frame, of_link = frames[self._names[link]], links == link
            placed[:, of_link] = points[of_link] @ np.moveaxis(frame[:, :3, :3], 1, 2) + frame[:, None, :3, 3]
        return placed

    def _sample(self) -> tuple[NDArray[np.int64], Floats]:
        """The link (1024,) and place (1024, 3) of each point, link frame [m]."""
        random = np.random.default_rng(0)
        parts = [(i, hull) for i, name in enumerate(self._names) for hull in self._skeleton.hulls[name]]
        if not parts:
            return np.zeros(0, dtype=np.int64), np.zeros((0, 3))
        sizes = np.array([areas(hull).sum() for _, hull in parts])
        counts = np.maximum(1, np.rint(DRAWN * sizes / sizes.sum())).astype(np.int64)
        points = [draw(hull, count, random) for (_, hull), count in zip(parts, counts, strict=True)]
        links = np.repeat([link for link, _ in parts], counts)
        together = np.concatenate(points)
        apart = spread(self._in_hand(links, together))
        return links[apart], together[apart]

    def _in_hand(self, links: NDArray[np.int64], points: Floats) -> Floats:
        """The points (n, 3) of `links` (n,) in the frame of the open hand [m]."""
        frames = np.stack([self._opened[name][0] for name in self._names])[links]
        placed: Floats = np.einsum("nij,nj->ni", frames[:, :3, :3], points) + frames[:, :3, 3]
        return placed


def areas(hull: Hull) -> Floats:
    """The areas (t,) of the triangles of a hull's surface [m2]."""
    a, b, c = np.moveaxis(hull.triangles, 1, 0)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)


def draw(hull: Hull, n: int, random: np.random.Generator) -> Floats:
    """Draw points (n, 3) [m] that are inside a hull, most of them close under its surface."""
    sizes = areas(hull)
    triangles = hull.triangles[random.choice(len(sizes), n, p=sizes / sizes.sum())]
    weights = random.dirichlet((1.0, 1.0, 1.0), n)
    centre = hull.triangles.reshape(-1, 3).mean(axis=0)
    depth = np.where(random.random(n) < DEEP, random.random(n) ** (1 / 3), 1.0) * UNDER
    drawn: Floats = centre + depth[:, None] * ((weights[:, :, None] * triangles).sum(axis=1) - centre)
    return drawn


def spread(points: Floats) -> NDArray[np.int64]:
    """Choose at most 1024 of `points` (n, 3): each is the one farthest from those before it."""
    chosen = np.zeros(min(POINTS, len(points)), dtype=np.int64)
    distances = np.full(len(points), np.inf)
    columns = np.ascontiguousarray(points.T)
    for i in range(1, len(chosen)):
        x, y, z = columns - columns[:, chosen[i - 1], None]
        np.minimum(distances, x * x + y * y + z * z, out=distances)
        chosen[i] = distances.argmax()
    return chosen
