"""One scene in Bullet, which forgets everything between two evaluations.

Hand and object are loaded into Bullet out of a folder that is gone afterwards.
"""

import math
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qdgrasp_assets.geometry.rotation import Floats, conjugate, multiply, rotate
from qdgrasp_assets.scene import Joint, Scene, SceneGripper, SceneObject
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.rows import NO_SYNERGY
from qdgrasp_worker.bullet import BREAKING_THRESHOLD, STILL, UPRIGHT, Bullet, Contact, Motor, Vector
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.evaluation_protocols import CLOSING_STEPS, Shake, TrialSetup
from qdgrasp_worker.filters.contact_filter import SweptBox
from qdgrasp_worker.hand_geometry import free_posture

HAND_GROUP, OBJECT_GROUP = (
    1,
    2,
)  # Collision groups: an object meets hands only, a hand itself if it is asked to
OBJECT_URDF = """<robot name="object"><link name="object">
<inertial><mass value="{mass!r}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<collision><origin xyz="1e-9 0 0"/><geometry><mesh filename="parts.obj"/></geometry></collision>
</link></robot>
"""
"""Inertia and contacts as in the public code's runs, with the shape off the centre of mass.

Bullet takes the inertia from the collision shape, not from here. The nanometre keeps it from unwrapping
a shape that stands alone at no offset: a bare hull of the rubiks cube has 5 % less inertia, other margins,
and another answer to whether a finger touches it in 6 % of poses.
"""


class HandBody:
    """A hand on its carrier, with the indices that Bullet gave to its links and joints.

    An AssetError if Bullet cannot load it, or a joint or link that the scene names is not in the URDF.
    """

    def __init__(self, bullet: Bullet, gripper: SceneGripper, *, meets_itself: bool = False) -> None:
        self.body = load_body(bullet, gripper.urdf, gripper.meshes, fixed=True, meets_itself=meets_itself)
        bullet.collide(self.body, HAND_GROUP, OBJECT_GROUP | (HAND_GROUP if meets_itself else 0))
        links = bullet.links(self.body)
        moving = {link.joint: index for index, link in enumerate(links) if link.moves}
        self.carrier = indices_by_name("carrier joint", (joint.name for joint in gripper.carrier), moving)
        self.fingers = indices_by_name("joint", (joint.name for joint in gripper.joints), moving)
        named = {link.link: index for index, link in enumerate(links)}
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


def obj_vertices(obj: bytes) -> Iterator[list[float]]:
    """The vertices of an OBJ file."""
    for line in obj.decode().splitlines():
        if line.startswith("v "):
            yield [float(word) for word in line.split()[1:4]]


def load_body(
    bullet: Bullet, urdf: str, meshes: Mapping[str, bytes], *, fixed: bool, meets_itself: bool = False
) -> int:
    """Load a URDF with its meshes; its index in Bullet."""
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


def indices_by_name(kind: str, names: Iterable[str], indices: Mapping[str, int]) -> list[int]:
    """The index of each name."""
    chosen = list(names)
    for name in chosen:
        if name not in indices:
            raise AssetError(f"The hand has no {kind} '{name}'. It has: {', '.join(sorted(indices))}.")
    return [indices[name] for name in chosen]


class GraspContact(NamedTuple):
    """A contact of the hand with the object."""

    link: int
    """The hand's link, counted from 1 (`SceneGripper.links`)."""
    point: list[float]
    """x, y, z on the object [m], CoM frame."""
    normal: list[float]
    """Unit, into the object, CoM frame."""
    force: float
    """Along the normal [N]."""


HandFrame = tuple[Floats, Floats]
"""Position (3,) [m] and quaternion (4,) of a hand's base link."""
NEAR = 5e-4  # A contact without force counts up to this distance [m]; Bullet reports them from 1 to 2 mm on
AWAY_POSITION = [0.0, 0.0, 5.0]  # Where the hand is out of touch with everything [m]
FREE_POSTURES = 13  # Places of free joints at which the sweep is measured: every 15 deg of Barrett's spread


class GraspWorld(ABC):
    """A hand and an object in a physics engine, until `close`: what every episode asks of it."""

    opened: list[float]
    """The open posture [rad or m]."""
    finger_links: frozenset[int]
    """The links, as `contacts` names them, whose contact after closing makes a success."""
    approach_axis: Vector
    """Unit vector from the palm to the object, hand's base frame."""
    reach: float
    """Distance from which the hand comes along it [m]."""

    @abstractmethod
    def close(self) -> None:
        """Free the world; closing twice is allowed."""

    @abstractmethod
    def reset(self, trial: TrialSetup, posture: Sequence[float]) -> None:
        """Put hand and object in place, at rest; the finger joints are at `posture` [rad or m]."""

    @abstractmethod
    def place_hand(self, pose: HandPose) -> None:
        """Put the hand's base link at a pose, its joints as they are."""

    @abstractmethod
    def set_fingers(self, posture: Sequence[float]) -> None:
        """Put the finger joints at `posture` [rad or m], at rest."""

    @abstractmethod
    def close_fingers(self, synergy: int) -> None:
        """Begin to close a synergy's fingers; a ValueError for one that the hand does not have."""

    @abstractmethod
    def closing(self, posture: Sequence[float], synergy: int) -> list[list[float]]:
        """The finger joints [rad or m] while they close on nothing: before, and after each step."""

    @abstractmethod
    def step(self) -> None:
        """Move on."""

    @abstractmethod
    def is_touching(self) -> bool:
        """Return whether any link of the hand touches the object."""

    @abstractmethod
    def contacts(self) -> list[Contact]:
        """The contacts of the hand's links with the object."""

    @abstractmethod
    def contact_forces(self) -> list[GraspContact]:
        """The contacts of the hand with the object that bear a force, or are about to."""

    @abstractmethod
    def hand_pose(self) -> HandFrame:
        """The hand's base link in the object's frame, as both are now."""

    @abstractmethod
    def finger_positions(self) -> list[float]:
        """The positions of the finger joints, in the gripper's order [rad or m]."""


class World(GraspWorld):
    """A hand on its carrier and an object in Bullet; an AssetError if one cannot be loaded."""

    _breaking_threshold = BREAKING_THRESHOLD
    _links_meet = False

    def __init__(self, scene: Scene) -> None:
        self._bullet = Bullet()
        with ExitStack() as undo:
            undo.callback(self._bullet.close)
            self._hand = HandBody(self._bullet, scene.gripper, meets_itself=self._links_meet)
            self._target = ObjectBody(self._bullet, scene.object)
            self._prepare(scene.gripper)
            undo.pop_all()

    def close(self) -> None:
        """Leave Bullet and free the world; closing twice is allowed."""
        self._bullet.close()

    def reset(self, trial: TrialSetup, posture: Sequence[float]) -> None:
        """Put hand and object in place, at rest, with nothing left of what happened before.

        The finger joints are at `posture` [rad or m].

        In this order the same pose gives the same bits whatever came before: a collision detection with
        the hand away empties Bullet's cache of contacts, which would otherwise be carried over.
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

    def close_fingers(self, synergy: int) -> None:
        """Command a synergy's fingers to close, other driven ones to stay open, the carrier to hold.

        A ValueError for a synergy that the hand does not have.
        """
        if synergy not in self._closing:
            raise ValueError(f"synergy must be one of {sorted(self._closing)}, got {synergy}")
        for index, target, motor in self._closing[synergy]:
            self._bullet.drive(self._hand.body, index, target, motor)

    def shake_to(self, target: float, shake: Shake) -> None:
        """Command the carrier joint that `shake` moves to `target` [m or rad]."""
        index, joint = self._shaken[shake.joint]
        motor = Motor(joint.shake_force, joint.max_velocity, shake.position_gain, shake.velocity_gain)
        self._bullet.drive(self._hand.body, index, target, motor)

    def step(self) -> None:
        """Move on by 1/240 s."""
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

        Bullet finds contacts before it moves the bodies: they go with the pose that the object had then.
        """
        origin, turn = (np.array(part) for part in self._detected_at)
        back = conjugate(turn)
        return [
            GraspContact(
                self._hand.link_numbers[contact.link],
                rotate(back, np.array(contact.point) - origin).tolist(),
                rotate(back, np.array(contact.normal)).tolist(),
                contact.force,
            )
            for contact in self._bullet.contact_forces(self._hand.body, self._target.body)
            if contact.link in self._hand.link_numbers and (contact.force > 0 or contact.distance < NEAR)
        ]

    def has_lost_object(self, pose: HandPose) -> bool:
        """Return whether the hand at `pose`, while it closes, can touch the object no more."""
        body = self._target.body
        return self._sweep.is_left(pose, self._bullet.position(body), self._bullet.velocity(body))

    def finger_positions(self) -> list[float]:
        """The positions of the finger joints, in the gripper's order [rad or m]."""
        return self._bullet.joints(self._hand.body, self._hand.fingers)

    def _prepare(self, gripper: SceneGripper) -> None:
        self.finger_links = self._hand.finger_links
        self.opened = [joint.opened for joint in gripper.joints]
        self.approach_axis, self.reach = gripper.approach_axis, gripper.reach
        self._away = TrialSetup(HandPose(AWAY_POSITION, UPRIGHT, self.opened, NO_SYNERGY))
        self._joints = [*self._hand.carrier, *self._hand.others, *self._hand.fingers]
        self._at_zero = [0.0] * (len(self._hand.carrier) + len(self._hand.others))
        self._prepare_motion(gripper)

    def _prepare_motion(self, gripper: SceneGripper) -> None:
        """Make ready all that closing needs."""
        self._closing = {
            label: self._commands(gripper, joints) for label, joints in closing_joints(gripper).items()
        }
        carrier = zip(self._hand.carrier, gripper.carrier, strict=True)
        self._shaken = {joint.shake: (index, joint) for index, joint in carrier}
        self._sweep = self._measure_sweep(gripper)

    def closing(self, posture: Sequence[float], synergy: int) -> list[list[float]]:
        """The finger joints [rad or m] while they close on nothing: before, and after each step."""
        self.reset(self._away, posture)
        self.close_fingers(synergy)
        course = [self.finger_positions()]
        for _ in range(CLOSING_STEPS):
            self.step()
            course.append(self.finger_positions())
        return course

    def _measure_sweep(self, gripper: SceneGripper) -> SweptBox:
        """Close the hand far from the object, with its free joints all along their ranges."""
        boxes = []
        for i in range(FREE_POSTURES if gripper.free_joints else 1):
            self.reset(self._away, free_posture(gripper, i / (FREE_POSTURES - 1)))
            self.close_fingers(NO_SYNERGY)
            for _ in range(CLOSING_STEPS):
                boxes += [self._bullet.box(self._hand.body, link) for link in self._hand.shaped_links]
                self.step()
        return SweptBox.around(boxes, AWAY_POSITION, self._target.radius)

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


def closing_joints(gripper: SceneGripper) -> dict[int, Sequence[str]]:
    """The names of the joints that close, by the synergy's label."""
    everything = [joint.name for joint in gripper.joints if joint.driven]
    synergies = {label: synergy.joints for label, synergy in enumerate(gripper.synergies)}
    return {NO_SYNERGY: everything, **synergies}
