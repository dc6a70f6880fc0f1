"""Screening: choose the candidate of each genome to simulate, as far as geometry can tell.

Candidates that surely overlap are left out, the others are ranked by features (docs/methods.md), and those
whose score is too low are refused. A genome's own numbers turn features into a score, so that the choice
depends on the genome alone.

Overlap: points on and in the collision shapes of the open hand, the first of them wide apart, are looked up
in voxels that are wholly inside the object. A point of both bodies proves an overlap, so that no pose is
rejected that the simulator accepts. Few points are looked up for all poses, more for the remaining ones.

Table: it is a plane, and no body in the simulator. A hand stays above it if the lowest corner of its open
fingers and palm does, at its pose and where its approach begins.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.genes import TOUCH_VALUE, VALUE_FEATURES, VALUED, descriptors
from qdgrasp_assets.geometry.rotation import Floats, dot
from qdgrasp_assets.geometry.voxels import rotation_matrices, transform_points
from qdgrasp_assets.grippers.hand_geometry import POINTS_AT_ONCE, STAGES, Closing, hand_geometry
from qdgrasp_assets.grippers.reachability import HandApproach
from qdgrasp_assets.scene import Scene, SceneGripper
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.decoder import DecodedGrasps
from qdgrasp_worker.object_geometry import ObjectSolid
from qdgrasp_worker.swept_volume import FirstContacts, SweptVolumes

DEFAULT_WEIGHTS = np.array([0.25, 1.0])
"""Weights of the features swept and opposed for a genome whose own are zero; opposed counts most."""
VALUE_DECIMALS = 6  # Decimals of a value; rounded, the last bits of an exponential decide no order


def scores(features: NDArray[np.float32], weights: Floats) -> Floats:
    """The value (p,) of poses: P(touch) (c + (1 - c) q), c being `TOUCH_VALUE`.

    P(touch) and the quality q of a grasp that touches are logistic functions of features (p, f). The weights
    (p, w) of each pose's genome are those of P(touch), those of q, and the least value to simulate.
    """
    touch, hold = weights[:, : features.shape[1]], weights[:, features.shape[1] : -1]
    value = logistic(weighted_sums(features, touch)) * (
        TOUCH_VALUE + (1.0 - TOUCH_VALUE) * logistic(weighted_sums(features, hold))
    )
    usual = weighted_sums(
        features[:, : len(DEFAULT_WEIGHTS)], np.broadcast_to(DEFAULT_WEIGHTS, (len(features), 2))
    )
    return np.where(touch.any(axis=1), value.round(VALUE_DECIMALS), usual)


def thresholds(weights: Floats) -> Floats:
    """The least value (n,) of a pose to simulate, by genomes' weights (n, w); -inf: any."""
    return np.where(weights[:, -1] > 0.0, weights[:, -1], -np.inf)


def weighted_sums(features: NDArray[np.float32], weights: Floats) -> Floats:
    """The sums (p,) of features (p, f) times weights (p, f), bits independent of p."""
    total = np.zeros(len(features))
    for i in range(features.shape[1]):
        total += weights[:, i] * features[:, i]
    return total


def logistic(values: Floats) -> Floats:
    """The logistic function of values (n,)."""
    result: Floats = 1.0 / (1.0 + np.exp(-values))
    return result


class PoseFeatures:
    """The features (docs/methods.md) of a scene's poses."""

    def __init__(self, scene: Scene, solid: ObjectSolid, closing: Closing) -> None:
        self._gripper = scene.gripper
        self._solid = solid
        self._volumes = SweptVolumes(scene.gripper, closing)
        self._points = solid.points.astype(np.float32)

    def features(self, grasps: DecodedGrasps, places: NDArray[np.intp]) -> NDArray[np.float32]:
        """The features (p, f) of the grasps of a batch at `places` (p,).

        All but height, lever and depth are between 0 and 1, or -1 and 1.
        """
        features = np.ones((len(places), len(VALUE_FEATURES)), dtype=np.float32)
        features[:, :2] = self._volumes.shares(self._points, grasps, places)
        features[:, 2:5] = self._geometry(grasps, places)
        contacts = self._volumes.first_contacts(self._solid.sample, grasps, places)
        features[:, 5:-1] = self._grip(contacts, grasps, places)
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

    def _grip(self, contacts: FirstContacts, grasps: DecodedGrasps, places: NDArray[np.intp]) -> Floats:
        """(p, 7): the `GRIP_FEATURES` of the contacts that the fingers would make."""
        hand, count = self._gripper, np.maximum(contacts.meets.sum(axis=1), 1)
        rotations = rotation_matrices(grasps.quaternions[places]).astype(np.float64)
        axes = np.stack([dot(rotations[:, i], np.array(hand.approach_axis)) for i in range(3)], axis=1)
        offsets = contacts.points - grasps.positions[places].astype(np.float64)[:, None]
        heights = (dot(offsets, axes[:, None]) - hand.palm_offset) / max(hand.reach - hand.palm_offset, 1e-9)
        line, middle = grip_line(contacts)
        lever = middle - dot(middle, line)[:, None] * line
        return np.stack(
            [
                contacts.meets.mean(axis=1),
                least_met(contacts.meets, -dot(contacts.normals, contacts.ways)),
                contacts.meets.any(axis=1) - lengths(contacts.normals.sum(axis=1)) / count,
                least_met(contacts.meets, np.abs(dot(contacts.normals, line[:, None]))),
                lengths(lever) / self._solid.radius,
                np.where(contacts.meets, 1.0 - heights, 0.0).sum(axis=1) / count,
                contacts.strokes.sum(axis=1) / count,
            ],
            axis=1,
        )


def grip_line(contacts: FirstContacts) -> tuple[Floats, Floats]:
    """Return direction (n, 3) and middle (n, 3) [m] of the line on which fingers press.

    It runs from the contact of the finger that presses most against the others to the middle of theirs; its
    direction is zero where fewer than two fingers meet the object.
    """
    meets = contacts.meets[..., None]
    count = np.maximum(contacts.meets.sum(axis=1), 1)[:, None]
    middle = contacts.points.sum(axis=1) / count
    agreement = dot(contacts.normals, contacts.normals.sum(axis=1)[:, None])
    alone = np.where(contacts.meets, agreement, np.inf).argmin(axis=1)
    rows = np.arange(len(alone))
    one = np.where(meets, contacts.points, 0.0)[rows, alone]
    others = (middle * count - one) / np.maximum(count - 1, 1)
    way = np.where(count > 1, others - one, 0.0)
    return way / np.maximum(lengths(way), 1e-9)[:, None], (one + others) / np.where(count > 1, 2.0, 1.0)


def least_met(meets: NDArray[np.bool_], values: Floats) -> Floats:
    """The least (n,) of values (n, f) of the fingers that meet the object; 0 where none does."""
    return np.where(meets.any(axis=1), np.where(meets, values, np.inf).min(axis=1), 0.0)


def lengths(vectors: Floats) -> Floats:
    """The lengths (...) of vectors (..., 3)."""
    return np.sqrt(dot(vectors, vectors))


class OverlapFilter:
    """Finds poses of a scene at which the hand surely overlaps.

    The hand is tested with its free joints where the grasp has them (`follows_free_joints`), or open.
    """

    def __init__(self, gripper: SceneGripper, solid: ObjectSolid, *, follows_free_joints: bool) -> None:
        self._samples = hand_geometry(gripper).samples
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


class TableFilter:
    """Finds poses at which the hand comes below the table in each of a scene's resting poses."""

    def __init__(self, scene: Scene) -> None:
        self._poses = scene.resting_poses
        self._approach = HandApproach(scene.gripper, scene.approach_distance) if self._poses else None

    def __call__(self, grasps: DecodedGrasps, places: NDArray[np.intp]) -> NDArray[np.intp]:
        """Those of `places` in a batch of grasps that are refused; none without a table."""
        if self._approach is None:
            return places[:0]
        clear = self._approach.clear_of(
            self._poses, grasps.positions[places], grasps.quaternions[places], grasps.joints[places]
        )
        return places[~clear.any(axis=1)]


@dataclass(frozen=True)
class Shortlist:
    """The candidates of one genome, by their places in the batch."""

    first: int
    """The pose of the genome's row if none is simulated: a finite one, or the first."""
    poses: int
    """Number of poses; 0: a dead end."""
    ranked: list[int]
    """Poses that do not surely overlap and score high enough, in the order in which they are tried."""
    fallback: Outcome
    """The outcome if none of them is simulated."""


class CandidateScreen:
    """Screens a scene's poses before they are simulated.

    `closing` closes the hand on nothing. In the test for overlap the free joints are as in the grasp
    (`follows_free_joints`), or open. `filters` says whether poses that surely overlap are left out, with the
    same results. Hands that come below the table are refused in any case.
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
        """The shortlist of each genome of a batch, and the features (poses, f) of ranked poses.

        Beyond trial 0 a genome's only pose is disturbed and not filtered; of several one is chosen first.
        Genomes that are not `wanted` (n,) have empty lists.
        """
        is_pose = ~grasps.dead_ends & wanted[grasps.genome_of]
        (poses,) = np.nonzero(is_pose)
        is_choice = np.bincount(grasps.genome_of[poses], minlength=len(trials)) > 1
        (nominal,) = np.nonzero(is_pose & (is_choice | (trials == 0))[grasps.genome_of])
        left = np.setdiff1d(poses, self._overlap(grasps, nominal)) if self._filters else poses
        left = np.setdiff1d(left, self._table(grasps, np.intersect1d(nominal, left)))
        features, order = self._rank(grasps, left)
        fallbacks = np.full(len(trials), int(Outcome.OVERLAP))
        if grasps.prior == VALUED:
            fallbacks[thresholds(grasps.weights) > -np.inf] = Outcome.DEAD_END
        return make_shortlists(grasps, poses, order, fallbacks), features

    def _rank(
        self, grasps: DecodedGrasps, left: NDArray[np.intp]
    ) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
        """The features (poses, f), and those of `left` with enough score, best first per genome."""
        features = np.zeros((len(grasps), descriptors(grasps.prior) - 3), dtype=np.float32)
        if grasps.prior != VALUED:
            return features, left
        rows = grasps.genome_of[left]
        features[left] = self._features.features(grasps, left)
        promised = scores(features[left], grasps.weights[rows])
        best_first = np.lexsort([-promised, rows])
        is_enough = promised >= thresholds(grasps.weights)[rows]
        return features, left[best_first[is_enough[best_first]]]

    @cached_property
    def _overlap(self) -> OverlapFilter:
        return OverlapFilter(self._scene.gripper, self._solid, follows_free_joints=self._follows)

    @cached_property
    def _table(self) -> TableFilter:
        return TableFilter(self._scene)

    @cached_property
    def _features(self) -> PoseFeatures:
        return PoseFeatures(self._scene, self._solid, self._closing)


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
