"""The carrier: virtual joints between the world and the hand, which shakes move.

`released` has the six joints of the authors' URDFs; `paper` only the two that are used, so that the empty
hand follows the Panda's tabled motion whatever it weighs (docs/grippers.md).
"""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from qdgrasp_assets.scene import CarrierJoint
from qdgrasp_assets.urdf import Urdf, tree
from qdgrasp_protocol.errors import AssetError

HOLD_FORCE = 100.0  # N, Nm
SHAKE_FORCES = {"z": 20.0, "x": 100.0, "": 0.0}  # N, Nm; by the shake that moves the joint
MAX_VELOCITY = 10.0  # m/s, rad/s
CARRIED_MASS = 3.0  # kg: the links that the authors' Panda shakes along z besides the hand
PANDA_MASS = 0.7  # kg
GYRATION = 0.065  # m: of the Panda hand about x
PANDA_INERTIA = PANDA_MASS * GYRATION**2 + 2 * 0.01 * 0.0584**2  # kg m2


@dataclass(frozen=True)
class Axis:
    """One degree of freedom of a carrier."""

    name: str
    kind: str
    axis: str
    shake: str = ""
    """The shake that moves it: "z", "x", or empty."""


TRANSLATION_Z = Axis("translationZ", "prismatic", "0 0 1", "z")
ROTATION_X = Axis("rotationX", "revolute", "1 0 0", "x")
SIX = (
    Axis("translationX", "prismatic", "1 0 0"),
    Axis("translationY", "prismatic", "0 1 0"),
    TRANSLATION_Z,
    ROTATION_X,
    Axis("rotationY", "revolute", "0 1 0"),
    Axis("rotationZ", "revolute", "0 0 1"),
)
TWO = (TRANSLATION_Z, ROTATION_X)


@dataclass(frozen=True)
class Carried:
    """A hand on its carrier: the URDF's tree and the joints that the worker commands."""

    urdf: Urdf
    joints: tuple[CarrierJoint, ...]


def released_carrier(robot: Urdf, base: str, hold_force: float) -> Carried:
    """The six joints of the authors' code: the robot's own when it brings them, else the same composed.

    Each intermediate link weighs 1 kg. All are held with `hold_force` (100; the authors' Shadow 1000);
    shakes act on translationZ with 20 N and on rotationX with 100 Nm.
    """
    own = all(robot.joint(axis.name) for axis in SIX)
    urdf = robot if own else _compose(robot.subtree(base), base, SIX, 1.0)
    return Carried(urdf, tuple(_command(axis, hold_force, 1.0) for axis in SIX))


def paper_carrier(robot: Urdf, base: str, hold_force: float) -> Carried:
    """The hand alone on z and x, behind 3 kg.

    Forces grow with what they move, mass along z and inertia about x, so that every empty hand moves like
    the Panda.
    """
    hand = robot.subtree(base)
    scales = {
        "z": (CARRIED_MASS + hand.mass) / (CARRIED_MASS + PANDA_MASS),
        "x": inertia_about_x(hand) / PANDA_INERTIA,
    }
    urdf = _compose(hand, base, TWO, CARRIED_MASS)
    return Carried(
        urdf, tuple(_command(axis, HOLD_FORCE * scales[axis.shake], scales[axis.shake]) for axis in TWO)
    )


def inertia_about_x(hand: Urdf) -> float:
    """Of the hand about its base's x axis, joints at zero [kg m2]; links as the Panda's, by their mass."""
    frames = hand.forward({})
    places = {link: frames[link] @ np.append(place, 1.0) for link, (_, place) in hand.masses.items()}
    return sum(
        float(mass * (GYRATION**2 + places[link][1] ** 2 + places[link][2] ** 2))
        for link, (mass, _) in hand.masses.items()
    )


CARRIERS: dict[str, Callable[[Urdf, str, float], Carried]] = {
    "paper": paper_carrier,
    "released": released_carrier,
    "robust": paper_carrier,
}
"""How an evaluation protocol carries the hand."""


def _command(axis: Axis, hold_force: float, scale: float) -> CarrierJoint:
    return CarrierJoint(
        name=axis.name,
        force=round(hold_force, 6),
        max_velocity=MAX_VELOCITY,
        shake_force=round(SHAKE_FORCES[axis.shake] * scale, 6),
        shake=axis.shake,
    )


def _compose(hand: Urdf, base: str, axes: tuple[Axis, ...], link_mass: float) -> Urdf:
    """The hand behind a chain of `axes`, whose links before the hand weigh `link_mass` [kg] each."""
    taken = {*hand.links, *(joint.name for joint in hand.joints)}
    links = [f"carrier_{number}" for number in range(len(axes))]
    if clash := taken.intersection([*links, *(axis.name for axis in axes)]):
        raise AssetError(
            f"The URDF '{hand.path}' uses the name '{min(clash)}', which the carrier needs; rename it."
        )
    robot = ET.Element("robot", name=hand.element.get("name", "hand"))
    for link in links:
        robot.append(_link(link, link_mass))
    for axis, parent, child in zip(axes, links, [*links[1:], base], strict=True):
        robot.append(_joint(axis, parent, child))
    robot.extend(hand.element)
    return tree(hand.path, robot)


def _link(name: str, mass: float) -> ET.Element:
    link = ET.Element("link", name=name)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz="0 0 0", rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=f"{mass:g}")
    ET.SubElement(inertial, "inertia", ixx="1", ixy="0", ixz="0", iyy="1", iyz="0", izz="1")
    return link


def _joint(axis: Axis, parent: str, child: str) -> ET.Element:
    joint = ET.Element("joint", name=axis.name, type=axis.kind)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", xyz="0 0 0", rpy="0 0 0")
    ET.SubElement(joint, "axis", xyz=axis.axis)
    ET.SubElement(joint, "limit", effort="1000", lower="-100", upper="100", velocity=f"{MAX_VELOCITY:g}")
    return joint
