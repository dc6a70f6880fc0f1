"""Grippers: a URDF and a TOML file checked against each other, and the hand on its carrier.

The carrier is made of virtual joints between the world and the hand, which shakes move. `released` has the
six joints of the authors' URDFs; `paper` only the two that are used, so that the empty hand follows the
Panda's tabled motion at any weight (docs/grippers.md). `physical` shakes nothing: there the hand is fixed.
"""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from qdgrasp_assets.geometry.mesh import unreadable_as
from qdgrasp_assets.geometry.rotation import running_sum
from qdgrasp_assets.grippers.collision_shapes import largest_side
from qdgrasp_assets.grippers.gripper_file import (
    NOTHING_CLOSES,
    GripperFile,
    JointTable,
    gripper_faults,
    read_gripper_file,
    urdf_path,
)
from qdgrasp_assets.grippers.urdf import Urdf, add_inertial, add_joint, parse_robot, read_urdf
from qdgrasp_assets.grippers.urdf_checks import hand_faults
from qdgrasp_assets.scene import CarrierJoint, FreeJoint, Jaw, Joint, SceneGripper, unit_vector
from qdgrasp_protocol.errors import AssetError

HOLD_FORCE = 100.0  # N, Nm
SHAKE_FORCES = {"z": 20.0, "x": 100.0, "": 0.0}  # N, Nm; by the shake that moves the joint
MAX_VELOCITY = 10.0  # m/s, rad/s
CARRIED_MASS = 3.0  # kg: the links that the authors' Panda shakes along z besides the hand
PANDA_MASS = 0.7  # kg
GYRATION = 0.065  # m: of the Panda hand about x
PANDA_INERTIA = PANDA_MASS * GYRATION**2 + 2 * 0.01 * 0.0584**2  # kg m2


@dataclass(frozen=True)
class CarrierAxis:
    """One degree of freedom of a carrier."""

    name: str
    kind: str
    axis: str
    shake: str = ""
    """The shake that moves it: "z", "x", or empty."""


TRANSLATION_Z = CarrierAxis("translationZ", "prismatic", "0 0 1", "z")
ROTATION_X = CarrierAxis("rotationX", "revolute", "1 0 0", "x")
SIX_AXES = (
    CarrierAxis("translationX", "prismatic", "1 0 0"),
    CarrierAxis("translationY", "prismatic", "0 1 0"),
    TRANSLATION_Z,
    ROTATION_X,
    CarrierAxis("rotationY", "revolute", "0 1 0"),
    CarrierAxis("rotationZ", "revolute", "0 0 1"),
)
TWO_AXES = (TRANSLATION_Z, ROTATION_X)
FIXED_AXIS = CarrierAxis("carrierFixed", "fixed", "1 0 0")
CarriedHand = tuple[Urdf, tuple[CarrierJoint, ...]]
"""A hand on its carrier: the URDF's tree and the joints that the worker commands."""


def released_carrier(robot: Urdf, base: str, hold_force: float) -> CarriedHand:
    """Mount the hand on the six joints of the authors' code.

    The robot's own joints are taken where it has them, else the same are composed. Each intermediate
    link weighs 1 kg. All are held with `hold_force` (100; the authors' Shadow 1000); shakes act on
    translationZ with 20 N and on rotationX with 100 Nm.
    """
    own = all(robot.joint(axis.name) for axis in SIX_AXES)
    urdf = robot if own else _compose(robot.subtree(base), base, SIX_AXES, 1.0)
    return urdf, tuple(_carrier_command(axis, hold_force, 1.0) for axis in SIX_AXES)


def paper_carrier(robot: Urdf, base: str, hold_force: float) -> CarriedHand:
    """Mount the hand alone on z and x, behind 3 kg.

    Forces grow with what they move, mass along z and inertia about x, so that every empty hand moves like
    the Panda.
    """
    hand = robot.subtree(base)
    along = (CARRIED_MASS + hand.mass) / (CARRIED_MASS + PANDA_MASS)
    about = inertia_about_x(hand) / PANDA_INERTIA
    commands = (
        _carrier_command(TRANSLATION_Z, HOLD_FORCE * along, along),
        _carrier_command(ROTATION_X, HOLD_FORCE * about, about),
    )
    return _compose(hand, base, TWO_AXES, CARRIED_MASS), commands


def fixed_carrier(robot: Urdf, base: str, _: float) -> CarriedHand:
    """Fix the hand to a link that stands still and has its centre of mass in the hand's frame."""
    return _compose(robot.subtree(base), base, (FIXED_AXIS,), 1.0), ()


def inertia_about_x(hand: Urdf) -> float:
    """Return the hand's inertia about its base's x axis, joints at zero [kg m2].

    Each link counts by its mass, with the radius of gyration of the Panda's links.
    """
    frames = hand.forward({})
    places = {link: frames[link] @ np.append(place, 1.0) for link, (_, place) in hand.masses.items()}
    return running_sum(
        float(mass * (GYRATION**2 + places[link][1] ** 2 + places[link][2] ** 2))
        for link, (mass, _) in hand.masses.items()
    )


CARRIERS: dict[str, Callable[[Urdf, str, float], CarriedHand]] = {
    "paper": paper_carrier,
    "released": released_carrier,
    "robust": paper_carrier,
    "physical": fixed_carrier,
    "lift": fixed_carrier,
}
RATED = ("physical", "lift")
"""Evaluation protocols whose scenes hold the ratings of the real drives, and the disabled collisions."""


def _carrier_command(axis: CarrierAxis, hold_force: float, scale: float) -> CarrierJoint:
    return CarrierJoint(
        name=axis.name,
        force=round(hold_force, 6),
        max_velocity=MAX_VELOCITY,
        shake_force=round(SHAKE_FORCES[axis.shake] * scale, 6),
        shake=axis.shake,
    )


def _compose(hand: Urdf, base: str, axes: tuple[CarrierAxis, ...], link_mass: float) -> Urdf:
    """Put the hand behind a chain of `axes`; links before the hand weigh `link_mass` [kg] each."""
    links = [f"carrier_{number}" for number in range(len(axes))]
    robot = ET.Element("robot", name=hand.element.get("name", "hand"))
    for name in links:
        add_inertial(ET.SubElement(robot, "link", name=name), f"{link_mass:g}", "111")
    velocity = f"{MAX_VELOCITY:g}"
    for axis, ends in zip(axes, pairwise([*links, base]), strict=True):
        joint = add_joint(robot, axis.name, axis.kind, ends)
        if axis.kind != "fixed":
            ET.SubElement(joint, "axis", xyz=axis.axis)
            ET.SubElement(joint, "limit", effort="1000", lower="-100", upper="100", velocity=velocity)
    robot.extend(hand.element)
    return parse_robot(hand.path, robot, hand.meshes)


@dataclass(frozen=True)
class Gripper:
    """A gripper's files, read and checked against each other."""

    name: str
    source: str
    file: GripperFile
    robot: Urdf
    """The whole URDF; the hand is its sub-tree from `base_link`."""

    def check_hand(self) -> None:
        """Check that a joint closes, and the hand's joints, masses and meshes; `AssetError`."""
        if not any(each.closes for each in self.file.joints.values()):
            raise AssetError(f"The gripper '{self.name}': {NOTHING_CLOSES}.")
        if found := hand_faults(self.robot.subtree(self.file.base_link)):
            raise AssetError(f"The URDF '{self.robot.path}' cannot be used as it is: {'; and '.join(found)}.")

    def on_carrier(self, protocol: str) -> SceneGripper:
        """Mount the hand for a protocol; `AssetError` if a mesh is missing, empty or unreadable."""
        file, is_rated = self.file, protocol in RATED
        urdf, carrier = CARRIERS[protocol](self.robot, file.base_link, file.carrier_hold_force)
        element, meshes = urdf.bundled()
        hand = parse_robot(self.robot.path, element).subtree(file.base_link)
        with unreadable_as("The URDF '{}' has a collision shape that cannot be read: {}.", self.robot.path):
            extent = round(largest_side(hand, meshes), 6)
        return SceneGripper(
            name=self.name,
            source=self.source,
            licence=file.licence,
            urdf=ET.tostring(element, encoding="unicode"),
            meshes=meshes,
            base_link=file.base_link,
            carrier=carrier,
            joints=tuple(self._joint(name, table, is_rated) for name, table in file.joints.items()),
            finger_links=file.finger_links,
            synergies=file.synergies,
            free_joints=tuple(
                FreeJoint(name=name, low=each.low, high=each.high) for name, each in file.free_joints.items()
            ),
            approach_axis=unit_vector(file.approach_axis),
            palm_offset=file.palm_offset,
            standoff=file.standoff,
            jaw=file.jaw and Jaw(axis=unit_vector(file.jaw.axis), opening=file.jaw.opening),
            extent=extent,
            links=hand.links,
            disabled_collisions=file.disabled_collisions if is_rated else (),
        )

    def _joint(self, name: str, table: JointTable, is_rated: bool) -> Joint:
        joint = self.robot.joint(name)
        assert joint is not None  # noqa: S101  # `read_gripper` has checked it
        return Joint(
            name=name,
            opened=table.open,
            closed=table.open if table.closed is None else table.closed,
            effort=joint.effort if table.effort is None else table.effort,
            velocity=joint.velocity if table.velocity is None else table.velocity,
            driven=table.driven,
            rated_effort=(table.rated_effort or 0.0) if is_rated else 0.0,
            rated_velocity=(table.rated_velocity or 0.0) if is_rated else 0.0,
        )


def read_gripper(path: Path, name: str, source: str) -> Gripper:
    """Read a gripper's TOML and the URDF that it names.

    Raises `AssetError` if a file is missing or cannot be read, a value is impossible, or the two do not fit
    each other.
    """
    file = read_gripper_file(path)
    urdf = urdf_path(path, file)
    robot = read_urdf(urdf)
    for fault in gripper_faults(file, robot):
        raise AssetError(f"The gripper '{path}': {fault}.")
    return Gripper(name, source, file, robot)
