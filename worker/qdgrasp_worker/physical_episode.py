"""Episodes of `physical`: close on a fixed object with bounded torques, release and push it.

The constants, and where they are from: `evaluation_protocols.Physics`, docs/protocols.md.

1. The object is fixed while the fingers close. Each joint has an explicit PD law whose torque is bounded by
   the real drive's limit; its target moves at closing speed, never farther ahead of the joint than its
   preload needs. The reflected inertia of the drive is added to the finger's link: without it the law is
   unstable, and the solver, not the drive, would set the force of the grip.
2. The object is released, and its velocity damped until it rests. The targets of a jaw move on, since
   a jaw centres its object; those of other hands stay.
3. The grasp is read. Then the object is pushed with its own weight along both ways of each axis of the hand,
   one after the other, until one of the pushes makes the hand lose it.

In `lift` the object rests on a table, and the table moves: in the frame of a hand that is lifted it goes
down, and the object bears its weight and the inertia of the lift (`LiftEpisode`).

Neighbours are fixed bodies that hand and object meet, and whose contacts are none of a grasp. They go away
before the pushes, which none of them is to withstand, and down with the table in a lift.
"""

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import acos, dist, inf

from qdgrasp_assets.geometry.rotation import running_sum
from qdgrasp_assets.grippers.urdf import UrdfJoint
from qdgrasp_assets.scene import Joint, RestingPose, SceneGripper, Vector
from qdgrasp_protocol.drives import DAMPING_RATIO, JAW_PRELOAD, DriveGains
from qdgrasp_worker.contact_margin import HULL_MARGIN
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.episode import Episode
from qdgrasp_worker.evaluation_protocols import PUSHES, Lift, Physics
from qdgrasp_worker.world import GraspWorld, Quaternion

FINGERTIP_FORCE = 15.0  # Force at the fingertip of a turning joint whose drive is not known, at most [N]


@dataclass(frozen=True)
class FingerDrive:
    """The drive of a finger joint; lengths in m, angles in rad, forces in N or Nm."""

    name: str
    opened: float
    closed: float
    lowest: float
    """Least target."""
    highest: float
    """Greatest target."""
    limit: float
    """Greatest force or torque."""
    stiffness: float
    damping: float
    inertia: float
    """Reflected inertia [kg or kg m2]."""
    lead: float
    """Greatest distance of the target from the joint."""
    speed: float
    """Closing speed [m/s or rad/s]."""
    rest_speed: float

    @classmethod
    def of(cls, joint: Joint, found: UrdfJoint, reach: float, *, in_jaw: bool, haste: float) -> "FingerDrive":
        """The drive of a joint that reaches `reach` [m] to the farthest point that it moves."""
        slides, limits = found.kind == "prismatic", (found.lower, found.upper)
        gains = DriveGains.of(found.kind)
        known = gains.effort if slides else FINGERTIP_FORCE * reach
        limit = joint.rated_effort or (min(joint.effort, known) if joint.effort > 0 else known)
        stiffness = limit / gains.lag
        # Bullet stops joints at limits in order, against any preload, and ignores reversed limits.
        lower, upper = sorted(limits)
        is_reversed = limits[0] > limits[1]
        return cls(
            name=joint.name,
            opened=joint.opened,
            closed=joint.closed if joint.driven else joint.opened,
            lowest=lower if is_reversed else -inf,
            highest=upper if is_reversed else inf,
            limit=limit,
            stiffness=stiffness,
            damping=2 * DAMPING_RATIO * stiffness / gains.frequency,
            inertia=stiffness / gains.frequency**2,
            lead=gains.lag * (JAW_PRELOAD if in_jaw else 1.0),
            speed=haste * (joint.rated_velocity or gains.speed),
            rest_speed=gains.rest_speed,
        )

    @property
    def duration(self) -> float:
        """Time in which it closes freely [s]."""
        return (abs(self.closed - self.opened) + self.lead) / self.speed


def finger_drives(
    gripper: SceneGripper, found: Sequence[UrdfJoint], reaches: Sequence[float], haste: float
) -> list[FingerDrive]:
    """The drives of the finger joints, in the gripper's order: `found` are those of the URDF."""
    in_jaw = gripper.jaw is not None
    joints = zip(gripper.joints, found, reaches, strict=True)
    return [FingerDrive.of(*each, in_jaw=in_jaw, haste=haste) for each in joints]


class FingerControl:
    """The PD laws of a hand's finger joints, with their targets."""

    def __init__(self, drives: Sequence[FingerDrive], *, is_coupled: bool) -> None:
        self.drives = drives
        self.is_coupled = is_coupled
        self.preload = 1.0
        """Factor of the force with which it grips."""
        self.targets = [drive.opened for drive in drives]
        """Target of each joint [m or rad]."""
        self.ways: list[tuple[int, float]] = [(0, drive.opened) for drive in drives]
        """Of each target its sense, +1, -1 or 0, and its end."""

    def start(self, posture: Sequence[float], closing: Sequence[str], preload: float = 1.0) -> None:
        """Let the targets of the joints `closing` move from `posture`; the others stay there.

        `preload` is a factor of the force with which they grip.
        """
        self.targets, self.preload = list(posture), preload
        self.ways = [
            target_motion(drive, place) if drive.name in closing else (0, place)
            for drive, place in zip(self.drives, posture, strict=True)
        ]

    def stop(self) -> None:
        """Stop all targets."""
        self.ways = [(0, target) for target in self.targets]

    def torques(self, states: Sequence[tuple[float, float]], time_step: float) -> list[float]:
        """Advance the targets; return each joint's force or torque by its position and velocity."""
        targets = self.walk([position for position, _ in states], time_step)
        torques = []
        for drive, target, (position, velocity) in zip(self.drives, targets, states, strict=True):
            torque = drive.stiffness * (target - position) - drive.damping * velocity
            torques.append(max(-drive.limit, min(drive.limit, torque)))
        return torques

    def walk(self, positions: Sequence[float], seconds: float) -> list[float]:
        """Advance the targets by the joints' positions; return the target of each joint."""
        share = self._mean_share(positions) if self.is_coupled else None
        for i, (drive, (sense, end), position) in enumerate(
            zip(self.drives, self.ways, positions, strict=True)
        ):
            if sense:
                place = position if share is None else drive.opened + share * (drive.closed - drive.opened)
                ahead = min(
                    sense * self.targets[i] + drive.speed * seconds,
                    sense * place + self.preload * drive.lead,
                    sense * end,
                )
                self.targets[i] = sense * ahead
        return self.targets

    def _mean_share(self, positions: Sequence[float]) -> float:
        """Mean share of their way that the moving joints have gone."""
        shares = [
            (position - drive.opened) / (drive.closed - drive.opened)
            for drive, (sense, _), position in zip(self.drives, self.ways, positions, strict=True)
            if sense
        ]
        return running_sum(shares) / len(shares) if shares else 0.0

    def rests(self, before: Sequence[float], after: Sequence[float], seconds: float) -> bool:
        """Return whether no joint has moved faster than at rest from one look to the next."""
        return all(
            abs(now - then) < drive.rest_speed * seconds
            for drive, then, now in zip(self.drives, before, after, strict=True)
        )


def target_motion(drive: FingerDrive, place: float) -> tuple[int, float]:
    """Sense and end of a way from `place` beyond the closed position, within the limits."""
    sense = (drive.closed > place) - (drive.closed < place)
    return sense, min(max(drive.closed + sense * drive.lead, drive.lowest), drive.highest)


RESTING_LOOKS = 2  # Looks in a row at which all must rest
REST_SPEED, REST_SPIN = 2e-3, 0.04  # Speeds below which a released object rests [m/s, rad/s]
Look = tuple[list[float], Vector, Quaternion]  # Places of joints, position and quaternion of the object
TABLE_HALF = (0.5, 0.5, 0.05)  # Half sides of a table [m]
OUT_OF_THE_WAY = 20.0  # Way by which neighbours go away before the pushes [m]
NO_TABLE_UP = (0.0, 0.0, 1.0)  # The way up where there is no table, CoM frame


def table_middle(pose: RestingPose, way: float) -> Vector:
    """The middle of a table `way` [m] below the one that an object rests on, CoM frame [m]."""
    depth = pose.height - HULL_MARGIN - TABLE_HALF[2] - way
    x, y, z = (depth * axis for axis in pose.up)
    return x, y, z


class PhysicalWorld(GraspWorld):
    """A fixed hand with driven fingers, and an object that is fixed or free, in some engine."""

    physics: Physics
    table: RestingPose | None = None
    """Resting pose of the object on a table at first; None: there is no table."""
    steps_at_once = 1
    """Number of steps that `step` simulates; divides `Physics.look_every`."""
    _control: FingerControl

    @abstractmethod
    def release(self) -> None:
        """Release the object, damped; the targets of a jaw move on, others stay."""

    @abstractmethod
    def disturb(self) -> None:
        """Stop all targets, and remove the damping of the object, before pushes or a lift."""

    @abstractmethod
    def push(self, direction: Vector) -> None:
        """Push the object with its weight, during the next step, along a direction in hand frame."""

    @abstractmethod
    def weigh(self, factor: float) -> None:
        """Pull the object towards the table with `factor` times its weight, during the next step."""

    @abstractmethod
    def lower_surroundings(self, way: float) -> None:
        """Put table and neighbours, where there are any, `way` [m] below their places at first."""

    @abstractmethod
    def is_on_table(self) -> bool:
        """Return whether the object touches the table."""

    def look(self) -> Look:
        """The present places of all that can move."""
        return self.finger_positions(), *self.object_pose()

    def rests(self, before: Look, after: Look) -> bool:
        """Return whether neither fingers nor object have moved from one look to the next.

        Places are compared, not velocities: those of bodies pressed together change sign at every step.
        """
        seconds = self.physics.look_every * self.physics.time_step
        return (
            self._control.rests(before[0], after[0], seconds)
            and dist(before[1], after[1]) < REST_SPEED * seconds
            and angle_between(before[2], after[2]) < REST_SPIN * seconds
        )

    def closing_steps(self, synergy: int) -> int:
        """The most steps that closing takes."""
        names = self._names[synergy]
        longest = max((drive.duration for drive in self._control.drives if drive.name in names), default=0.0)
        return self.physics.steps(longest + self.physics.slack)

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


@dataclass(frozen=True)
class PhysicalEpisode(Episode[PhysicalWorld]):
    """Simulates poses in a world of `physical`."""

    def _close(self, pose: HandPose) -> bool:
        """Close on the fixed object, then release it and let it come to rest."""
        world = self.world
        touched = False
        for _ in world.steps_of_closing(pose.synergy):
            world.step()
            touched = touched or bool(self._touching_fingers())
        if touched:
            world.release()
            for _ in world.steps_to_rest(world.physics.steps(world.physics.settling)):
                self._settle()
        return touched

    def _settle(self) -> None:
        """Simulate one step in which the object comes to rest."""
        self.world.step()

    def _survived(self) -> int:
        """Push the object along the axes of the hand; return the number of pushes survived."""
        self.world.disturb()
        self.world.lower_surroundings(OUT_OF_THE_WAY)
        start = self.world.object_pose()
        for survived, direction in enumerate(PUSHES):
            if not self._holds_against(direction, *start):
                return survived
        return len(PUSHES)

    def _holds_against(self, direction: Vector, position: Vector, quaternion: Quaternion) -> bool:
        world, physics = self.world, self.world.physics
        x, y, z = (world.trial.load * part for part in direction)
        for step in world.steps_to_rest(physics.steps(physics.push_time)):
            world.push((x, y, z))
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


@dataclass(frozen=True)
class LiftEpisode(PhysicalEpisode):
    """Simulates poses in a world of `lift`.

    The hand closes as in `physical`. The object then comes to rest with its weight, between hand and table,
    and is lifted: the table goes down. The episode ends early when the object is off the table and rests in
    the hand, which by then goes up with constant speed: nothing changes any more.
    """

    lift: Lift = field(default_factory=Lift)

    def _settle(self) -> None:
        self.world.weigh(1.0)
        self.world.step()

    def _survived(self) -> int:
        """Lift the object; return whether it ends in the hand, off the table."""
        world, physics, lift = self.world, self.world.physics, self.lift
        world.disturb()
        start, before, resting = world.object_pose(), world.look(), 0
        for step in range(0, physics.steps(lift.seconds), world.steps_at_once):
            after = step + world.steps_at_once
            is_rising = step < physics.steps(lift.rise)
            world.lower_surroundings(lift.way(after * physics.time_step))
            world.weigh(1.0 + (lift.acceleration / physics.weight if is_rising else 0.0))
            world.step()
            if after % physics.look_every == 0:
                if self._has_lost(*start):
                    return 0
                now = world.look()
                resting = resting + 1 if world.rests(before, now) and not is_rising else 0
                before = now
                if self._ends_early(resting):
                    return 1
        return int(not world.is_on_table())

    def _ends_early(self, resting: int) -> bool:
        """Return whether the object has been at rest for enough looks, and is off the table."""
        return resting >= RESTING_LOOKS and not self.world.is_on_table()


def angle_between(one: Sequence[float], other: Sequence[float]) -> float:
    """The angle between two rotations as quaternions [rad]."""
    return 2 * acos(min(1.0, abs(running_sum(a * b for a, b in zip(one, other, strict=True)))))
