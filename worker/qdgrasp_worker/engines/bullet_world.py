"""Worlds of the protocols in Bullet, without state between two evaluations.

Contacts are those of the last collision detection.
"""

from collections.abc import Sequence
from contextlib import ExitStack
from itertools import product
from math import dist

import numpy as np

from qdgrasp_assets.geometry.rotation import facing
from qdgrasp_assets.grippers.hand_geometry import neighbours
from qdgrasp_assets.grippers.hand_model import couplings, followers
from qdgrasp_assets.grippers.urdf import Urdf, scene_robot
from qdgrasp_assets.scene import RestingPose, Scene, SceneGripper, Vector
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.engines.bullet import (
    BASE,
    BREAKING_THRESHOLD,
    HAND_GROUP,
    OBJECT_GROUP,
    TABLE_AWAY,
    TABLE_GROUP,
    Bullet,
    HandBody,
    ObjectBody,
    load_fixed,
)
from qdgrasp_worker.evaluation_protocols import Physics, TrialSetup
from qdgrasp_worker.physical_episode import (
    NO_TABLE_UP,
    FingerControl,
    PhysicalWorld,
    finger_drives,
    table_middle,
)
from qdgrasp_worker.world import (
    AWAY_POSITION,
    HAND_FRICTION,
    HOLD,
    NEAR,
    STILL,
    UPRIGHT,
    Contact,
    GraspContact,
    GraspWorld,
    Quaternion,
    ShakenWorld,
    Touch,
    WorldState,
    free_postures,
    seen_from,
)

GEAR = {"erp": 5.0, "maxForce": 1e4}  # All of an error in a step, as Bullet takes a fifth; force [N, Nm]


class BulletWorld(GraspWorld):
    """A hand on its carrier and an object in Bullet; an AssetError if one cannot be loaded."""

    _breaking_threshold = BREAKING_THRESHOLD
    _links_meet = False

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self._bullet = Bullet()
        with ExitStack() as undo:
            undo.callback(self._bullet.close)
            self._hand = HandBody(self._bullet, scene.gripper, meets_itself=self._links_meet)
            self._target = ObjectBody(self._bullet, scene.object)
            self._bodies = self._hand.body, self._target.body
            self.finger_links = self._hand.finger_links
            self._prepare(scene)
            undo.pop_all()

    def _prepare(self, scene: Scene) -> None:
        """Couple the joints of a hand with followers; a jaw of two slides is centred by its targets."""
        bullet, hand, robot = self._bullet, self._hand, scene_robot(scene.gripper)
        found = couplings(robot, scene.gripper) if followers(robot) else {}
        slides = {joint.name for joint in robot.joints if joint.kind == "prismatic"}
        if len(found) == 1 and found.keys() <= slides:
            found = {}
        self._led = frozenset(found)
        for name, led in found.items():  # it holds joint - ratio * leader at the offset
            ends = hand.body, hand.moving[name], hand.body, hand.moving[led.leader]
            gear = bullet.createConstraint(*ends, bullet.JOINT_GEAR, [1.0, 0.0, 0.0], STILL, STILL)
            bullet.changeConstraint(
                gear, gearRatio=-led.multiplier, relativePositionTarget=led.offset, **GEAR
            )

    def close(self) -> None:
        """Leave Bullet and free the world; closing twice is allowed."""
        self._bullet.close()

    def reset(self, trial: TrialSetup, posture: Sequence[float]) -> None:
        """Put hand and object in place, at rest, without any state of earlier evaluations.

        In this order a pose gives the same bits after any other poses: a collision detection with the
        hand away empties Bullet's cache of contacts, which would otherwise be carried over.
        """
        hand, target, self.trial = self._hand, self._target, trial
        self._posture = list(posture)
        self._bullet.setPhysicsEngineParameter(
            contactBreakingThreshold=self._breaking_threshold
        )  # process-wide
        hand.place(AWAY_POSITION, UPRIGHT)
        hand.set_joints(hand.joints, [*hand.at_zero, *posture])
        target.place(STILL, UPRIGHT)
        self._bullet.resetBaseVelocity(target.body, STILL, STILL)
        rolling, spinning = trial.frictions or target.frictions
        target.set_friction(trial.grip * target.lateral_friction, rolling, trial.torsion * spinning)
        self._bullet.performCollisionDetection()
        self.place_hand(trial.pose)
        self._detected_at = target.pose

    def place_hand(self, pose: HandPose) -> None:
        """Put the hand's base link at a pose, its joints as they are."""
        self._hand.place(pose.position, pose.quaternion)
        self._bullet.performCollisionDetection()

    def set_fingers(self, posture: Sequence[float]) -> None:
        """Put the finger joints at `posture` [rad or m], at rest."""
        self._posture = list(posture)
        self._hand.set_joints(self._hand.fingers, posture)

    def step(self) -> None:
        """Simulate one step."""
        self._detected_at = self._target.pose
        self._bullet.stepSimulation()
        self.steps += 1

    def contacts(self) -> list[Contact]:
        """The contacts of the hand's links with the object."""
        return [Contact(point[3], point[8]) for point in self._bullet.getContactPoints(*self._bodies)]

    def object_pose(self) -> tuple[Vector, Quaternion]:
        """The object's position [m] and quaternion."""
        return self._target.pose

    def base_pose(self) -> tuple[Vector, Quaternion]:
        """Position [m] and quaternion of the hand's base link."""
        state = self._bullet.getLinkState(self._hand.body, self._hand.base_link, computeForwardKinematics=1)
        return state[4], state[5]

    def contact_forces(self) -> list[GraspContact]:
        """The contacts of the hand with the object that bear a force, or are about to.

        Bullet finds contacts before it moves the bodies: they belong to the pose that the object had then.
        """
        numbers = self._hand.link_numbers
        found = [
            (numbers[link], point, normal, force)
            for link, (point, normal, distance), force in self._touches()
            if link in numbers and (force > 0 or distance < NEAR)
        ]
        position, quaternion = self._detected_at
        return seen_from(np.array(position), np.array(quaternion), found)

    def _touches(self) -> list[tuple[int, tuple[Vector, Vector, float], float]]:
        """Link, place and force [N] of each contact.

        A place is the point on the object [m], the normal into it, and the distance [m].
        """
        return [
            (found[3], (found[6], (-found[7][0], -found[7][1], -found[7][2]), found[8]), found[9])
            for found in self._bullet.getContactPoints(*self._bodies)
        ]

    def finger_positions(self) -> list[float]:
        """The positions of the finger joints, in the gripper's order [rad or m]."""
        return self._hand.positions(self._hand.fingers)

    def state(self) -> WorldState:
        """The present places of all that can move, and the contacts."""
        hand = self._hand
        names = [hand.joint_names[joint] for joint in hand.joints]
        touches = [Touch(hand.link_names[link], *where) for link, where, _ in self._touches()]
        joints = dict(zip(names, hand.positions(hand.joints), strict=True))
        return WorldState(hand.pose, joints, self._target.pose, touches)


class BulletShakenWorld(BulletWorld, ShakenWorld):
    """A world in Bullet whose joints have Bullet's own motors."""

    def drive(
        self, joint: str, target: float, force: float, velocity: float, gains: tuple[float, float] = HOLD
    ) -> None:
        """Command a joint to a place, with these limits; one that follows another has no motor."""
        self._bullet.setJointMotorControl2(
            self._hand.body,
            self._hand.moving[joint],
            self._bullet.POSITION_CONTROL,
            targetPosition=target,
            force=0.0 if joint in self._led else force,
            maxVelocity=velocity,
            positionGain=gains[0],
            velocityGain=gains[1],
        )


class BulletPhysicalWorld(BulletWorld, PhysicalWorld):
    """A world of `physical` in Bullet."""

    _links_meet = True

    def __init__(self, scene: Scene, physics: Physics, table: RestingPose | None = None) -> None:
        self.physics, self.table, self.step_seconds = physics, table, physics.time_step
        self._up = table.up if table else NO_TABLE_UP
        super().__init__(scene)

    def _prepare(self, scene: Scene) -> None:
        super()._prepare(scene)
        bullet, hand, target, physics = self._bullet, self._hand, self._target, self.physics
        gripper, parts = scene.gripper, scene.neighbours
        if not self._led:  # coupled fingers go through what they touch in points that do not last
            self._breaking_threshold = physics.breaking_threshold
        bullet.setPhysicsEngineParameter(
            contactBreakingThreshold=self._breaking_threshold,  # a pair keeps its first threshold
            fixedTimeStep=physics.time_step,
            numSolverIterations=physics.jaw_iterations if gripper.jaw else physics.iterations,
            contactERP=physics.recovery,
        )
        target.lateral_friction /= HAND_FRICTION
        target.frictions = physics.rolling / HAND_FRICTION, physics.spinning / HAND_FRICTION
        for number in range(BASE, len(hand.links)):
            hand.set_friction(HAND_FRICTION, 0.0, 0.0, number)
        self._mass, self._moments = target.inertia()
        robot = scene_robot(gripper)
        self._let_pass(gripper, robot)
        self._place_away(self.opened)
        by_name = {joint.name: joint for joint in robot.joints}
        joints = [by_name[joint.name] for joint in gripper.joints]
        reaches = [reach_of(bullet, hand, index) for index in hand.fingers]
        drives = finger_drives(gripper, joints, reaches, physics.haste)
        for index, joint, drive in zip(hand.fingers, joints, drives, strict=True):
            self._add_inertia(index, drive.inertia, slides=joint.kind == "prismatic")
        if self.table or parts:
            hand.collide(HAND_GROUP, OBJECT_GROUP | HAND_GROUP | TABLE_GROUP)
            target.collide(OBJECT_GROUP, HAND_GROUP | TABLE_GROUP)
        self._table = load_fixed(bullet) if self.table else None
        self._neighbours = load_fixed(bullet, parts) if parts else None
        still = [0.0] * len(hand.fingers)  # joints move freely, except for the torques of each step
        bullet.setJointMotorControlArray(hand.body, hand.fingers, bullet.VELOCITY_CONTROL, forces=still)
        self._control = FingerControl(drives, is_coupled=gripper.jaw is not None)

    def _let_pass(self, gripper: SceneGripper, robot: Urdf) -> None:
        """Let pairs of links pass through each other: neighbours, disabled, or touching when open."""
        bullet, body = self._bullet, self._hand.body
        named = {link: index for index, link in enumerate(self._hand.links)}
        passing = neighbours(robot).union(gripper.disabled_collisions)
        pairs = {(named.get(one, BASE), named.get(other, BASE)) for one, other in passing}
        for posture in free_postures(gripper):
            self._place_away(posture)
            pairs |= {(point[3], point[4]) for point in bullet.getContactPoints(body, body)}
        for one, other in sorted(pairs):
            bullet.setCollisionFilterPair(body, body, one, other, 0)

    def _place_away(self, posture: Sequence[float]) -> None:
        self._hand.place(AWAY_POSITION, UPRIGHT)
        self._hand.set_joints(self._hand.joints, [*self._hand.at_zero, *posture])
        self._bullet.performCollisionDetection()

    def _add_inertia(self, index: int, inertia: float, *, slides: bool) -> None:
        """Add the reflected inertia of a drive to the link that its joint moves."""
        mass, moments = self._hand.inertia(index)
        if slides:
            scale = 1 + inertia / mass
            mass, added = mass + inertia, [moment * scale for moment in moments]
        else:
            added = [moment + inertia for moment in moments]
        self._hand.set_inertia(mass, added, index)

    def reset(self, trial: TrialSetup, posture: Sequence[float]) -> None:
        """Put hand and object in place as `BulletWorld.reset` does; the object is free and undamped."""
        self._target.damp(0.0)
        self._target.set_inertia(self._mass, self._moments)
        for body in filter(None, (self._table, self._neighbours)):
            body.place(TABLE_AWAY, UPRIGHT)
        super().reset(trial, posture)
        self.lower_surroundings(0.0)
        self._axes = trial.pose.axes

    def close_fingers(self, synergy: int) -> None:
        """Fix the object and begin to close; a ValueError for a synergy that the hand does not have."""
        names = self.closing_joints(synergy)
        self._target.set_inertia(0.0, self._moments)
        self._control.start(self._posture, names, self.trial.preload)

    def release(self) -> None:
        """Release the object, damped; the targets of a jaw move on, others stay."""
        self._target.set_inertia(self._mass, self._moments)
        self._target.damp(self.physics.damping)
        if not self._control.is_coupled:
            self._control.stop()

    def disturb(self) -> None:
        """Stop all targets, and remove the damping of the object."""
        self._target.damp(0.0)
        self._control.stop()

    def step(self) -> None:
        """Simulate one step, with the fingers' torques."""
        bullet, hand = self._bullet, self._hand
        states = [state[:2] for state in bullet.getJointStates(hand.body, hand.fingers)]
        torques = self._control.torques(states, self.physics.time_step)
        bullet.setJointMotorControlArray(hand.body, hand.fingers, bullet.TORQUE_CONTROL, forces=torques)
        super().step()

    def push(self, direction: Vector) -> None:
        """Push the object with its weight, during the next step, along a direction in hand frame."""
        force = self._mass * self.physics.weight
        (a, b, c), (x, y, z) = self._axes, direction
        self._push([force * (x * a[i] + y * b[i] + z * c[i]) for i in range(3)])

    def weigh(self, factor: float) -> None:
        """Pull the object towards the table with `factor` times its weight, during the next step."""
        force = -factor * self._mass * self.physics.weight
        self._push([force * axis for axis in self._up])

    def _push(self, force: Sequence[float]) -> None:
        bullet, body = self._bullet, self._target.body
        bullet.applyExternalForce(body, BASE, force, self._target.pose[0], bullet.WORLD_FRAME)

    def lower_surroundings(self, way: float) -> None:
        """Put table and neighbours, where there are any, `way` [m] below their places at first."""
        if self._table and self.table:
            self._table.place(table_middle(self.table, way), facing(self.table.up).tolist())
        if self._neighbours:
            self._neighbours.place([-way * axis for axis in self._up], UPRIGHT)

    def is_on_table(self) -> bool:
        """Return whether the object touches the table."""
        if self._table is None:
            return False
        points = self._bullet.getContactPoints(self._table.body, self._target.body)
        return any(point[8] < NEAR for point in points)


def reach_of(bullet: Bullet, hand: HandBody, joint: int) -> float:
    """Distance from a joint to the farthest box corner of the links that it moves [m]."""
    place, moved = bullet.getLinkState(hand.body, joint)[4], {joint}
    for index in range(joint + 1, len(hand.links)):
        if hand.parents[index] in moved:
            moved.add(index)
    shaped = sorted(moved.intersection(hand.shaped_links))
    boxes = [zip(*bullet.getAABB(hand.body, link), strict=True) for link in shaped]
    return max((dist(place, corner) for box in boxes for corner in product(*box)), default=0.0)
