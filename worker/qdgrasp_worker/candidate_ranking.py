"""Screening: choose the candidate of each genome to simulate, as far as geometry can tell.

Candidates that surely overlap are left out, the others are ranked by features (docs/methods.md). Two of
these are of the volume that the closing fingers sweep, and of the direction in which they do. It is a
measure for ranking poses, and decides nothing else. An object of which much is in the swept volume is likely
to be touched; where all of it is passed through in one direction, it is likely to be pushed away.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.genes import FEATURES
from qdgrasp_assets.geometry.primitives import geodesic
from qdgrasp_assets.geometry.rotation import Floats, dot
from qdgrasp_assets.scene import Scene, SceneGripper
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.decoder import DecodedGrasps
from qdgrasp_worker.filters.overlap_filter import OverlapFilter, rotation_matrices, transform_points
from qdgrasp_worker.filters.voxels import Hull, Singles, VoxelGrid, convex_hulls
from qdgrasp_worker.hand_geometry import Closing, HandKinematics
from qdgrasp_worker.object_geometry import ObjectSolid

VOXEL_PITCH = 3e-3  # The side of a voxel [m]
STEPS_BETWEEN_LOOKS = 5  # Steps of the closing hand between two looks where its fingers are
FREE_JOINT_PLACES = 5
"""Places of each free joint at which a swept volume is measured; the nearest one is used."""
POSES_AT_ONCE = 64  # Poses that are looked up at once: their points fit in the cache
MIN_MOTION = 1e-5  # What a finger moves at least from one look to the next to have a direction [m]
DIRECTION_UNIT = 1 << 12
"""The length of a direction: in whole numbers, whose sums do not depend on their order."""


@dataclass(frozen=True)
class SweptVolume:
    """One way of closing, hand frame."""

    voxels: VoxelGrid
    """The level tells the first finger there, and its time: greater is earlier; 0: none."""
    ways: NDArray[np.int32]
    """(levels, 3): in which direction across the approach axis it comes, see `motion_directions`."""

    def shares(self, x: Singles, y: Singles, z: Singles) -> NDArray[np.float32]:
        """Return the share of points (n, p) [m] inside, and inside from opposite sides: (n, 2)."""
        levels = self.voxels.at(x, y, z)
        within = np.count_nonzero(levels, axis=1)
        push = self.ways[levels].sum(axis=1, dtype=np.int64).astype(np.float64)
        opposed = np.maximum(within - np.sqrt(dot(push, push)) / DIRECTION_UNIT, 0.0)
        shares: NDArray[np.float64] = np.stack([within, opposed], axis=1) / levels.shape[1]
        return shares.astype(np.float32)


class SweptVolumes:
    """The volumes of a scene's hand, each measured when it is first asked for."""

    def __init__(self, gripper: SceneGripper, closing: Closing) -> None:
        self._kinematics = HandKinematics(gripper)
        self._fingers = gripper.finger_links
        self._plain = {link: simplified_hulls(self._kinematics.hulls[link]) for link in self._fingers}
        self._closing = closing
        self._approach = np.array(gripper.approach_axis)
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
        keys, which = np.unique(self._keys(grasps, places), axis=0, return_inverse=True)
        for i, key in enumerate(keys.tolist()):
            swept_volume = self._volume(tuple(key))
            (mine,) = np.nonzero(which.reshape(-1) == i)
            for start in range(0, len(mine), POSES_AT_ONCE):
                some = mine[start : start + POSES_AT_ONCE]
                shares[some] = swept_volume.shares(*points_in_hand_frames(points, grasps, places[some]))
        return shares

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
        """Close the hand on nothing and mark the way of its fingers."""
        posture = np.array(self._opened)
        posture[self._free] = self._low + stops / (FREE_JOINT_PLACES - 1) * (self._high - self._low)
        frames = self._kinematics.frames(
            np.array(self._closing(posture.tolist(), synergy))[::STEPS_BETWEEN_LOOKS]
        )
        voxels = VoxelGrid(*self._kinematics.box(self._fingers, frames), VOXEL_PITCH, np.uint16)
        parts = [(frames[link], hull) for link in self._fingers for hull in self._plain[link]]
        looks = len(next(iter(frames.values())))
        ways = np.zeros((1 + looks * len(parts), 3), dtype=np.int32)
        for i, (course, hull) in enumerate(parts):
            # Of several fingers the first counts: an earlier look has a greater level, and `mark` keeps that.
            levels = 1 + i + len(parts) * np.arange(looks)[::-1]
            ways[levels] = motion_directions(course, hull, self._approach)
            for frame, level in zip(course, levels.tolist(), strict=True):
                voxels.mark(hull.moved(frame), level)
        return SweptVolume(voxels, ways)


def motion_directions(course: Floats, hull: Hull, axis: Floats) -> NDArray[np.int32]:
    """In which directions across `axis` (3,) a hull is carried through frames (n, 4, 4): (n, 3).

    Their length is `DIRECTION_UNIT`, or less where it goes along the axis: what is drawn that way, the palm
    stops.
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
    return transform_points(points[None], rotations, -rotate_vectors(rotations, grasps.positions[places]))


def rotate_vectors(rotations: Singles, vectors: Singles) -> Singles:
    """The vectors (n, 3) turned by rotations (n, 3, 3), bits independent of n."""
    x, y, z = (rotations[:, :, axis] * vectors[:, axis, None] for axis in range(3))
    total: Singles = x + y + z
    return total


DEFAULT_WEIGHTS = np.array([0.25, 1.0, 0.0, 0.0, 0.0, 0.0])
"""Weights of a genome whose own are zero: the swept share, above all from opposite sides."""


class PoseFeatures:
    """The features (docs/methods.md) of a scene's poses."""

    def __init__(self, gripper: SceneGripper, solid: ObjectSolid, volumes: SweptVolumes) -> None:
        self._gripper = gripper
        self._solid = solid
        self._volumes = volumes
        self._points = solid.points.astype(np.float32)

    def features(self, grasps: DecodedGrasps, places: NDArray[np.intp]) -> NDArray[np.float32]:
        """The features (p, 6) of those of a batch of grasps that are at `places` (p,).

        All but the last are between 0 and 1, or -1 and 1.
        """
        features = np.ones((len(places), len(FEATURES)), dtype=np.float32)
        features[:, :2] = self._volumes.shares(self._points, grasps, places)
        features[:, 2:5] = self._geometry(grasps, places)
        return features

    def _geometry(self, grasps: DecodedGrasps, places: NDArray[np.intp]) -> Floats:
        """(p, 3): cos nu, d in its interval, the contact's height along the approach [object radii]."""
        points = grasps.surface_points[places].astype(np.float64)
        offsets = grasps.positions[places] - points
        distances = np.sqrt(dot(offsets, offsets))
        low, high = self._gripper.standoff
        d = (distances - self._gripper.palm_offset - low) / max(high - low, 1e-9)
        height = dot(points, offsets) / distances / self._solid.radius
        return np.stack([np.cos(grasps.nu[places].astype(np.float64)), d, height], axis=1)


def have_threshold(weights: Floats) -> NDArray[np.bool_]:
    """(n,): genomes, by weights (n, f), that want a score of 0 or more of a simulated pose.

    Those with a weight for the constant, which changes no order: it says what is not worth a simulation.
    """
    choosy: NDArray[np.bool_] = (weights[:, -1:] != 0.0).any(axis=1)
    return choosy


def candidate_scores(features: NDArray[np.float32], weights: Floats) -> Floats:
    """Scores (p,) of poses, of their features (p, f) and the weights (p, f) of their genomes."""
    weights = np.where(weights.any(axis=1, keepdims=True), weights, DEFAULT_WEIGHTS)
    total = np.zeros(len(features))
    for i in range(features.shape[1]):
        total += weights[:, i] * features[:, i]
    return total


@dataclass(frozen=True)
class Shortlist:
    """The candidates of one genome, by their places in the batch."""

    first: int
    """The pose that stands for a genome of which none is simulated: a finite one, or the first."""
    poses: int
    """Number of poses; 0: a dead end."""
    ranked: list[int]
    """Poses that do not surely overlap and promise enough, in the order in which they are tried."""
    fallback: Outcome
    """The outcome if none of them is simulated."""

    @property
    def is_choice(self) -> bool:
        """True if one of several poses is to be found."""
        return self.poses > 1


class CandidateScreen:
    """Screens a scene's poses before they are simulated.

    `closing` closes the hand on nothing. The test for overlap has the free joints where the grasp has them
    (`follows_free_joints`), or open. It `filters` poses that surely overlap, or does not, with the same
    results.
    """

    def __init__(
        self,
        scene: Scene,
        solid: ObjectSolid,
        closing: Closing,
        *,
        follows_free_joints: bool,
        filters: bool = True,
    ) -> None:
        self._scene = scene
        self._closing = closing
        self._follows = follows_free_joints
        self._filters = filters
        self._solid = solid

    def __call__(
        self, grasps: DecodedGrasps, trials: NDArray[np.uint16], wanted: NDArray[np.bool_]
    ) -> tuple[list[Shortlist], NDArray[np.float32]]:
        """The shortlist of each genome of a batch, and the features (poses, f) of what is ranked.

        Beyond trial 0 a genome's only pose is disturbed and not filtered; of several one is chosen first.
        Genomes that are not `wanted` (n,) have empty lists.
        """
        is_pose = ~grasps.dead_ends & wanted[grasps.genome_of]
        (poses,) = np.nonzero(is_pose)
        is_choice = np.bincount(grasps.genome_of[poses], minlength=len(trials)) > 1
        (nominal,) = np.nonzero(is_pose & (is_choice | (trials == 0))[grasps.genome_of])
        left = np.setdiff1d(poses, self._overlap(grasps, nominal)) if self._filters else poses
        features, order = self._rank(grasps, left)
        choosy = have_threshold(grasps.weights)
        return make_shortlists(
            grasps, poses, order, np.where(choosy, Outcome.DEAD_END, Outcome.OVERLAP)
        ), features

    def _rank(
        self, grasps: DecodedGrasps, left: NDArray[np.intp]
    ) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
        """The features (poses, f), and those of `left` that promise enough, best first per genome."""
        features = np.zeros((len(grasps), grasps.weights.shape[1]), dtype=np.float32)
        if not features.shape[1]:
            return features, left
        features[left] = self._ranking.features(grasps, left)
        rows = grasps.genome_of[left]
        promised = candidate_scores(features[left], grasps.weights[rows])
        best_first = np.lexsort([-promised, rows])
        is_enough = (promised >= 0.0) | ~have_threshold(grasps.weights)[rows]
        return features, left[best_first[is_enough[best_first]]]

    @cached_property
    def _overlap(self) -> OverlapFilter:
        return OverlapFilter(self._scene.gripper, self._solid, follows_free_joints=self._follows)

    @cached_property
    def _ranking(self) -> PoseFeatures:
        gripper = self._scene.gripper
        return PoseFeatures(gripper, self._solid, SweptVolumes(gripper, self._closing))


def make_shortlists(
    grasps: DecodedGrasps, poses: NDArray[np.intp], order: NDArray[np.intp], fallbacks: NDArray[np.integer]
) -> list[Shortlist]:
    """A list for each genome, of `poses` among the grasps and the `order` in which to try them."""
    genomes = np.arange(len(grasps.weights))
    counts = np.bincount(grasps.genome_of[poses], minlength=len(genomes))
    first = np.searchsorted(grasps.genome_of, genomes)
    is_alive = counts > 0
    first[is_alive] = poses[np.searchsorted(grasps.genome_of[poses], genomes[is_alive])]
    ends = np.searchsorted(grasps.genome_of[order], genomes, side="right")
    ranked = [places.tolist() for places in np.split(order, ends)[:-1]]
    outcomes = [Outcome(number) for number in fallbacks.tolist()]
    return [Shortlist(*each) for each in zip(first.tolist(), counts.tolist(), ranked, outcomes, strict=True)]
