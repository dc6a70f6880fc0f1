"""The surface of a scene's hand: frames and convex parts of its links, and points on them.

All of it depends on the hand alone, so that scenes with the same hand share it.
"""

import hashlib
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import Floats, dot
from qdgrasp_assets.geometry.voxels import Hull, Singles, convex_hulls
from qdgrasp_assets.grippers.collision_shapes import is_all_convex, link_convex_parts
from qdgrasp_assets.grippers.urdf import parse_robot
from qdgrasp_assets.scene import SceneGripper

HANDS_KEPT = 8  # Hands whose geometry a process keeps, the last ones used


@dataclass(frozen=True)
class SharedHand:
    """A hand as a key: it equals the hands of other scenes with the same content."""

    digest: bytes
    gripper: SceneGripper = field(compare=False, repr=False)

    @classmethod
    def of(cls, gripper: SceneGripper) -> Self:
        """The key of a scene's hand."""
        content = msgspec.msgpack.encode(gripper, order="deterministic")
        return cls(hashlib.sha256(content).digest(), gripper)

    @property
    def kinematics(self) -> "HandKinematics":
        """Its kinematics, one object for all scenes."""
        return _kinematics(self)

    @property
    def samples(self) -> "HandSurfaceSamples":
        """Its sample points, drawn once for all scenes."""
        return _samples(self)

    def postures(self, course: bytes) -> Floats:
        """The postures (n, j) [rad or m] in the bytes of a course, which can be a part of a key."""
        return np.frombuffer(course).reshape(-1, len(self.gripper.joints))


@lru_cache(HANDS_KEPT)
def _kinematics(hand: SharedHand) -> "HandKinematics":
    return HandKinematics(hand.gripper)


@lru_cache(HANDS_KEPT)
def _samples(hand: SharedHand) -> "HandSurfaceSamples":
    return HandSurfaceSamples(hand)


class HandKinematics:
    """The links of a scene's hand from its root link outward, without the carrier."""

    def __init__(self, gripper: SceneGripper) -> None:
        robot = parse_robot(Path(), ET.fromstring(gripper.urdf))  # noqa: S314  # the scene's own
        self.robot = robot.subtree(gripper.base_link)
        """The hand, without meshes and without the carrier."""
        self._joints = [joint.name for joint in gripper.joints]
        parts = list(link_convex_parts(self.robot, gripper.meshes))
        self.hulls: dict[str, list[Hull]] = {
            link: convex_hulls(part.corners for part in parts if part.link == link)
            for link in self.robot.links
        }
        """The convex parts of each link, link frame."""
        self.is_understood = is_all_convex(robot, gripper.meshes) and (
            sum(map(len, self.hulls.values())) == len(list(link_convex_parts(robot, gripper.meshes)))
        )
        """True if these are all collision shapes: all are convex, none flat, none the carrier's."""

    def frames(self, postures: Floats) -> dict[str, Floats]:
        """The frame (n, 4, 4) of each link in the hand's, joints at `postures` (n, j) [rad or m]."""
        frames = self.robot.forward(dict(zip(self._joints, postures.T, strict=True)))
        shape = (len(postures), 4, 4)
        return {link: np.broadcast_to(frame, shape) for link, frame in frames.items()}

    def box(self, links: Iterable[str], frames: dict[str, Floats]) -> tuple[Floats, Floats]:
        """The corners (3,) of the box around `links` in all of the `frames` [m]."""
        corners = [
            np.einsum("nij,kj->nki", frames[link][:, :3, :3], hull.triangles.reshape(-1, 3))
            + frames[link][:, None, :3, 3]
            for link in links
            for hull in self.hulls[link]
        ]
        points = np.concatenate([each.reshape(-1, 3) for each in [*corners, np.zeros((1, 3))]])
        return points.min(axis=0), points.max(axis=0)


SAMPLE_POINTS = 1024
STAGES = (slice(0, 64), slice(64, 256), slice(256, 1024))  # Points that are looked up one after the other
POINTS_AT_ONCE = 1 << 15  # Points that are looked up at once: they fit in the cache
DRAWN_POINTS = 4096  # Number of points that are drawn; those farthest apart are kept
DEEP_SHARE = 0.4  # Share of points that are drawn from inside a part, and not from under its surface
SURFACE_SCALE = 0.98  # Scale of a part's surface about its centre: points of the edge would be on either side


class HandSurfaceSamples:
    """Sample points of a hand, link by link."""

    def __init__(self, hand: SharedHand) -> None:
        self._kinematics = hand.kinematics
        self._names = list(self._kinematics.hulls)
        opened = np.array([[joint.opened for joint in hand.gripper.joints]])
        self._opened = self._kinematics.frames(opened)
        self._links, self._points = self._sample()
        self._corners = {
            name: np.unique(np.concatenate([hull.triangles.reshape(-1, 3) for hull in hulls]), axis=0)
            for name, hulls in self._kinematics.hulls.items()
            if hulls
        }
        """The corners (v, 3) [m] of the convex parts of each link, link frame."""

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

    def lowest(self, up: Floats, postures: NDArray[np.float32]) -> Floats:
        """The least component (n,) [m] along `up` (n, 3) of the hand's convex parts, hand frame.

        Its joints are at `postures` (n, j) [rad or m].
        """
        if (postures == postures[:1]).all():
            postures = postures[:1]
        frames = self._kinematics.frames(postures.astype(np.float64))
        lowest = np.full(len(up), np.inf)
        for name, corners in self._corners.items():
            frame = frames[name]
            along = np.stack([dot(frame[:, :3, axis], up) for axis in range(3)], axis=-1)
            heights = dot(corners, along[:, None]).min(axis=1) + dot(frame[:, :3, 3], up)
            lowest = np.minimum(lowest, heights)
        return lowest

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
