"""Worlds of the protocols in Bullet, without state between two evaluations.

Hand and object are loaded into Bullet from a temporary folder.
"""

import math
import tempfile
import xml.etree.ElementTree as ET
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from math import dist
from pathlib import Path

import numpy as np

from qdgrasp_assets.geometry.rotation import conjugate, facing, multiply, rotate
from qdgrasp_assets.grippers.hand_geometry import free_posture, neighbours
from qdgrasp_assets.grippers.urdf import Urdf, parse_robot
from qdgrasp_assets.scene import Joint, RestingPose, Scene, SceneGripper, SceneObject, Vector
from qdgrasp_protocol.errors import AssetError
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.engines.bullet import BASE, BREAKING_THRESHOLD, Bullet, BulletLink, Motor
from qdgrasp_worker.evaluation_protocols import Physics, Shake, TrialSetup
from qdgrasp_worker.filters.contact_filter import Box
from qdgrasp_worker.finger_drive import FingerControl, FingerDrive
from qdgrasp_worker.physical_episode import TABLE_HALF, PhysicalWorld, table_middle
from qdgrasp_worker.world import (
    AWAY_POSITION,
    FREE_POSTURES,
    HAND_FRICTION,
    NEAR,
    STILL,
    UPRIGHT,
    Contact,
    GraspContact,
    GraspWorld,
    HandFrame,
    Quaternion,
    ShakenWorld,
    Touch,
    WorldState,
    indices_by_name,
    seen_from,
)

HAND_GROUP, OBJECT_GROUP, TABLE_GROUP = 1, 2, 4
"""Collision groups: an object meets hands and a table only; a hand meets itself on request."""
TABLE_AWAY = [0.0, 0.0, -20.0]  # Its place when unused, away from all bodies [m]
TABLE_URDF = """<robot name="table"><link name="table">
<inertial><mass value="0"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<collision><geometry><box size="{sides}"/></geometry></collision>
</link></robot>
"""
OBJECT_URDF = """<robot name="object"><link name="object">
<inertial><mass value="{mass!r}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<collision><origin xyz="1e-9 0 0"/><geometry><mesh filename="parts.obj"/></geometry></collision>
</link></robot>
"""
"""Inertia and contacts as in the public code's runs, with the shape off the centre of mass.

Bullet takes the inertia from the collision shape, not from here. The offset of a nanometre keeps Bullet from
taking a single shape out of its compound: a bare hull of the rubiks cube has 5 % less inertia, other margins,
and other finger contacts in 6 % of poses.
"""


class HandBody:
    """A hand on its carrier, with Bullet's indices of its links and joints.

    An AssetError if Bullet cannot load it, or a joint or link that the scene names is not in the URDF.
    """

    def __init__(self, bullet: Bullet, gripper: SceneGripper, *, meets_itself: bool = False) -> None:
        self.body = load_body(bullet, gripper.urdf, gripper.meshes, fixed=True, meets_itself=meets_itself)
        bullet.collide(self.body, HAND_GROUP, OBJECT_GROUP | (HAND_GROUP if meets_itself else 0))
        links = bullet.links(self.body)
        moving = {link.joint: index for index, link in enumerate(links) if link.moves}
        self.joint_names = {index: name for name, index in moving.items()}
        self.carrier = indices_by_name("carrier joint", (joint.name for joint in gripper.carrier), moving)
        self.fingers = indices_by_name("joint", (joint.name for joint in gripper.joints), moving)
        named = {link.link: index for index, link in enumerate(links)}
        self.link_names = {BASE: bullet.root_link(self.body)} | {index: name for name, index in named.items()}
        self.finger_links = frozenset(indices_by_name("finger link", gripper.finger_links, named))
        self.base_link = named[gripper.base_link]
        self.link_numbers = {named[name]: number for number, name in enumerate(gripper.links, start=1)}
        """The number of each link in rows, by its index."""
        self.shaped_links = bullet.shaped_links(self.body)
        self.others = sorted(set(moving.values()) - {*self.carrier, *self.fingers})


class ObjectBody:
    """An object, with its root link at its centre of mass; an AssetError if it cannot be loaded."""

    def __init__(self, bullet: Bullet, target: SceneObject) -> None:
        urdf = OBJECT_URDF.format(mass=target.mass)
        self.body = load_body(bullet, urdf, {"parts.obj": target.collision}, fixed=False)
        bullet.collide(self.body, OBJECT_GROUP, HAND_GROUP)
        self.lateral_friction = target.lateral_friction
        self.frictions = target.rolling_friction, target.spinning_friction
        """Its own coefficients of rolling and spinning friction."""
        self.radius = max(math.hypot(*vertex) for vertex in obj_vertices(target.collision))
        """Largest distance of a vertex from the centre of mass [m]."""


class TableBody:
    """A table on which the object rests where it is placed; it stands still."""

    def __init__(self, bullet: Bullet, pose: RestingPose) -> None:
        self._bullet = bullet
        sides = " ".join(str(2.0 * half) for half in TABLE_HALF)
        self.body = load_body(bullet, TABLE_URDF.format(sides=sides), {}, fixed=True)
        bullet.collide(self.body, TABLE_GROUP, HAND_GROUP | OBJECT_GROUP)
        bullet.set_friction(self.body, HAND_FRICTION, 0.0, 0.0)
        self._pose, self._turn = pose, facing(pose.up).tolist()

    def put_away(self) -> None:
        """Move it away from all bodies."""
        self._bullet.place(self.body, TABLE_AWAY, UPRIGHT)

    def put_below(self, way: float) -> None:
        """Put it `way` [m] below the place where the object rests on it."""
        self._bullet.place(self.body, table_middle(self._pose, way), self._turn)


def obj_vertices(obj: bytes) -> Iterator[list[float]]:
    """The vertices of an OBJ file."""
    for line in obj.decode().splitlines():
        if line.startswith("v "):
            yield [float(word) for word in line.split()[1:4]]


def load_body(
    bullet: Bullet, urdf: str, meshes: Mapping[str, bytes], *, fixed: bool, meets_itself: bool = False
) -> int:
    """Load a URDF with its meshes; return its index in Bullet."""
    with tempfile.TemporaryDirectory(prefix="qdgrasp-") as name:
        folder = Path(name).resolve()
        for mesh, content in meshes.items():
            path = (folder / mesh).resolve()
            if folder not in path.parents:
                raise AssetError(f"A scene's meshes lie in its own folder, '{mesh}' does not.")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        file = folder / "body.urdf"
        file.write_text(urdf, encoding="utf-8")
        return bullet.load(file, fixed=fixed, meets_itself=meets_itself)


class BulletWorld(GraspWorld):
    """A hand on its carrier and an object in Bullet; an AssetError if one cannot be loaded."""

    _breaking_threshold = BREAKING_THRESHOLD
    _links_meet = False

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene.gripper)
        self._bullet = Bullet()
        with ExitStack() as undo:
            undo.callback(self._bullet.close)
            hand = self._hand = HandBody(self._bullet, scene.gripper, meets_itself=self._links_meet)
            self._target = ObjectBody(self._bullet, scene.object)
            self.finger_links = hand.finger_links
            self._joints = [*hand.carrier, *hand.others, *hand.fingers]
            self._at_zero = [0.0] * (len(hand.carrier) + len(hand.others))
            self._prepare(scene.gripper)
            undo.pop_all()

    @abstractmethod
    def _prepare(self, gripper: SceneGripper) -> None:
        """Prepare the data that closing needs."""

    def close(self) -> None:
        """Leave Bullet and free the world; closing twice is allowed."""
        self._bullet.close()

    def reset(self, trial: TrialSetup, posture: Sequence[float]) -> None:
        """Put hand and object in place, at rest, without any state of earlier evaluations.

        The finger joints are at `posture` [rad or m].

        In this order a pose gives the same bits after any other poses: a collision detection with the
        hand away empties Bullet's cache of contacts, which would otherwise be carried over.
        """
        bullet, hand, target, pose = self._bullet, self._hand, self._target, trial.pose
        frictions = trial.frictions or target.frictions
        bullet.set_breaking_threshold(self._breaking_threshold)
        bullet.place(hand.body, AWAY_POSITION, UPRIGHT)
        bullet.set_joints(hand.body, self._joints, [*self._at_zero, *posture])
        bullet.place(target.body, STILL, UPRIGHT)
        bullet.halt(target.body)
        bullet.set_friction(target.body, trial.grip * target.lateral_friction, *frictions)
        bullet.detect()
        self.place_hand(pose)
        self._detected_at = bullet.pose(target.body)

    def place_hand(self, pose: HandPose) -> None:
        """Put the hand's base link at a pose, its joints as they are."""
        self._bullet.place(self._hand.body, pose.position, pose.quaternion)
        self._bullet.detect()

    def set_fingers(self, posture: Sequence[float]) -> None:
        """Put the finger joints at `posture` [rad or m], at rest."""
        self._bullet.set_joints(self._hand.body, self._hand.fingers, posture)

    def step(self) -> None:
        """Simulate one step."""
        self._detected_at = self._bullet.pose(self._target.body)
        self._bullet.step()

    def is_touching(self) -> bool:
        """Return whether any link of the hand touches the object."""
        return self._bullet.touching(self._hand.body, self._target.body)

    def contacts(self) -> list[Contact]:
        """The contacts of the hand's links with the object."""
        return self._bullet.contacts(self._hand.body, self._target.body)

    def hand_pose(self) -> HandFrame:
        """The hand's base link in the object's frame, as both are now."""
        hand = self._bullet.link_pose(self._hand.body, self._hand.base_link)
        position, quaternion = (np.array(part) for part in hand)
        origin, turn = (np.array(part) for part in self._bullet.pose(self._target.body))
        back = conjugate(turn)
        return rotate(back, position - origin), multiply(back, quaternion)

    def contact_forces(self) -> list[GraspContact]:
        """The contacts of the hand with the object that bear a force, or are about to.

        Bullet finds contacts before it moves the bodies: they belong to the pose that the object had then.
        """
        numbers = self._hand.link_numbers
        found = [
            (numbers[contact.link], contact.point, contact.normal, contact.force)
            for contact in self._bullet.contact_forces(self._hand.body, self._target.body)
            if contact.link in numbers and (contact.force > 0 or contact.distance < NEAR)
        ]
        position, quaternion = self._detected_at
        return seen_from(np.array(position), np.array(quaternion), found)

    def finger_positions(self) -> list[float]:
        """The positions of the finger joints, in the gripper's order [rad or m]."""
        return self._bullet.joints(self._hand.body, self._hand.fingers)

    def state(self) -> WorldState:
        """The present places of all that can move, and the contacts."""
        bullet, hand, target = self._bullet, self._hand, self._target.body
        positions = bullet.joints(hand.body, self._joints)
        return WorldState(
            bullet.pose(hand.body),
            {hand.joint_names[joint]: place for joint, place in zip(self._joints, positions, strict=True)},
            bullet.pose(target),
            [
                Touch(hand.link_names[contact.link], contact.point, contact.normal, contact.distance)
                for contact in bullet.contact_forces(hand.body, target)
            ],
        )


class BulletShakenWorld(BulletWorld, ShakenWorld):
    """A world in Bullet whose joints have Bullet's own motors."""

    def _prepare(self, gripper: SceneGripper) -> None:
        self._closing = {label: self._commands(gripper, joints) for label, joints in self._names.items()}
        carrier = zip(self._hand.carrier, gripper.carrier, strict=True)
        self._shaken = {joint.shake: (index, joint) for index, joint in carrier}
        self._sweep = self.measure_sweep(gripper, AWAY_POSITION, self._target.radius)

    def close_fingers(self, synergy: int) -> None:
        """Command a synergy's fingers to close, other driven ones to stay open, the carrier to hold.

        A ValueError for a synergy that the hand does not have.
        """
        self.closing_joints(synergy)
        for index, target, motor in self._closing[synergy]:
            self._bullet.drive(self._hand.body, index, target, motor)

    def shake_to(self, target: float, shake: Shake) -> None:
        """Command the carrier joint that `shake` moves to `target` [m or rad]."""
        index, joint = self._shaken[shake.joint]
        motor = Motor(joint.shake_force, joint.max_velocity, shake.position_gain, shake.velocity_gain)
        self._bullet.drive(self._hand.body, index, target, motor)

    def has_lost_object(self, pose: HandPose) -> bool:
        """Return whether the closing hand at `pose` can no longer touch the object."""
        body = self._target.body
        return self._sweep.is_left(pose, self._bullet.position(body), self._bullet.velocity(body))

    def link_boxes(self) -> list[Box]:
        """The axis-aligned boxes around the collision shapes of the hand's links [m]."""
        return [self._bullet.box(self._hand.body, link) for link in self._hand.shaped_links]

    def _commands(self, gripper: SceneGripper, closing: Sequence[str]) -> list[tuple[int, float, Motor]]:
        """The motor commands when the joints `closing` close; undriven ones keep Bullet's own motor."""
        held = [
            (index, 0.0, Motor(joint.force, joint.max_velocity))
            for index, joint in zip(self._hand.carrier, gripper.carrier, strict=True)
        ]
        driven = [
            (index, joint.closed if joint.name in closing else joint.opened, finger_motor(joint))
            for index, joint in zip(self._hand.fingers, gripper.joints, strict=True)
            if joint.driven
        ]
        return held + driven


def finger_motor(joint: Joint) -> Motor:
    """The motor of a finger joint."""
    return Motor(joint.effort, joint.velocity)


class BulletPhysicalWorld(BulletWorld, PhysicalWorld):
    """A world of `physical` in Bullet."""

    _links_meet = True

    def __init__(self, scene: Scene, physics: Physics, table: RestingPose | None = None) -> None:
        self.physics, self.table = physics, table
        self._up = table.up if table else STILL
        self._breaking_threshold = physics.breaking_threshold
        super().__init__(scene)

    def _prepare(self, gripper: SceneGripper) -> None:
        bullet, hand, target = self._bullet, self._hand, self._target
        bullet.set_breaking_threshold(self._breaking_threshold)  # a pair keeps its first threshold
        iterations = self.physics.jaw_iterations if gripper.jaw else self.physics.iterations
        bullet.set_stepping(self.physics.time_step, iterations)
        bullet.set_contact_recovery(self.physics.recovery)
        target.lateral_friction /= HAND_FRICTION
        target.frictions = self.physics.rolling / HAND_FRICTION, self.physics.spinning / HAND_FRICTION
        links = bullet.links(hand.body)
        for link in range(BASE, len(links)):
            bullet.set_friction(hand.body, HAND_FRICTION, 0.0, 0.0, link)
        self._mass, self._moments = bullet.inertia(target.body)
        robot = parse_robot(Path(), ET.fromstring(gripper.urdf))  # noqa: S314  # the scene's own
        endless = {joint.name for joint in robot.joints if joint.kind == "continuous"}  # 0 to -1 in Bullet
        self._let_pass(gripper, robot, links)
        self._place_away(gripper, self.opened)
        drives = [
            FingerDrive.of(
                joint,
                reach_of(bullet, hand, index, links),
                slides=links[index].slides,
                limits=(0.0, 0.0) if joint.name in endless else (links[index].lower, links[index].upper),
                in_jaw=gripper.jaw is not None,
                haste=self.physics.haste,
            )
            for index, joint in zip(hand.fingers, gripper.joints, strict=True)
        ]
        for index, drive in zip(hand.fingers, drives, strict=True):
            self._add_inertia(index, drive.inertia, slides=links[index].slides)
        self._table = None if self.table is None else self._add_table(self.table)
        bullet.switch_motors_off(hand.body, hand.fingers)
        self._control = FingerControl(drives, is_coupled=gripper.jaw is not None)

    def _let_pass(self, gripper: SceneGripper, robot: Urdf, links: Sequence[BulletLink]) -> None:
        """Let pairs of links pass through each other: neighbours, disabled, or touching when open."""
        bullet, body = self._bullet, self._hand.body
        named = {link.link: index for index, link in enumerate(links)}
        passing = neighbours(robot).union(gripper.disabled_collisions)
        pairs = {(named.get(one, BASE), named.get(other, BASE)) for one, other in passing}
        for i in range(FREE_POSTURES if gripper.free_joints else 1):
            self._place_away(gripper, free_posture(gripper, i / (FREE_POSTURES - 1)))
            pairs |= bullet.touching_links(body)
        for one, other in sorted(pairs):
            bullet.pass_through(body, one, other)

    def _add_table(self, pose: RestingPose) -> TableBody:
        """Add a table that hand and object meet."""
        self._bullet.collide(self._hand.body, HAND_GROUP, OBJECT_GROUP | HAND_GROUP | TABLE_GROUP)
        self._bullet.collide(self._target.body, OBJECT_GROUP, HAND_GROUP | TABLE_GROUP)
        return TableBody(self._bullet, pose)

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
        """Put hand and object in place as `BulletWorld.reset` does; the object is free and undamped."""
        self._bullet.set_damping(self._target.body, 0.0)
        self._bullet.set_inertia(self._target.body, self._mass, self._moments)
        if self._table:
            self._table.put_away()
        super().reset(trial, posture)
        self.lower_table(0.0)
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
        """Release the object, damped; the targets of a jaw move on, others stay."""
        self._bullet.set_inertia(self._target.body, self._mass, self._moments)
        self._bullet.set_damping(self._target.body, self.physics.damping)
        if not self._control.is_coupled:
            self._control.stop()

    def _let_stay(self) -> None:
        """Stop all targets, and remove the damping of the object."""
        self._bullet.set_damping(self._target.body, 0.0)
        self._control.stop()

    def step(self) -> None:
        """Simulate one step, with the fingers' torques."""
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

    def weigh(self, factor: float) -> None:
        """Pull the object towards the table with `factor` times its weight, during the next step."""
        force, target = -factor * self._mass * self.physics.weight, self._target.body
        self._bullet.push(target, [force * axis for axis in self._up], self._bullet.position(target))

    def lower_table(self, way: float) -> None:
        """Put the table, if there is one, `way` [m] below the place where the object rests on it."""
        if self._table:
            self._table.put_below(way)

    def is_on_table(self) -> bool:
        """Return whether the object touches the table."""
        contacts = self._bullet.contacts(self._table.body, self._target.body) if self._table else []
        return any(contact.distance < NEAR for contact in contacts)

    def object_pose(self) -> tuple[Vector, Quaternion]:
        """The object's position and quaternion; the hand does not move."""
        return self._bullet.pose(self._target.body)


def reach_of(bullet: Bullet, hand: HandBody, joint: int, links: Sequence[BulletLink]) -> float:
    """Distance from a joint to the farthest box corner of the links that it moves [m]."""
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
