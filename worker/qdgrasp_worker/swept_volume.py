"""Swept volumes: the ways of closing fingers, and their first contacts with an object.

A hand closes on nothing, once for each synergy and place of its free joints, and its fingers are marked in
voxels with the time at which the first one comes there. An object in the hand is looked up in them: the share
of its inside that is swept, and from which sides; and the surface points that each finger would meet first.
They rank poses, and decide nothing else. Scenes in which a hand closes the same way share its volumes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import geodesic
from qdgrasp_assets.geometry.rotation import Floats, dot
from qdgrasp_assets.geometry.voxels import (
    Hull,
    Singles,
    VoxelGrid,
    convex_hulls,
    rotation_matrices,
    transform_points,
)
from qdgrasp_assets.grippers.hand_geometry import Closing, HandGeometry, hand_geometry
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_worker.decoder import DecodedGrasps
from qdgrasp_worker.object_geometry import SurfaceSample

VOXEL_PITCH = 3e-3  # The side of a voxel [m]
STEPS_BETWEEN_LOOKS = 5  # Steps of the closing hand between two looks at its fingers
FREE_JOINT_PLACES = 5
"""Places of each free joint at which a swept volume is measured; the nearest one is used."""
POSES_AT_ONCE = 64  # Poses that are looked up at once: their points fit in the cache
MIN_MOTION = 1e-5  # Least motion of a finger between two looks that has a direction [m]
DIRECTION_UNIT = 1 << 12
"""The length of a direction: in whole numbers, whose sums do not depend on their order."""
PATCH_DEPTH = 0.004  # A finger's contact: the points that it meets this far after the first [m]
NO_FINGER = 255


@dataclass(frozen=True)
class FirstContacts:
    """First contacts of each of f fingers with an object's surface, at n poses; CoM frame."""

    meets: NDArray[np.bool_]
    """(n, f): which fingers meet it; the other columns are zero where one does not."""
    points: Floats
    """(n, f, 3) [m]: the middle of the points that a finger meets first."""
    normals: Floats
    """(n, f, 3): the mean of the outward normals there."""
    ways: Floats
    """(n, f, 3): the direction in which the finger comes, see `motion_directions`; at most of length 1."""
    strokes: Floats
    """(n, f): the share of its closing that is left to the finger there."""


@dataclass(frozen=True)
class SweptVolume:
    """The volume that one way of closing sweeps, hand frame."""

    voxels: VoxelGrid
    """The level gives the first finger there, and its time: greater is earlier; 0: none."""
    ways: NDArray[np.int32]
    """(levels, 3): its direction of motion across the approach axis, see `motion_directions`."""
    fingers: NDArray[np.uint8]
    """(levels,): the finger of each level; `NO_FINGER` for level 0."""
    levels_per_look: int
    """Number of levels of one look."""

    def shares(self, x: Singles, y: Singles, z: Singles) -> NDArray[np.float32]:
        """Return the share of points (n, p) [m] inside, and inside from opposite sides: (n, 2)."""
        levels = self.voxels.at(x, y, z)
        within = np.count_nonzero(levels, axis=1)
        push = self.ways[levels].sum(axis=1, dtype=np.int64).astype(np.float64)
        opposed = np.maximum(within - np.sqrt(dot(push, push)) / DIRECTION_UNIT, 0.0)
        shares: NDArray[np.float64] = np.stack([within, opposed], axis=1) / levels.shape[1]
        return shares.astype(np.float32)

    def first_contacts(
        self, finger_count: int, sample: SurfaceSample, x: Singles, y: Singles, z: Singles, rotations: Singles
    ) -> FirstContacts:
        """Return the first contacts with a surface, points (n, p) [m] in the hand's frame.

        `rotations` (n, 3, 3) turn the hand's frame into the object's.
        """
        levels = self.voxels.at(x, y, z)
        owners = self.fingers[levels]
        found = [
            self._first_contact(np.where(owners == finger, levels, 0), (x, y, z), sample)
            for finger in range(finger_count)
        ]
        first, count, sums = (np.stack(each, axis=1) for each in zip(*found, strict=True))
        means = np.where(count > 0, sums / np.maximum(count, 1), 0.0)
        ways = self.ways[first] / DIRECTION_UNIT
        turned = np.stack([dot(rotations[:, None, axis].astype(np.float64), ways) for axis in range(3)], -1)
        looks = (len(self.fingers) - 1) // self.levels_per_look
        strokes = np.where(first > 0, (first.astype(np.int64) - 1) // self.levels_per_look / looks, 0.0)
        points, normals = sample.decoded(means)
        return FirstContacts(first > 0, points, normals, turned, strokes)

    def _first_contact(
        self, levels: NDArray[np.uint16], points: tuple[Singles, Singles, Singles], sample: SurfaceSample
    ) -> tuple[NDArray[np.uint16], Floats, Floats]:
        """The first level (n,) among levels (n, p), and number (n, 1) and sums (n, 6) of its points.

        Of the points that are met within one look, those count that lie foremost against the finger's way.
        """
        first: NDArray[np.uint16] = levels.max(axis=1)
        looks = (levels.astype(np.int32) - 1) // self.levels_per_look
        is_met = (levels > 0) & (looks == ((first.astype(np.int32) - 1) // self.levels_per_look)[:, None])
        way = (self.ways[first] / np.float32(DIRECTION_UNIT)).astype(np.float32)
        x, y, z = points
        along = np.where(is_met, way[:, :1] * x + way[:, 1:2] * y + way[:, 2:] * z, np.float32(np.inf))
        patch = is_met & (along <= along.min(axis=1, keepdims=True) + np.float32(PATCH_DEPTH))
        sums = (patch.astype(np.float32) @ sample.encoded).astype(np.float64)
        return first, np.count_nonzero(patch, axis=1)[:, None].astype(np.float64), sums


class SweptVolumes:
    """The volumes of a scene's hand, each measured when it is first needed."""

    def __init__(self, gripper: SceneGripper, closing: Closing) -> None:
        self._hand = hand_geometry(gripper)
        self._closing = closing
        self._opened = [joint.opened for joint in gripper.joints]
        names = [joint.name for joint in gripper.joints]
        self._free = [names.index(joint.name) for joint in gripper.free_joints]
        self._low = np.array([joint.low for joint in gripper.free_joints])
        self._high = np.array([joint.high for joint in gripper.free_joints])
        self._found: dict[tuple[int, ...], SweptVolume] = {}

    def shares(self, points: Singles, grasps: DecodedGrasps, places: NDArray[np.intp]) -> NDArray[np.float32]:
        """Shares of an object's points (p, 3), CoM frame, that are swept, and from opposite sides.

        (places, 2), between 0 and 1; the second is the first, less the length of the mean of the directions
        in which the fingers come to the points.
        """
        shares = np.zeros((len(places), 2), dtype=np.float32)
        for swept_volume, some in self._by_volume(grasps, places):
            shares[some] = swept_volume.shares(*points_in_hand_frames(points, grasps, places[some]))
        return shares

    def first_contacts(
        self, sample: SurfaceSample, grasps: DecodedGrasps, places: NDArray[np.intp]
    ) -> FirstContacts:
        """Return the first contacts of the grasps at `places` (n,) with the object."""
        n, fingers = len(places), self.finger_count
        points, normals, ways = np.zeros((3, n, fingers, 3))
        found = FirstContacts(np.zeros((n, fingers), bool), points, normals, ways, np.zeros((n, fingers)))
        for swept_volume, some in self._by_volume(grasps, places):
            here = places[some]
            contacts = swept_volume.first_contacts(
                fingers,
                sample,
                *points_in_hand_frames(sample.points, grasps, here),
                rotation_matrices(grasps.quaternions[here]),
            )
            for name, values in vars(contacts).items():
                getattr(found, name)[some] = values
        return found

    @cached_property
    def finger_count(self) -> int:
        """Number of the hand's fingers."""
        return 1 + max(finger_numbers(self._hand).values())

    def _by_volume(
        self, grasps: DecodedGrasps, places: NDArray[np.intp]
    ) -> Iterator[tuple[SweptVolume, NDArray[np.intp]]]:
        """Yield each volume that grasps at `places` need, with their places among `places`."""
        keys, which = np.unique(self._keys(grasps, places), axis=0, return_inverse=True)
        for i, key in enumerate(keys.tolist()):
            swept_volume = self._volume(tuple(key))
            (mine,) = np.nonzero(which.reshape(-1) == i)
            for start in range(0, len(mine), POSES_AT_ONCE):
                yield swept_volume, mine[start : start + POSES_AT_ONCE]

    def _keys(self, grasps: DecodedGrasps, places: NDArray[np.intp]) -> NDArray[np.int64]:
        """A number for the swept volume of each grasp, by its synergy and places of its free joints."""
        free = grasps.joints[places][:, self._free].astype(np.float64)
        portions = (free - self._low) / np.where(self._high == self._low, 1.0, self._high - self._low)
        stops = np.rint(np.clip(portions, 0.0, 1.0) * (FREE_JOINT_PLACES - 1)).astype(np.int64)
        return np.column_stack([grasps.synergies[places], stops])

    def _volume(self, key: tuple[int, ...]) -> SweptVolume:
        if key not in self._found:
            self._found[key] = self._measure(key[0], np.array(key[1:]))
        return self._found[key]

    def _measure(self, synergy: int, stops: NDArray[np.int64]) -> SweptVolume:
        """Close the hand on nothing and mark its fingers on the way."""
        posture = np.array(self._opened)
        posture[self._free] = self._low + stops / (FREE_JOINT_PLACES - 1) * (self._high - self._low)
        course = np.array(self._closing(posture.tolist(), synergy), dtype=np.float64)[::STEPS_BETWEEN_LOOKS]
        return measure_swept_volume(self._hand, course.tobytes())


VOLUMES_KEPT = 64  # Swept volumes that a process keeps, the last ones used; 1 MB or less each


@lru_cache(VOLUMES_KEPT)
def measure_swept_volume(hand: HandGeometry, course: bytes) -> SweptVolume:
    """Mark the way of a hand's fingers through a course (`HandGeometry.postures`)."""
    links = hand.gripper.finger_links
    frames = hand.frames(hand.postures(course))
    voxels = VoxelGrid(*hand.box(links, frames), VOXEL_PITCH, np.uint16)
    parts = [(link, hull) for link in links for hull in simplified_hulls(hand.hulls[link])]
    owners, approach = finger_numbers(hand), np.array(hand.gripper.approach_axis)
    looks = len(next(iter(frames.values())))
    ways = np.zeros((1 + looks * len(parts), 3), dtype=np.int32)
    fingers = np.full(len(ways), NO_FINGER, dtype=np.uint8)
    for i, (link, hull) in enumerate(parts):
        path = frames[link]
        # Of several fingers the first counts: an earlier look has a greater level, and `mark` keeps that.
        levels = 1 + i + len(parts) * np.arange(looks)[::-1]
        ways[levels] = motion_directions(path, hull, approach)
        fingers[levels] = owners[link]
        for frame, level in zip(path, levels.tolist(), strict=True):
            voxels.mark(hull.moved(frame), level)
    return SweptVolume(voxels, ways, fingers, len(parts))


def finger_numbers(hand: HandGeometry) -> dict[str, int]:
    """The finger that each finger link belongs to, counted from 0.

    Links of one finger have the same first finger link on their way from the base link.
    """
    links, firsts = hand.gripper.finger_links, {}
    for link in links:
        way = [joint.child for joint in hand.robot.inward(link)]
        firsts[link] = next((each for each in reversed(way) if each in links), "")
    names = list(dict.fromkeys(firsts.values()))
    return {link: names.index(first) for link, first in firsts.items()}


def motion_directions(course: Floats, hull: Hull, axis: Floats) -> NDArray[np.int32]:
    """The directions (n, 3) across `axis` (3,) in which frames (n, 4, 4) carry a hull.

    Their length is `DIRECTION_UNIT`, or less where it goes along the axis: the palm stops an object that is
    drawn that way.
    """
    centre = hull.triangles.reshape(-1, 3).mean(axis=0)
    moves = np.gradient(course[:, :3, :3] @ centre + course[:, :3, 3], axis=0)
    lengths = np.sqrt(dot(moves, moves))[:, None]
    ways = np.where(lengths > MIN_MOTION, moves / np.maximum(lengths, MIN_MOTION), 0.0)
    return np.rint(DIRECTION_UNIT * (ways - dot(ways, axis)[:, None] * axis)).astype(np.int32)


def simplified_hulls(parts: Sequence[Hull]) -> list[Hull]:
    """Hulls of the points that `parts` reach farthest with in 92 directions."""
    directions = geodesic(1.0, 3).vertices
    corners = [hull.triangles.reshape(-1, 3) for hull in parts]
    return convex_hulls(points[np.unique((points @ directions.T).argmax(axis=0))] for points in corners)


def points_in_hand_frames(
    points: Singles, grasps: DecodedGrasps, places: NDArray[np.intp]
) -> tuple[Singles, Singles, Singles]:
    """x, y, z (n, p) of points (p, 3), CoM frame, in the frames of the hands at `places` (n,)."""
    rotations = np.moveaxis(rotation_matrices(grasps.quaternions[places]), 1, 2)
    positions = grasps.positions[places]
    turned = transform_points(positions[:, None], rotations, np.zeros_like(positions))
    return transform_points(points[None], rotations, -np.concatenate(turned, axis=1))
