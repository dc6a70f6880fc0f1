"""Episodes of `physical`: close on a fixed object with bounded torques, release and push it.

The constants, and where they are from: `evaluation_protocols.Physics`, docs/protocols.md.

1. The object is fixed while the fingers close. Each joint has an explicit PD law whose torque is bounded by
   what the real drive gives; its target walks at closing speed, never farther ahead of the joint than its
   preload needs. The reflected inertia of the drive is added to the finger's link: without it the law is
   unstable, and the solver, not the drive, would set the force of the grip.
2. The object is released, and its velocity damped until it rests. The targets of a jaw go on walking, since
   a jaw centres what it holds; those of other hands stay.
3. The grasp is read. Then the object is pushed with its own weight along both ways of each axis of the hand,
   one after the other, until one of the pushes makes the hand lose it.
"""

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import acos, dist
from typing import NamedTuple

from qdgrasp_assets.geometry.rotation import running_sum
from qdgrasp_assets.scene import Scene, SceneGripper
from qdgrasp_worker.bullet import BASE, UPRIGHT, Bullet, BulletLink, Quaternion, Vector
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.episode import Episode
from qdgrasp_worker.evaluation_protocols import Physics, TrialSetup
from qdgrasp_worker.finger_drive import FingerControl, FingerDrive
from qdgrasp_worker.hand_geometry import free_posture
from qdgrasp_worker.world import (
    AWAY_POSITION,
    FREE_POSTURES,
    GraspWorld,
    HandBody,
    World,
    closing_joints,
)

HAND_FRICTION = 0.5  # Lateral friction of the hand's links; Bullet multiplies it with the object's
RESTING_LOOKS = 3  # Looks in a row at which all must rest
REST_SPEED, REST_SPIN = 2e-3, 0.04  # Below them a released object rests [m/s, rad/s]
PUSHES = (
    (1.0, 0.0, 0.0),
    (-1.0, 0.0, 0.0),
    (0.0, 1.0, 0.0),
    (0.0, -1.0, 0.0),
    (0.0, 0.0, 1.0),
    (0.0, 0.0, -1.0),
)
"""Directions of the pushes, hand frame."""


class PosesNow(NamedTuple):
    """Places of all that can move."""

    joints: list[float]
    position: Vector
    quaternion: Quaternion


class PhysicalWorld(GraspWorld):
    """A fixed hand with driven fingers, and an object that is fixed or free, in some engine."""

    physics: Physics
    steps_at_once = 1
    """Steps that `step` moves on by; divides `Physics.look_every`."""
    _control: FingerControl
    _names: dict[int, list[str]]
    """Names of the joints that close, by the synergy's label."""
    _away: TrialSetup

    @abstractmethod
    def release(self) -> None:
        """Let the object go, damped; the targets of a jaw go on, others stay."""

    @abstractmethod
    def begin_pushes(self) -> None:
        """Let all targets stay, and take the damping off the object."""

    @abstractmethod
    def push(self, direction: Vector) -> None:
        """Push the object with its weight, during the next step, along a direction in hand frame."""

    @abstractmethod
    def object_pose(self) -> tuple[Vector, Quaternion]:
        """The object's position and quaternion; the hand does not move."""

    def look(self) -> PosesNow:
        """The places of all that can move, as they are now."""
        return PosesNow(self.finger_positions(), *self.object_pose())

    def closing_joints(self, synergy: int) -> list[str]:
        """The names of a synergy's joints; a ValueError for one that the hand does not have."""
        if synergy not in self._names:
            raise ValueError(f"synergy must be one of {sorted(self._names)}, got {synergy}")
        return self._names[synergy]

    def rests(self, before: PosesNow, after: PosesNow) -> bool:
        """Return whether neither fingers nor object have moved from one look to the next.

        Places tell, not velocities: those of what is pressed together change sign at every step.
        """
        seconds = self.physics.look_every * self.physics.time_step
        return (
            self._control.rests(before.joints, after.joints, seconds)
            and dist(before.position, after.position) < REST_SPEED * seconds
            and angle_between(before.quaternion, after.quaternion) < REST_SPIN * seconds
        )

    def closing_steps(self, synergy: int) -> int:
        """The most steps that closing takes."""
        names = self._names[synergy]
        longest = max((drive.duration for drive in self._control.drives if drive.name in names), default=0.0)
        return self.physics.steps(longest + self.physics.slack)

    def closing(self, posture: Sequence[float], synergy: int) -> list[list[float]]:
        """The finger joints [rad or m] while they close on nothing: before, and after each step."""
        self.reset(self._away, posture)
        course = [self.finger_positions()]
        for _ in self.steps_of_closing(synergy):
            self.step()
            course.append(self.finger_positions())
        return course

    def steps_of_closing(self, synergy: int) -> Iterator[int]:
        """Begin to close, and count the steps until the fingers rest."""
        self.close_fingers(synergy)
        yield from self.steps_to_rest(self.closing_steps(synergy))

    def steps_to_rest(self, most: int) -> Iterator[int]:
        """Count steps until all rests, `most` at most."""
        resting, before = 0, self.look()
        for step in range(0, most, self.steps_at_once):
            if step and step % self.physics.look_every == 0:
                now = self.look()
                resting = resting + 1 if self.rests(before, now) else 0
                before = now
                if resting == RESTING_LOOKS:
                    return
            yield step


class BulletPhysicalWorld(PhysicalWorld, World):
    """A world of `physical` in Bullet."""

    _links_meet = True

    def __init__(self, scene: Scene, physics: Physics) -> None:
        self.physics = physics
        self._breaking_threshold = physics.breaking_threshold
        super().__init__(scene)

    def _prepare_motion(self, gripper: SceneGripper) -> None:
        bullet, hand, target = self._bullet, self._hand, self._target
        bullet.set_breaking_threshold(self._breaking_threshold)  # a pair keeps the one that it first met with
        iterations = self.physics.jaw_iterations if gripper.jaw else self.physics.iterations
        bullet.set_stepping(self.physics.time_step, iterations)
        bullet.set_contact_recovery(self.physics.recovery)
        target.lateral_friction /= HAND_FRICTION
        target.frictions = self.physics.rolling / HAND_FRICTION, self.physics.spinning / HAND_FRICTION
        links = bullet.links(hand.body)
        for link in range(BASE, len(links)):
            bullet.set_friction(hand.body, HAND_FRICTION, 0.0, 0.0, link)
        self._mass, self._moments = bullet.inertia(target.body)
        self._names = {label: list(joints) for label, joints in closing_joints(gripper).items()}
        self._let_pass(gripper, links)
        self._place_away(gripper, self.opened)
        drives = [
            FingerDrive.of(
                joint,
                links[index],
                reach_of(bullet, hand, index, links),
                in_jaw=gripper.jaw is not None,
                haste=self.physics.haste,
            )
            for index, joint in zip(hand.fingers, gripper.joints, strict=True)
        ]
        for index, drive in zip(hand.fingers, drives, strict=True):
            self._add_inertia(index, drive.inertia, slides=links[index].slides)
        bullet.switch_motors_off(hand.body, hand.fingers)
        self._control = FingerControl(drives, is_coupled=gripper.jaw is not None)

    def _let_pass(self, gripper: SceneGripper, links: Sequence[BulletLink]) -> None:
        """Let links pass through each other that are said to, or that touch while the hand is open."""
        bullet, body = self._bullet, self._hand.body
        named = {link.link: index for index, link in enumerate(links)}
        root = links[0].parent
        pairs = {(named.get(one, root), named.get(other, root)) for one, other in gripper.disabled_collisions}
        pairs |= neighbours(links)
        for i in range(FREE_POSTURES if gripper.free_joints else 1):
            self._place_away(gripper, free_posture(gripper, i / (FREE_POSTURES - 1)))
            pairs |= bullet.touching_links(body)
        for one, other in sorted(pairs):
            bullet.pass_through(body, one, other)

    def _place_away(self, gripper: SceneGripper, posture: Sequence[float]) -> None:
        self._bullet.place(self._hand.body, AWAY_POSITION, UPRIGHT)
        self._bullet.set_joints(self._hand.body, self._joints, [*self._at_zero, *posture])
        self._bullet.detect()

    def _add_inertia(self, index: int, inertia: float, *, slides: bool) -> None:
        """Add the reflected inertia of a drive to the link that its joint moves."""
        mass, moments = self._bullet.inertia(self._hand.body, index)
        if slides:
            scale = 1 + inertia / mass
            mass, added = mass + inertia, [moment * scale for moment in moments]
        else:
            added = [moment + inertia for moment in moments]
        self._bullet.set_inertia(self._hand.body, mass, added, index)

    def reset(self, trial: TrialSetup, posture: Sequence[float]) -> None:
        """Put hand and object in place as `World.reset` does; the object is free and undamped."""
        self._bullet.set_damping(self._target.body, 0.0)
        self._bullet.set_inertia(self._target.body, self._mass, self._moments)
        super().reset(trial, posture)
        self._axes = trial.pose.axes
        self._posture = list(posture)

    def set_fingers(self, posture: Sequence[float]) -> None:
        """Put the finger joints at `posture` [rad or m], at rest."""
        super().set_fingers(posture)
        self._posture = list(posture)

    def close_fingers(self, synergy: int) -> None:
        """Fix the object and begin to close; a ValueError for a synergy that the hand does not have."""
        names = self.closing_joints(synergy)
        self._bullet.set_inertia(self._target.body, 0.0, self._moments)
        self._control.start(self._posture, names)

    def release(self) -> None:
        """Let the object go, damped; the targets of a jaw go on, others stay."""
        self._bullet.set_inertia(self._target.body, self._mass, self._moments)
        self._bullet.set_damping(self._target.body, self.physics.damping)
        if not self._control.is_coupled:
            self._control.stop()

    def begin_pushes(self) -> None:
        """Let all targets stay, and take the damping off the object."""
        self._bullet.set_damping(self._target.body, 0.0)
        self._control.stop()

    def step(self) -> None:
        """Move on by a step, with the fingers' torques."""
        bullet, hand = self._bullet, self._hand
        states = bullet.joint_motion(hand.body, hand.fingers)
        torques = self._control.torques(states, self.physics.time_step)
        bullet.apply_torques(hand.body, hand.fingers, torques)
        super().step()

    def push(self, direction: Vector) -> None:
        """Push the object with its weight, during the next step, along a direction in hand frame."""
        force = self._mass * self.physics.weight
        (a, b, c), (x, y, z) = self._axes, direction
        along = [force * (x * a[i] + y * b[i] + z * c[i]) for i in range(3)]
        self._bullet.push(self._target.body, along, self._bullet.position(self._target.body))

    def object_pose(self) -> tuple[Vector, Quaternion]:
        """The object's position and quaternion; the hand does not move."""
        return self._bullet.pose(self._target.body)


def reach_of(bullet: Bullet, hand: HandBody, joint: int, links: Sequence[BulletLink]) -> float:
    """Distance from a joint to the farthest corner of a box of what it moves [m]."""
    place = bullet.joint_place(hand.body, joint)
    moved = {joint}
    for index in range(joint + 1, len(links)):  # Bullet numbers a link after the one that carries it
        if links[index].parent in moved:
            moved.add(index)
    corners = [
        (x, y, z)
        for link in sorted(moved.intersection(hand.shaped_links))
        for low, high in [bullet.box(hand.body, link)]
        for x in (low[0], high[0])
        for y in (low[1], high[1])
        for z in (low[2], high[2])
    ]
    return max((dist(place, corner) for corner in corners), default=0.0)


def neighbours(links: Sequence[BulletLink]) -> set[tuple[int, int]]:
    """Pairs of links between which there is no joint that moves, or one."""
    heads = {BASE: BASE}  # of each link the first one that is fixed to it
    for index, link in enumerate(links):
        heads[index] = index if link.moves else heads[link.parent]
    carriers = {head: BASE if head == BASE else heads[links[head].parent] for head in heads.values()}
    return {
        (one, other)
        for one, head in heads.items()
        for other, with_head in heads.items()
        if one < other and (head == with_head or carriers[head] == with_head or carriers[with_head] == head)
    }


@dataclass(frozen=True)
class PhysicalEpisode(Episode):
    """Simulates poses in a world of `physical`."""

    world: PhysicalWorld  # type: ignore[assignment]  # of World it takes what every GraspWorld has

    @property
    def disturbances(self) -> int:
        """Number of pushes that a grasp meets."""
        return len(PUSHES)

    def _close(self, pose: HandPose) -> bool:
        """Close on the fixed object, then let it go and come to rest."""
        world = self.world
        touched = False
        for _ in world.steps_of_closing(pose.synergy):
            world.step()
            touched = touched or bool(self._touching_fingers())
        if touched:
            world.release()
            for _ in world.steps_to_rest(world.physics.steps(world.physics.settling)):
                world.step()
        return touched

    def _survived(self) -> int:
        """Push the object along the axes of the hand; how many pushes the hand holds it through."""
        self.world.begin_pushes()
        start = self.world.object_pose()
        for survived, direction in enumerate(PUSHES):
            if not self._holds_against(direction, *start):
                return survived
        return len(PUSHES)

    def _holds_against(self, direction: Vector, position: Vector, quaternion: Quaternion) -> bool:
        world, physics = self.world, self.world.physics
        for step in world.steps_to_rest(physics.steps(physics.push_time)):
            world.push(direction)
            world.step()
            if (step + world.steps_at_once) % physics.look_every == 0 and self._has_lost(
                position, quaternion
            ):
                return False
        return True

    def _has_lost(self, position: Vector, quaternion: Quaternion) -> bool:
        physics, (place, turned) = self.world.physics, self.world.object_pose()
        return (
            dist(place, position) > physics.lost_distance
            or angle_between(turned, quaternion) > physics.lost_angle
            or not self.world.is_touching()
        )


def angle_between(one: Sequence[float], other: Sequence[float]) -> float:
    """The angle between two rotations as quaternions [rad]."""
    return 2 * acos(min(1.0, abs(running_sum(a * b for a, b in zip(one, other, strict=True)))))
