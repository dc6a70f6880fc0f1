"""The reach: poses at which the closing hand surely stays away from the object, found without a step.

An object that nothing comes near stays where it is, and the hand closes as it closes on nothing. So the hand
is watched while it does that, once for each synergy, with all its collision shapes, the palm's among them;
`zone` keeps how far from them everything else is. The surface of the object is covered by balls (`cover`): a
pose at which each of them is farther from the shapes than Bullet sees contacts ahead cannot touch.

It errs on one side only:

- Bullet keeps a contact up to 2 % of the smaller shape's disc beyond the margins of 1 mm: balls are to be
  farther away than that (`sight`).
- Marked are voxels whose middle is within half their diagonal of a shape, and within what it moves between
  two looks, and within what round shapes reach beyond the corners that stand for them. A point is taken to be
  nearer by a diagonal than the middle of its voxel is. Shapes of many planes are replaced by larger ones.
- A hand that is wholly within the object, away from its surface, overlaps; Bullet's test of the open hand
  comes first. Where that test has the free joints elsewhere, they are looked at there too.
- A finger on a free joint closes nearly alike wherever that joint stands, so that its zone goes with the
  frame that the joint carries. `STRAY` is for the rest: how fingers pull at each other depends on
  their places.
- Where a shape or a free joint is not understood, every pose is simulated.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_worker.convex import Hull
from qdgrasp_worker.cover import Balls, Cover
from qdgrasp_worker.grasp import Pose
from qdgrasp_worker.mounts import Mounts
from qdgrasp_worker.skeleton import Skeleton
from qdgrasp_worker.solid import Solid
from qdgrasp_worker.sweep import axes
from qdgrasp_worker.voxels import Singles
from qdgrasp_worker.zone import UNIT, Zone

MARGIN = 1e-3
"""Bullet's collision margin of a hull [m]."""
BREAKING = 0.02
"""Bullet's contact breaking threshold, in discs."""
STRAY = 5e-4
"""How far a closing finger may be from where it was watched, with the free joints elsewhere [m]."""
BETWEEN = 8
"""Postures from one step to the next."""
PLACES = (0.0, 1.0)
"""Where on their ranges the free joints are while the hand is watched."""
Closing = Callable[[Sequence[float], int], list[list[float]]]
"""The courses of a closing hand's joints, by its initial posture and its synergy."""


class Everywhere:
    """The reach of a hand of which nothing is known: it misses nowhere for sure."""

    def watch(self, synergy: int) -> None:
        """Do nothing."""

    def misses(self, pose: Pose) -> bool:
        """False."""
        return False


@dataclass(frozen=True)
class Guard:
    """Balls that no zone may come near."""

    centres: Singles
    """(n, 3) [m]."""
    far: NDArray[np.uint8]
    """(n,): how far from a zone each must be, in its units."""

    @classmethod
    def of(cls, balls: Balls, sight: float) -> Self:
        """Guard balls that are seen from `sight` [m]."""
        far = np.ceil((balls.radii + sight) / UNIT).clip(0, 255)
        return cls(balls.centres.astype(np.float32), far.astype(np.uint8))

    def among(self, which: NDArray[np.bool_]) -> Self:
        """Those of the balls."""
        return replace(self, centres=self.centres[which], far=self.far[which])


EVERYWHERE = Everywhere()


class Reach:
    """What tells poses at which a scene's hand surely misses.

    Parameters
    ----------
    closing
        How the hand closes on nothing; asked when a synergy is first met.
    follows_free_joints
        Whether the test for overlap has the free joints where the grasp has them, or open.
    """

    def __init__(
        self, gripper: SceneGripper, solid: Solid, closing: Closing, *, follows_free_joints: bool
    ) -> None:
        self._gripper = gripper
        self._skeleton = Skeleton(gripper)
        self._mounts = Mounts(gripper, self._skeleton)
        self.is_known = self._skeleton.is_whole and solid.is_whole and self._mounts.are_still
        """Whether hand and object are understood; where they are not, it misses nowhere for sure."""
        self._closing = closing
        opened = [joint.opened for joint in gripper.joints]
        self._at_first = [] if follows_free_joints or not gripper.free_joints else [opened]
        self._zones: dict[int, dict[str, Zone]] = {}
        if self.is_known:
            cover = Cover.of(solid)
            self._large, self._small = (
                Guard.of(cover.large, sight(solid)),
                Guard.of(cover.small, sight(solid)),
            )
            self._counts = cover.counts

    def watch(self, synergy: int) -> None:
        """Have the hand close on nothing where its zones with a synergy are not known yet."""
        if self.is_known and synergy not in self._zones:
            self._zones[synergy] = self._measure(synergy)

    def misses(self, pose: Pose) -> bool:
        """Whether the hand, while it closes at `pose`, surely never comes as near as a contact."""
        if not self.is_known:
            return False
        self.watch(pose.synergy)
        turn = np.array(axes(pose.quaternion))
        move = -turn @ np.array(pose.position)
        return all(
            self._is_clear(zone, frame[:3, :3].T @ turn, frame[:3, :3].T @ (move - frame[:3, 3]))
            for zone, frame in self._placed(pose)
        )

    def _placed(self, pose: Pose) -> Iterator[tuple[Zone, Floats]]:
        """Each zone with its frame (4, 4) in the hand's, wherever the free joints are."""
        for posture in [pose.joints, *self._at_first]:
            frames = self._mounts.frames(posture)
            for link, zone in self._zones[pose.synergy].items():
                yield zone, frames[link]

    def _is_clear(self, zone: Zone, turn: Floats, move: Floats) -> bool:
        """Whether no ball is near a zone; where a large one is, its small ones are looked up.

        One that is in the midst of it is enough to give up.
        """
        frame = turn.astype(np.float32), move.astype(np.float32)
        away = zone.at(self._large.centres, *frame)
        is_near = away <= self._large.far
        if not is_near.any() or not away.all():
            return not is_near.any()
        small = self._small.among(np.repeat(is_near, self._counts))
        return bool((zone.at(small.centres, *frame) > small.far).all())

    def _measure(self, synergy: int) -> dict[str, Zone]:
        """Watch the hand close: the zone in the frame of each mount."""
        passing: dict[str, list[tuple[Hull, Floats]]] = {}
        for place in PLACES[: 1 + bool(self._gripper.free_joints)]:
            posture = self._posture(place)
            frames = self._skeleton.frames(between(np.array(self._closing(posture, synergy))))
            mounts = self._mounts.frames(posture)
            for link, hulls in self._skeleton.hulls.items():
                under = self._mounts.under[link]
                course = np.linalg.inv(mounts[under]) @ frames[link]
                passing.setdefault(under, []).extend((hull, course) for hull in hulls)
        return {link: Zone.of(courses) for link, courses in passing.items() if courses}

    def _posture(self, share: float) -> list[float]:
        """The open posture with the free joints at this share of their ranges."""
        free = {joint.name: joint for joint in self._gripper.free_joints}
        return [
            free[joint.name].low + share * (free[joint.name].high - free[joint.name].low)
            if joint.name in free
            else joint.opened
            for joint in self._gripper.joints
        ]


def between(course: Floats) -> Floats:
    """The postures (n, j) of a course (steps, j), with more of them in between."""
    steps = np.arange(len(course))
    finer = np.linspace(0, len(course) - 1, BETWEEN * (len(course) - 1) + 1)
    return np.stack([np.interp(finer, steps, joint) for joint in course.T], axis=1)


def sight(solid: Solid) -> float:
    """How far from an object's surface a contact may begin, and somewhat more [m]."""
    low, high = solid.box
    disc = np.linalg.norm(high - low) / 2 + np.linalg.norm(high + low) / 2
    return float(2 * MARGIN + BREAKING * (disc + MARGIN) + STRAY)
