"""Overlap filter: finds hands that are surely inside the object, without the simulator.

Points on and in the collision shapes of the open hand, the first of them wide apart, are looked up in voxels
that are wholly inside the object. A point of both bodies is an overlap whatever else there is, so that no
pose is rejected that the simulator lets pass. Few points are looked up for all poses, more of them for those
that are left.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_worker.decoder import DecodedGrasps
from qdgrasp_worker.filters.voxels import Hull, Singles
from qdgrasp_worker.hand_geometry import HANDS_KEPT, SharedHand
from qdgrasp_worker.object_geometry import ObjectSolid

SAMPLE_POINTS = 1024
DRAWN_POINTS = 4096  # How many points are drawn; of them those are kept that are farthest apart
DEEP_SHARE = 0.4  # The share of points that are drawn from within a part, and not from under its surface
SURFACE_SCALE = 0.98  # Scale of a part's surface about its centre: points of the edge would be on either side


class HandSurfaceSamples:
    """Sample points of a hand, link by link."""

    def __init__(self, hand: SharedHand) -> None:
        self._kinematics = hand.kinematics
        self._names = list(self._kinematics.hulls)
        opened = np.array([[joint.opened for joint in hand.gripper.joints]])
        self._opened = self._kinematics.frames(opened)
        self._links, self._points = self._sample()

    def points(self, postures: NDArray[np.float32], some: slice) -> Singles:
        """`some` of the points in the hand frame [m], for joints at `postures` (n, j): (n, p, 3).

        (1, p, 3) where the postures are all the same.
        """
        links, points = self._links[some], self._points[some]
        if (postures == postures[:1]).all():
            postures = postures[:1]
        frames = self._kinematics.frames(postures.astype(np.float64))
        placed = np.empty((len(postures), len(points), 3), dtype=np.float32)
        for link in np.unique(links):
            frame, of_link = frames[self._names[link]], links == link
            placed[:, of_link] = points[of_link] @ np.moveaxis(frame[:, :3, :3], 1, 2) + frame[:, None, :3, 3]
        return placed

    def _sample(self) -> tuple[NDArray[np.int64], Floats]:
        """The link (1024,) and place (1024, 3) of each point, link frame [m]."""
        random = np.random.default_rng(0)
        parts = [(i, hull) for i, name in enumerate(self._names) for hull in self._kinematics.hulls[name]]
        if not parts:
            return np.zeros(0, dtype=np.int64), np.zeros((0, 3))
        sizes = np.array([hull.areas.sum() for _, hull in parts])
        counts = np.maximum(1, np.rint(DRAWN_POINTS * sizes / sizes.sum())).astype(np.int64)
        points = [draw_points(hull, count, random) for (_, hull), count in zip(parts, counts, strict=True)]
        links = np.repeat([link for link, _ in parts], counts)
        together = np.concatenate(points)
        apart = farthest_points(self._in_hand(links, together))
        return links[apart], together[apart]

    def _in_hand(self, links: NDArray[np.int64], points: Floats) -> Floats:
        """The points (n, 3) of `links` (n,) in the frame of the open hand [m]."""
        frames = np.stack([self._opened[name][0] for name in self._names])[links]
        placed: Floats = np.einsum("nij,nj->ni", frames[:, :3, :3], points) + frames[:, :3, 3]
        return placed


@lru_cache(HANDS_KEPT)
def sample_surface(hand: SharedHand) -> HandSurfaceSamples:
    """The sample points of a hand, drawn once for all scenes."""
    return HandSurfaceSamples(hand)


def draw_points(hull: Hull, n: int, random: np.random.Generator) -> Floats:
    """Draw points (n, 3) [m] that are inside a hull, most of them close under its surface."""
    sizes = hull.areas
    triangles = hull.triangles[random.choice(len(sizes), n, p=sizes / sizes.sum())]
    weights = random.dirichlet((1.0, 1.0, 1.0), n)
    centre = hull.triangles.reshape(-1, 3).mean(axis=0)
    depth = np.where(random.random(n) < DEEP_SHARE, random.random(n) ** (1 / 3), 1.0) * SURFACE_SCALE
    drawn: Floats = centre + depth[:, None] * ((weights[:, :, None] * triangles).sum(axis=1) - centre)
    return drawn


def farthest_points(points: Floats) -> NDArray[np.int64]:
    """Choose at most 1024 of `points` (n, 3): each is the one farthest from those before it.

    Greedy farthest-point sampling (Gonzalez 1985), so that the first points lie wide apart.
    """
    chosen = np.zeros(min(SAMPLE_POINTS, len(points)), dtype=np.int64)
    distances = np.full(len(points), np.inf)
    columns = np.ascontiguousarray(points.T)
    for i in range(1, len(chosen)):
        x, y, z = columns - columns[:, chosen[i - 1], None]
        np.minimum(distances, x * x + y * y + z * z, out=distances)
        chosen[i] = distances.argmax()
    return chosen


STAGES = (slice(0, 64), slice(64, 256), slice(256, 1024))
POINTS_AT_ONCE = 1 << 15  # Points that are looked up at once: they fit in the cache


class OverlapFilter:
    """Finds poses of a scene at which the hand surely overlaps.

    The hand is tested with its free joints where the grasp has them (`follows_free_joints`), or open.
    """

    def __init__(self, gripper: SceneGripper, solid: ObjectSolid, *, follows_free_joints: bool) -> None:
        self._samples = sample_surface(SharedHand.of(gripper))
        self._inside = solid.inside
        self._follows = follows_free_joints and bool(gripper.free_joints)
        self._opened = np.array([[joint.opened for joint in gripper.joints]], dtype=np.float32)

    def __call__(self, grasps: DecodedGrasps, places: NDArray[np.intp]) -> NDArray[np.intp]:
        """Those of `places` in a batch of grasps at which the hand surely overlaps, ascending."""
        rejected = []
        for stage in STAGES:
            hit = self._hits(grasps, places, stage)
            rejected.append(places[hit])
            places = places[~hit]
        return np.sort(np.concatenate(rejected))

    def _hits(self, grasps: DecodedGrasps, places: NDArray[np.intp], stage: slice) -> NDArray[np.bool_]:
        """(p,): poses that have one of the points of a stage inside the object."""
        step = max(1, POINTS_AT_ONCE // (stage.stop - stage.start))
        starts = range(0, len(places), step)
        parts = [self._look(grasps, places[i : i + step], stage) for i in starts]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=bool)

    def _look(self, grasps: DecodedGrasps, places: NDArray[np.intp], stage: slice) -> NDArray[np.bool_]:
        postures = grasps.joints[places] if self._follows else self._opened
        points = self._samples.points(postures, stage)
        x, y, z = transform_points(
            points, rotation_matrices(grasps.quaternions[places]), grasps.positions[places]
        )
        return np.asarray(self._inside.at(x, y, z).any(axis=1))


def rotation_matrices(quaternions: NDArray[np.float32]) -> Singles:
    """The rotation matrices (n, 3, 3) of unit quaternions (n, 4)."""
    x, y, z, w = quaternions.astype(np.float64).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows, dtype=np.float32), -1, 0)


def transform_points(
    points: Singles, rotations: Singles, positions: Singles
) -> tuple[Singles, Singles, Singles]:
    """x, y and z (n, p) of points (n or 1, p, 3), turned by (n, 3, 3) and moved by (n, 3).

    In products and sums of single numbers, whose bits do not depend on how many poses there are.
    """
    x, y, z = (points[:, :, axis] for axis in range(3))
    rows = [
        rotations[:, i, 0, None] * x + rotations[:, i, 1, None] * y + rotations[:, i, 2, None] * z
        for i in range(3)
    ]
    return rows[0] + positions[:, 0, None], rows[1] + positions[:, 1, None], rows[2] + positions[:, 2, None]
