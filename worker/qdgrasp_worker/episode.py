"""Episodes: place one pose, look for overlap, close the hand, look for touch, shake."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from qdgrasp_assets.geometry.rotation import rotate
from qdgrasp_assets.grippers.reachability import APPROACH_STEP
from qdgrasp_assets.scene import Vector
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.contact_filter import ContactFilter
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.evaluation_protocols import (
    TARGET_STEPS,
    EvaluationProtocol,
    Shake,
    TrialSetup,
)
from qdgrasp_worker.world import GraspContact, GraspWorld, HandFrame, ShakenWorld


class EpisodeResult(NamedTuple):
    """Result of an episode."""

    outcome: Outcome
    joints: list[float]
    """Finger joints [rad or m] after closing if fingers touch then, else those at the start."""
    finger_links: int = 0
    """Number of finger links that touch the object after closing."""
    penetration: float = 0.0
    """Deepest penetration of hand and object after closing, 0 or positive [m]."""
    fitness: int = 0
    """Disturbances survived."""
    settled: Sequence[float] = (0.0,) * 7
    """The hand's base link in the object's frame after closing: x y z [m], qx qy qz qw; else zeros."""
    contacts: Sequence[GraspContact] = ()
    """The contacts after closing."""
    steps: int = 0
    """Number of steps of physics that were simulated."""


def outcome_of(survived: int, disturbances: int) -> Outcome:
    """The outcome of a success that survived `survived` of its protocol's `disturbances`."""
    if not survived:
        return Outcome.DROPPED
    return Outcome.HELD if survived == disturbances else Outcome.SHAKEN


def settled_pose(now: HandFrame, commanded: HandPose) -> list[float]:
    """The hand's base link in the object's frame as it is now: x y z [m], qx qy qz qw.

    Of the two quaternions of the rotation, the one nearer to the commanded pose's.
    """
    position, quaternion = now
    sign = -1.0 if quaternion @ np.array(commanded.quaternion) < 0.0 else 1.0
    values: list[float] = [*position.tolist(), *(sign * quaternion).tolist()]
    return values


def approach_path(pose: HandPose, axis: Vector, way: float) -> list[HandPose]:
    """Poses of a hand that comes `way` [m] along its approach axis (3,), base frame.

    They are `APPROACH_STEP` apart, the farthest first; the last is `pose` itself.
    """
    steps = ceil(way / APPROACH_STEP)
    position, along = np.array(pose.position), rotate(np.array(pose.quaternion), np.array(axis))
    places = position - APPROACH_STEP * np.arange(steps, 0, -1)[:, None] * along
    return [*(replace(pose, position=place) for place in places.astype(np.float32).tolist()), pose]


AnyWorld = TypeVar("AnyWorld", bound=GraspWorld)


@dataclass(frozen=True)
class Episode(ABC, Generic[AnyWorld]):
    """Simulates poses in a world under a protocol."""

    world: AnyWorld
    protocol: EvaluationProtocol
    contact_filter: ContactFilter | None = None
    """Finds poses that need no closing; it changes no verdict."""

    def run(self, trial: TrialSetup) -> EpisodeResult:
        """Evaluate one trial, from a clean start."""
        placed = self.place(trial)
        return placed if isinstance(placed, EpisodeResult) else self.grasp(placed.pose)

    def place(self, trial: TrialSetup) -> TrialSetup | EpisodeResult:
        """Place the open hand; return the trial as the hand stops, or the result if known."""
        if self.contact_filter:
            self.contact_filter.prepare(trial.pose.synergy)
        if trial.approaches:
            trial = self._approached(trial)
        if self.is_blocked(trial):
            return EpisodeResult(Outcome.OVERLAP, trial.pose.joints)
        if self.contact_filter and self.contact_filter.misses(trial.pose):
            return EpisodeResult(Outcome.MISSED, trial.pose.joints)
        return trial

    def grasp(self, pose: HandPose) -> EpisodeResult:
        """Close the hand, which was placed at `pose`, and disturb the grasp."""
        before = self.world.steps
        found = self._disturbed(pose, touched=self._close(pose))
        return found._replace(steps=self.world.steps - before)

    def _disturbed(self, pose: HandPose, *, touched: bool) -> EpisodeResult:
        """Disturb the grasp of the closed hand, if its fingers touch the object."""
        fingers = self._touching_fingers()
        if not fingers:
            return EpisodeResult(Outcome.BRUSHED if touched else Outcome.MISSED, pose.joints)
        closed = self._closed_grasp(pose, len(fingers))
        if closed.contacts and self.world.allowed and not self.world.allowed.holds(closed.contacts):
            return closed._replace(outcome=Outcome.BRUSHED)
        survived = self._survived()
        return closed._replace(outcome=outcome_of(survived, self.protocol.disturbances), fitness=survived)

    @abstractmethod
    def _close(self, pose: HandPose) -> bool:
        """Close the hand; return whether a finger touched the object before the last step."""

    @abstractmethod
    def _survived(self) -> int:
        """Disturb the grasp; return the number of disturbances that it survives."""

    def is_blocked(self, trial: TrialSetup) -> bool:
        """Place the open hand; return whether a link is inside the object there or on the way."""
        return (trial.clear_way > 0.0 and self.meets_on_way(trial)) or self.overlaps(trial)

    def meets_on_way(self, trial: TrialSetup) -> bool:
        """Move the open hand to its pose; return whether a link is inside the object on the way."""
        *way, _ = approach_path(trial.pose, self.world.approach_axis, trial.clear_way)
        self.world.reset(trial, trial.pose.joints)
        for pose in reversed(way):  # most contacts are near the end
            self.world.place_hand(pose)
            if self._is_inside():
                return True
        return False

    def overlaps(self, trial: TrialSetup) -> bool:
        """Place the open hand; return whether any link of it is inside the object."""
        pose = trial.pose
        first = pose.joints if self.protocol.free_joints_first else self.world.opened
        self.world.reset(trial, first)
        overlaps = self._is_inside()
        if not self.protocol.free_joints_first:
            self.world.set_fingers(pose.joints)
        return overlaps

    def _approached(self, trial: TrialSetup) -> TrialSetup:
        """A trial with the open hand where it stops on its way from outside to its pose.

        A hand that is inside the object at the start stays there, and overlaps.
        """
        world, path = self.world, approach_path(trial.pose, self.world.approach_axis, self.world.reach)
        stop = path[0]
        world.reset(replace(trial, pose=stop), stop.joints)
        for pose in path:
            world.place_hand(pose)
            if self._is_inside():
                break
            stop = pose
        return replace(trial, pose=stop)

    def _is_inside(self) -> bool:
        """Return whether any link of the hand is inside the object."""
        return any(contact.distance < 0.0 for contact in self.world.contacts())

    def _closed_grasp(self, pose: HandPose, fingers: int) -> EpisodeResult:
        """Read the world as it is after closing, before any disturbance."""
        return EpisodeResult(
            Outcome.DROPPED,
            self.world.finger_positions(),
            fingers,
            self._penetration(),
            settled=settled_pose(self.world.hand_pose(), pose),
            contacts=self.world.contact_forces(),
        )

    def _touching_fingers(self) -> set[int]:
        return {contact.link for contact in self.world.contacts()} & self.world.finger_links

    def _penetration(self) -> float:
        return max([0.0, *(-contact.distance for contact in self.world.contacts())])


@dataclass(frozen=True)
class ShakenEpisode(Episode[ShakenWorld]):
    """Simulates poses in a world whose hand is shaken."""

    def _close(self, pose: HandPose) -> bool:
        """Close the hand; return whether a finger touched the object before the last step."""
        touched = False
        for _ in self.world.steps_of_closing(pose.synergy):
            touched = touched or bool(self._touching_fingers())
            self.world.step()
        return touched

    def _survived(self) -> int:
        """Shake the hand; return the number of shakes in which the object stays in touch."""
        survived = 0
        for shake in self.protocol.shakes:
            if self._holds_through(shake):
                survived += 1
            elif self.protocol.ends_when_lost:
                break
        return survived

    def _holds_through(self, shake: Shake) -> bool:
        for target in shake.targets:
            self.world.shake_to(target, shake)
            for _ in range(0, TARGET_STEPS, self.protocol.contact_check_steps):
                for _ in range(self.protocol.contact_check_steps):
                    self.world.step()
                if not self.world.is_touching():
                    return False
        return True
