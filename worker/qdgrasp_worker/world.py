"""A world: a hand and an object in a physics engine, as an episode uses them.

`GraspWorld` is common to the protocols. `ShakenWorld` adds the carrier that shakes the hand (`paper`,
`released`, `robust`); `physical_episode.PhysicalWorld` adds drives and pushes. Worlds of each engine are in
`engines`; contacts are those of the last collision detection. Lengths are metres, quaternions xyzw.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from qdgrasp_assets.geometry.rotation import Floats, conjugate, multiply, rotate
from qdgrasp_assets.regions import allowed_points
from qdgrasp_assets.scene import BORDER, Scene, SceneGripper, Vector
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.rows import NO_SYNERGY
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.evaluation_protocols import CLOSING_STEPS, Shake, TrialSetup

Quaternion = tuple[float, float, float, float]
HandFrame = tuple[Floats, Floats]
"""Position (3,) [m] and quaternion (4,) of a hand's base link."""
STILL = [0.0, 0.0, 0.0]
UPRIGHT = [0.0, 0.0, 0.0, 1.0]
AWAY_POSITION = [0.0, 0.0, 5.0]  # Place of the hand away from all bodies [m]
HAND_FRICTION = 0.5  # Lateral friction of the hand's links, Bullet's own; it multiplies it with the object's
NEAR = 5e-4  # A contact without force counts up to this distance [m]; Bullet reports them from 1 to 2 mm on
HOLD = 0.1, 1.0  # Gains with which a joint is held and closed, Bullet's own
FREE_POSTURES = 13  # Places of free joints at which links are looked at: every 15 deg of Barrett's spread


class Contact(NamedTuple):
    """A point where two bodies touch, or are about to."""

    link: int
    """The first body's link."""
    distance: float
    """Distance of the bodies [m]; negative where they penetrate."""


class GraspContact(NamedTuple):
    """A contact of the hand with the object."""

    link: int
    """The hand's link, counted from 1 (`SceneGripper.links`)."""
    point: list[float]
    """x, y, z on the object [m], CoM frame."""
    normal: list[float]
    """Unit normal into the object, CoM frame."""
    force: float
    """Force along the normal [N]."""


class Touch(NamedTuple):
    """A point where hand and object touch, or are about to, in the world's frame."""

    link: str
    """The hand's link."""
    point: Sequence[float]
    """x, y, z on the object [m]."""
    normal: Sequence[float]
    """Unit normal into the object."""
    distance: float
    """Distance of the bodies [m]; negative where they penetrate."""


class WorldState(NamedTuple):
    """Places of all that can move, and contacts, in the world's frame: enough to draw them."""

    root: tuple[Sequence[float], Sequence[float]]
    """Position [m] and quaternion xyzw of the root link of the hand's URDF."""
    joints: dict[str, float]
    """Positions of all joints that move, by name [rad or m]."""
    object: tuple[Sequence[float], Sequence[float]]
    """Position [m] and quaternion xyzw of the object, by its centre of mass."""
    touches: list[Touch]
    """The contacts of the last collision detection."""


def seen_from(
    position: Floats, quaternion: Floats, found: Sequence[tuple[int, ArrayLike, ArrayLike, float]]
) -> list[GraspContact]:
    """Contacts in the frame of an object at `position` (3,) [m], turned by `quaternion` (4,).

    Each is given by its link's number, point [m] and normal in the world's frame, and force [N].
    """
    if not found:
        return []
    links, points, normals, forces = zip(*found, strict=True)
    seen = np.array([np.array(points) - position, normals])
    points, normals = rotate(conjugate(quaternion), seen).tolist()
    return list(map(GraspContact, links, points, normals, forces))


class ContactRegion:
    """The part of a scene's object that contacts may be on, by points sampled on its mesh."""

    def __init__(self, scene: Scene) -> None:
        points, allowed = allowed_points(scene)
        self._trees = KDTree(points[allowed]), KDTree(points[~allowed])

    def holds(self, contacts: Sequence[GraspContact]) -> bool:
        """Return whether all contacts are in the part, and off its border."""
        points = np.reshape([contact.point for contact in contacts], (-1, 3))
        inside, outside = (tree.query(points)[0] for tree in self._trees)
        # both squares hold that of a point's height above the surface, which cancels
        return bool(np.all(inside**2 + BORDER**2 <= outside**2))


class GraspWorld(ABC):
    """A hand and an object in a physics engine, until `close`, as every episode uses them."""

    sight = 0.0
    """Distance at which its engine detects contacts, if it is the same for all shapes [m]."""
    finger_links: frozenset[int]
    """The links, as `contacts` names them, whose contact after closing makes a success."""
    trial: TrialSetup
    """The trial that it was reset for last."""
    step_seconds = 1 / 240
    """The time that `step` simulates [s]."""
    steps = 0
    """Number of steps of physics that `step` has simulated."""

    def __init__(self, scene: Scene) -> None:
        self._gripper = gripper = scene.gripper
        self.allowed = ContactRegion(scene) if scene.regions else None
        """The part of the object that contacts may be on; None: all of it."""
        self.opened = [joint.opened for joint in gripper.joints]
        """The open posture [rad or m]."""
        self.approach_axis = gripper.approach_axis
        """Unit vector from the palm to the object, hand's base frame."""
        self.reach = gripper.reach
        """Distance from which the hand comes along that axis [m]."""
        self._away = TrialSetup(HandPose(AWAY_POSITION, UPRIGHT, self.opened, NO_SYNERGY))
        self._names = {label: list(synergy.joints) for label, synergy in enumerate(gripper.synergies)}
        self._names[NO_SYNERGY] = [joint.name for joint in gripper.joints if joint.driven]

    def closing_joints(self, synergy: int) -> list[str]:
        """The names of a synergy's joints; a ValueError for one that the hand does not have."""
        if synergy not in self._names:
            raise ValueError(f"synergy must be one of {sorted(self._names)}, got {synergy}")
        return self._names[synergy]

    @abstractmethod
    def close(self) -> None:
        """Free the world; closing twice is allowed."""

    @abstractmethod
    def reset(self, trial: TrialSetup, posture: Sequence[float]) -> None:
        """Put hand and object in place, at rest, without any state of earlier evaluations.

        The finger joints are at `posture` [rad or m].
        """

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
    def steps_of_closing(self, synergy: int) -> Iterator[int]:
        """Begin to close, and count the steps until the hand is closed."""

    def closing(self, posture: Sequence[float], synergy: int) -> list[list[float]]:
        """The finger joints [rad or m] while they close on nothing: before, and after each step."""
        self.reset(self._away, posture)
        course = [self.finger_positions()]
        for _ in self.steps_of_closing(synergy):
            self.step()
            course.append(self.finger_positions())
        return course

    @abstractmethod
    def step(self) -> None:
        """Simulate the next `step_seconds`."""

    def is_touching(self) -> bool:
        """Return whether any link of the hand touches the object."""
        return bool(self.contacts())

    @abstractmethod
    def contacts(self) -> list[Contact]:
        """The contacts of the hand's links with the object."""

    @abstractmethod
    def contact_forces(self) -> list[GraspContact]:
        """The contacts of the hand with the object that bear a force, or are about to."""

    @abstractmethod
    def object_pose(self) -> tuple[Vector, Quaternion]:
        """The object's position [m] and quaternion, world frame."""

    @abstractmethod
    def base_pose(self) -> tuple[Sequence[float], Sequence[float]]:
        """Position [m] and quaternion of the hand's base link, world frame."""

    def hand_pose(self) -> HandFrame:
        """The hand's base link in the object's frame, as both are now."""
        position, quaternion = (np.array(part) for part in self.base_pose())
        origin, turn = (np.array(part) for part in self.object_pose())
        back = conjugate(turn)
        return rotate(back, position - origin), multiply(back, quaternion)

    @abstractmethod
    def finger_positions(self) -> list[float]:
        """The positions of the finger joints, in the gripper's order [rad or m]."""

    @abstractmethod
    def state(self) -> WorldState:
        """The present places of all that can move, and the contacts."""


class ShakenWorld(GraspWorld):
    """A world whose hand is on a carrier that shakes it; a step is 1/240 s."""

    def close_fingers(self, synergy: int) -> None:
        """Command a synergy's fingers to close, other driven ones to stay open, the carrier to hold.

        A ValueError for a synergy that the hand does not have.
        """
        closing = self.closing_joints(synergy)
        for axis in self._gripper.carrier:
            self.drive(axis.name, 0.0, axis.force, axis.max_velocity)
        for joint in self._gripper.joints:
            if joint.driven:
                target = joint.closed if joint.name in closing else joint.opened
                self.drive(joint.name, target, joint.effort, joint.velocity)

    def shake_to(self, target: float, shake: Shake) -> None:
        """Command the carrier joint that `shake` moves to `target` [m or rad]."""
        axis = next(axis for axis in self._gripper.carrier if axis.shake == shake.joint)
        gains = shake.position_gain, shake.velocity_gain
        self.drive(axis.name, target, axis.shake_force, axis.max_velocity, gains)

    @abstractmethod
    def drive(
        self, joint: str, target: float, force: float, velocity: float, gains: tuple[float, float] = HOLD
    ) -> None:
        """Command a joint to a place, with these limits, from the next step on.

        `gains` are Bullet's kp and kd: the shares of the errors of place and velocity that a step corrects.
        """

    def steps_of_closing(self, synergy: int) -> Iterator[int]:
        """Begin to close, and count the steps of the protocols."""
        self.close_fingers(synergy)
        yield from range(CLOSING_STEPS)


def free_posture(gripper: SceneGripper, share: float) -> list[float]:
    """Return the open posture with all free joints at this share of their ranges."""
    places = {joint.name: joint.low + share * (joint.high - joint.low) for joint in gripper.free_joints}
    return [places.get(joint.name, joint.opened) for joint in gripper.joints]


def free_postures(gripper: SceneGripper) -> list[list[float]]:
    """Open postures with the free joints all along their ranges."""
    places = range(FREE_POSTURES if gripper.free_joints else 1)
    return [free_posture(gripper, i / (FREE_POSTURES - 1)) for i in places]


def indices_by_name(kind: str, names: Iterable[str], indices: Mapping[str, int]) -> list[int]:
    """The index of each name."""
    chosen = list(names)
    for name in chosen:
        if name not in indices:
            raise AssetError(f"The hand has no {kind} '{name}'. It has: {', '.join(sorted(indices))}.")
    return [indices[name] for name in chosen]
