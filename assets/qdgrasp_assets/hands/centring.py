"""A base link in the middle: where the fingers close beside the line on which the palm looks at objects."""

import copy
import xml.etree.ElementTree as ET
from dataclasses import dataclass

from qdgrasp_assets.hands import palm
from qdgrasp_assets.hands.body import read_body
from qdgrasp_assets.hands.closing import find_closing
from qdgrasp_assets.hands.postures import BESIDE
from qdgrasp_assets.hands.weighing import FRAME_MASS
from qdgrasp_assets.urdf import Urdf, tree

CENTRE = "_centre"
"""The end of the name of such a base link."""


@dataclass(frozen=True)
class Centred:
    """A hand with a base link in the middle."""

    robot: Urdf
    base: str
    change: str
    """What was done, in words."""


def centred(robot: Urdf, base: str) -> Centred | None:
    """The hand with another base link before `base`; None where the fingers close near enough to its line.

    Raises
    ------
    AssetError
        A mesh is missing or cannot be read.
    """
    body = read_body(robot, base)
    closing = find_closing(body)
    if not closing.fingers:
        return None
    axis, centre = palm.approach(closing), palm.grasp_centre(closing)
    if palm.aside(closing, axis) <= BESIDE:
        return None
    place = (centre - (centre @ axis) * axis).round(3) + 0.0
    name, words = base + CENTRE, " ".join(f"{value:g}" for value in place)
    element = copy.deepcopy(body.robot.element)
    element.append(_frame(name))
    element.append(_fixed(name, base, " ".join(f"{0.0 - value:g}" for value in place)))
    change = (
        f"the base link is '{name}', a new one at ({words}) m in the frame of '{base}', "
        f"on the line on which the fingers close: poses are those of '{name}'"
    )
    return Centred(tree(robot.path, element), name, change)


def _frame(name: str) -> ET.Element:
    """A link without shapes; without a mass the simulator would hold it still."""
    link = ET.Element("link", name=name)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "mass", value=f"{FRAME_MASS:g}")
    moments = {"ixx": "1e-7", "iyy": "1e-7", "izz": "1e-7"}
    ET.SubElement(inertial, "inertia", {**moments, "ixy": "0", "ixz": "0", "iyz": "0"})
    return link


def _fixed(parent: str, child: str, place: str) -> ET.Element:
    joint = ET.Element("joint", name=f"{parent}_joint", type="fixed")
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", xyz=place, rpy="0 0 0")
    return joint
