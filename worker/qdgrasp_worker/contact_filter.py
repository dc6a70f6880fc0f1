"""Contact filter: finds poses at which the closing hand surely stays away from the object.

An object that no link comes near stays at rest, and the hand closes as on nothing. So that closing is
measured, once for each synergy, with all collision shapes of the hand, the palm's among them; a distance
field has lower bounds of the distance to them. The surface of the object is covered by balls: at a pose where
each ball is farther from the shapes than Bullet detects contacts, nothing can touch.

All errors are on the safe side: a pose that might touch is simulated.

- Bullet keeps a contact up to 2 % of the smaller shape's disc beyond the margins of 1 mm: balls have to be
  farther away than that (`contact_range`). MuJoCo detects contacts at the same distance from all shapes.
- Voxels are marked whose middle is inside a shape that is enlarged by half their diagonal, by its motion
  between two samples, and by the excess of round shapes over their corners. The distance of a point is that
  of the middle of its voxel less a diagonal. Shapes of many planes are replaced by larger ones.
- A hand that is wholly inside the object, away from its surface, overlaps; Bullet's test of the open hand
  comes first. Where that test has the free joints at other places, the hand is checked there too.
- A finger on a free joint closes nearly the same way at any place of that joint, so that its field moves with
  the joint's frame. `STRAY` bounds the difference: forces between fingers depend on their places.
- Where a shape or a free joint is not understood, every pose is simulated.

Scenes in which a hand closes the same way share its fields. On an object with a large surface the balls are
larger, so that their number stays bounded.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from math import sqrt
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from qdgrasp_assets.geometry.mesh import geodesic
from qdgrasp_assets.geometry.rotation import Floats, running_sum
from qdgrasp_assets.geometry.voxels import Hull, Singles, VoxelGrid
from qdgrasp_assets.grippers.hand_geometry import HandGeometry, hand_geometry
from qdgrasp_assets.grippers.urdf import UrdfJoint
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_worker.contact_margin import HULL_MARGIN
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.pose_filters import ObjectSolid
from qdgrasp_worker.world import free_posture

VOXEL_PITCH = 3e-3  # The side of a voxel [m]; larger for a hand that passes through more than `MAX_VOXELS`
MAX_VOXELS = 1 << 22
KNOWN_DISTANCE = 0.03  # Greatest distance from the shapes that is known [m]
DISTANCE_UNIT = 2e-4
"""Unit of stored distances, which are whole numbers up to 255 [m]; larger ones are stored as 255."""
STRIDE = 2e-3  # Motion of a shape from one sample to the next [m]
ROUND_EXCESS = 0.03  # Excess of a round shape over the hull of its corners, in its radii
DIRECTIONS = geodesic(1.0, 3).vertices
UNIT_BOX_CORNERS = np.array(list(product((0.0, 1.0), repeat=3)))


def distance_field(courses: Iterable[tuple[Hull, Floats]]) -> VoxelGrid:
    """Return lower bounds of the distance to the volume that hulls pass through.

    Each hull is on its course of frames (n, 4, 4) that follow each other closely. Distances are in units of
    `DISTANCE_UNIT`, rounded down; the rim stands for all outside the box.
    """
    paths = [(simplified_hull(hull), course, corner_path(hull, course)) for hull, course in courses]
    low = np.min([corners.min(axis=(0, 1)) for *_, corners in paths], axis=0)
    high = np.max([corners.max(axis=(0, 1)) for *_, corners in paths], axis=0)
    low, high = low - KNOWN_DISTANCE, high + KNOWN_DISTANCE
    pitch = max(VOXEL_PITCH, float(np.prod(high - low) / MAX_VOXELS) ** (1 / 3))
    diagonal = sqrt(3.0) * pitch
    voxels = VoxelGrid(low, high, pitch)
    for hull, course, corners in paths:
        for look, moved in path_samples(corners):
            voxels.mark(hull.moved(course[look]).grown(moved + round_excess(hull) + diagonal / 2), 1)
    # Distances are of voxels' middles: a point and a marked place may each be half a diagonal nearer.
    away = distance_transform_edt(voxels.levels == 0) * pitch - diagonal
    voxels.levels = np.clip(away / DISTANCE_UNIT, 0, 255).astype(np.uint8)
    return voxels


def lower_bounds(field: VoxelGrid, points: Singles, turn: Singles, move: Singles) -> NDArray[np.uint8]:
    """Lower bounds (n,) of the distances of points (n, 3), turned by (3, 3) and moved by (3,)."""
    x, y, z = (points @ turn.T + move).T
    return field.at(x, y, z).astype(np.uint8, copy=False)


def corner_path(hull: Hull, course: Floats) -> Floats:
    """The corners (n, 8, 3) [m] of a hull's box along its course."""
    corners = hull.low + UNIT_BOX_CORNERS * (hull.high - hull.low)
    places: Floats = corners @ np.moveaxis(course[:, :3, :3], 1, 2) + course[:, None, :3, 3]
    return places


def path_samples(corners: Floats) -> list[tuple[int, float]]:
    """Frames of a path (n, 8, 3), and the distance [m] of points in frames that each stands for."""
    steps = np.linalg.norm(np.diff(corners, axis=0), axis=2).max(axis=1)
    ways = np.concatenate([[0.0], np.cumsum(steps)])
    _, first = np.unique(np.floor(ways / STRIDE), return_index=True)
    last = np.append(first[1:], len(ways)) - 1
    middle = np.searchsorted(ways, (ways[first] + ways[last]) / 2).clip(first, last)
    moved = np.maximum(ways[middle] - ways[first], ways[last] - ways[middle])
    return list(zip(middle.tolist(), moved.tolist(), strict=True))


def simplified_hull(hull: Hull) -> Hull:
    """A hull around a hull that has no more than 92 planes."""
    if len(hull.planes) <= len(DIRECTIONS):
        return hull
    corners = hull.surface.corners.reshape(-1, 3)
    return replace(hull, planes=np.column_stack([DIRECTIONS, -(corners @ DIRECTIONS.T).max(axis=0)]))


def round_excess(hull: Hull) -> float:
    """Distance [m] by which a round shape may reach beyond the hull of its corners."""
    return float(ROUND_EXCESS * np.sort(hull.high - hull.low)[1] / 2)


TILE_REACH = 1.5e-3  # Greatest distance of a tile's points from its middle [m]
SMALL_CELL, LARGE_CELL = 3e-3, 15e-3
"""The sides of the cells in which tiles, and then small balls, are gathered [m]."""
FINE_SURFACE = 0.6  # Largest surface with tiles of that size, that of a cube of 32 cm [m2]


@dataclass(frozen=True)
class Balls:
    """Centres and radii of balls."""

    centres: Floats
    """(n, 3) [m]."""
    radii: Floats
    """(n,) [m]."""


@dataclass(frozen=True)
class BoundingBalls:
    """Balls that cover the surface: small ones all of it, and each of these is in a large one."""

    large: Balls
    small: Balls
    """Small balls, in the order of their large ones."""
    counts: NDArray[np.intp]
    """(large,): number of small balls in each large one."""

    @classmethod
    def of(cls, solid: ObjectSolid) -> Self:
        """The cover of the surfaces of an object's convex parts, CoM frame."""
        triangles, coarse = np.concatenate([hull.surface.corners for hull in solid.hulls]), coarseness(solid)
        small, _, _ = gather_balls(tile_balls(triangles, coarse * TILE_REACH), coarse * SMALL_CELL)
        large, order, counts = gather_balls(small, coarse * LARGE_CELL)
        return cls(large, Balls(small.centres[order], small.radii[order]), counts)


def coarseness(solid: ObjectSolid) -> float:
    """Factor by which tiles and cells are larger than on a small object: 1 up to `FINE_SURFACE`."""
    surface = running_sum(float(hull.surface.areas.sum()) for hull in solid.hulls)
    return max(1.0, sqrt(surface / FINE_SURFACE))


def tile_balls(triangles: Floats, reach: float) -> Balls:
    """Balls of `reach` [m] at most about the pieces that triangles (t, 3, 3) are cut into."""
    middles, reaches = [], []
    while len(triangles):
        centres = triangles.mean(axis=1)
        far = np.linalg.norm(triangles - centres[:, None], axis=2).max(axis=1)
        is_small = far <= reach
        middles.append(centres[is_small])
        reaches.append(far[is_small])
        triangles = halve_triangles(triangles[~is_small])
    return Balls(np.concatenate(middles), np.concatenate(reaches))


def halve_triangles(triangles: Floats) -> Floats:
    """Each triangle (t, 3, 3) cut in two (2 t, 3, 3) through the middle of its longest edge."""
    edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
    which, each = edges.argmax(axis=1), np.arange(len(triangles))
    a, b, c = (triangles[each, (which + i) % 3] for i in range(3))
    middle = (a + b) / 2
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])


def gather_balls(balls: Balls, side: float) -> tuple[Balls, NDArray[np.intp], NDArray[np.intp]]:
    """A ball around all balls in each cell of `side` [m].

    Returns the m balls, the order (n,) by which balls of a cell are neighbours, and their numbers (m,).
    """
    points = balls.centres
    cells = np.floor(points / side).astype(np.int64)
    order = np.lexsort(cells.T[::-1])
    starts = np.append(0, 1 + np.flatnonzero(np.diff(cells[order], axis=0).any(axis=1)))
    counts = np.diff(starts, append=len(points))
    centres = np.add.reduceat(points[order], starts, axis=0) / counts[:, None]
    offsets = points[order] - np.repeat(centres, counts, axis=0)
    reaches = np.sqrt((offsets * offsets).sum(axis=1)) + balls.radii[order]
    return Balls(centres, np.maximum.reduceat(reaches, starts)), order, counts


BREAKING = 0.02  # Bullet's contact breaking threshold, in discs
STRAY = 5e-4  # Deviation of a closing finger from its measured path, free joints at other places [m]
POSTURES_PER_STEP = 8  # Interpolated postures for each step
FREE_JOINT_PLACES = (0.0, 1.0)  # Places of the free joints on their ranges in the measured closings


def clearances(balls: Balls, sight: float) -> tuple[Singles, NDArray[np.uint8]]:
    """Centres (n, 3) [m] of balls, and their least distances (n,) from a zone, in its units.

    Contacts begin at `sight` [m].
    """
    far = np.ceil((balls.radii + sight) / DISTANCE_UNIT).clip(0, 255)
    return balls.centres.astype(np.float32), far.astype(np.uint8)


class FreeJointLinks:
    """The links that stand still while fingers close, on which others are mounted.

    These mounts are the hand's root, and the links of its free joints.
    """

    def __init__(self, hand: HandGeometry) -> None:
        self._root = hand.gripper.base_link
        free = {joint.name for joint in hand.gripper.free_joints}
        names = [joint.name for joint in hand.gripper.joints]
        driven = {joint.name for joint in hand.gripper.joints if joint.driven}
        frames = hand.frames(np.zeros((1, len(names))))
        self._mounts: list[tuple[str, Floats, UrdfJoint, int]] = []
        """Mount below, frame (4, 4) of the joint in its frame, joint, and the joint's place in a posture."""
        self.mount_of = {self._root: self._root}
        """The mount under each link."""
        still = {self._root}
        self.all_still = not free & driven
        """True if all of them stand still: no free joint or joint below one is driven."""
        for joint in hand.robot.joints_beyond(self._root):
            below, is_free = self.mount_of[joint.parent], joint.name in free
            self.mount_of[joint.child] = joint.child if is_free else below
            if joint.parent in still and (is_free or joint.name not in names):
                still.add(joint.child)
            if is_free:
                self.all_still = self.all_still and joint.parent in still
                frame = np.linalg.inv(frames[below][0]) @ frames[joint.parent][0] @ joint.origin
                self._mounts.append((below, frame, joint, names.index(joint.name)))

    def frames(self, posture: Sequence[float]) -> dict[str, Floats]:
        """Each mount's frame (4, 4) in the hand's, with the free joints as in `posture` [rad or m]."""
        frames = {self._root: np.eye(4)}
        for below, frame, joint, place in self._mounts:
            frames[joint.child] = frames[below] @ frame @ joint.motion(posture[place])
        return frames


Closing = Callable[[Sequence[float], int], list[list[float]]]
"""Courses of a closing hand's joints, by its initial posture and its synergy."""


class ContactFilter:
    """Finds poses at which a scene's hand surely misses, without the simulator.

    `closing` closes the hand on nothing, when a synergy is first met. In the test for overlap the free joints
    are as in the grasp (`follows_free_joints`), or open. `sight` is the distance at which the engine detects
    contacts, if it is the same for all shapes [m].
    """

    def __init__(
        self,
        gripper: SceneGripper,
        solid: ObjectSolid,
        closing: Closing,
        *,
        follows_free_joints: bool,
        sight: float = 0.0,
    ) -> None:
        self._hand = hand_geometry(gripper)
        self._mounts = FreeJointLinks(self._hand)
        self.is_known = self._hand.is_understood and solid.is_whole and self._mounts.all_still
        """True if all of hand and object is understood; if not, no pose surely misses."""
        self._closing = closing
        opened = [joint.opened for joint in gripper.joints]
        self._at_first = [] if follows_free_joints or not gripper.free_joints else [opened]
        self._zones: dict[int, dict[str, VoxelGrid]] = {}
        if self.is_known:
            cover, clear = BoundingBalls.of(solid), contact_range(solid, sight)
            self._large, self._small = clearances(cover.large, clear), clearances(cover.small, clear)
            self._counts = cover.counts

    def prepare(self, synergy: int) -> None:
        """Measure the zones of a synergy, unless they are known."""
        if self.is_known and synergy not in self._zones:
            self._zones[synergy] = self._measure(synergy)

    def misses(self, pose: HandPose) -> bool:
        """Return whether the hand, closing at `pose`, surely never comes as near as a contact."""
        if not self.is_known:
            return False
        self.prepare(pose.synergy)
        turn = np.array(pose.axes)
        move = -turn @ np.array(pose.position)
        return all(
            self._is_clear(zone, frame[:3, :3].T @ turn, frame[:3, :3].T @ (move - frame[:3, 3]))
            for zone, frame in self._placed(pose)
        )

    def _placed(self, pose: HandPose) -> Iterator[tuple[VoxelGrid, Floats]]:
        """Each zone with its frame (4, 4) in the hand's, for each place of the free joints."""
        for posture in [pose.joints, *self._at_first]:
            frames = self._mounts.frames(posture)
            for link, zone in self._zones[pose.synergy].items():
                yield zone, frames[link]

    def _is_clear(self, zone: VoxelGrid, turn: Floats, move: Floats) -> bool:
        """Return whether no ball is near a zone; where a large one is, its small ones are checked.

        A large ball inside the zone is enough for False.
        """
        frame = turn.astype(np.float32), move.astype(np.float32)
        (large, least), (small, small_least) = self._large, self._small
        away = lower_bounds(zone, large, *frame)
        is_near = away <= least
        if not is_near.any() or not away.all():
            return not is_near.any()
        some = np.repeat(is_near, self._counts)
        return bool((lower_bounds(zone, small[some], *frame) > small_least[some]).all())

    def _measure(self, synergy: int) -> dict[str, VoxelGrid]:
        """Close the hand from each of `FREE_JOINT_PLACES`; return the zone in each mount's frame."""
        gripper = self._hand.gripper
        places = FREE_JOINT_PLACES[: 1 + bool(gripper.free_joints)]
        courses = [np.array(self._closing(free_posture(gripper, place), synergy)) for place in places]
        return measure_zones(self._hand, tuple(course.tobytes() for course in courses))


ZONES_KEPT = 32  # Synergies whose zones a process keeps, the last ones used; about 1 MB each


@lru_cache(ZONES_KEPT)
def measure_zones(hand: HandGeometry, courses: tuple[bytes, ...]) -> dict[str, VoxelGrid]:
    """The zones of a closing hand; a course (n, j), as bytes, for each free joint place."""
    mounts = FreeJointLinks(hand)
    passing: dict[str, list[tuple[Hull, Floats]]] = {}
    for place, course in zip(FREE_JOINT_PLACES, courses, strict=False):
        frames = hand.frames(interpolate_course(np.frombuffer(course).reshape(-1, len(hand.gripper.joints))))
        placed = mounts.frames(free_posture(hand.gripper, place))
        for link, hulls in hand.hulls.items():
            under = mounts.mount_of[link]
            path = np.linalg.inv(placed[under]) @ frames[link]
            passing.setdefault(under, []).extend((hull, path) for hull in hulls)
    return {link: distance_field(paths) for link, paths in passing.items() if paths}


def interpolate_course(course: Floats) -> Floats:
    """The postures (n, j) of a course (steps, j), with interpolated ones in between."""
    steps = np.arange(len(course))
    finer = np.linspace(0, len(course) - 1, POSTURES_PER_STEP * (len(course) - 1) + 1)
    return np.stack([np.interp(finer, steps, joint) for joint in course.T], axis=1)


def contact_range(solid: ObjectSolid, sight: float = 0.0) -> float:
    """Distance from an object's surface [m] at which a contact may begin, with a margin."""
    low, high = solid.box
    disc = np.linalg.norm(high - low) / 2 + np.linalg.norm(high + low) / 2
    return max(float(2 * HULL_MARGIN + BREAKING * (disc + HULL_MARGIN) + STRAY), sight + STRAY)
