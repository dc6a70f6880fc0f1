"""A hand's URDF mended: a copy of the hand alone, as the simulator can take it, with its meshes beside it.

What is there and can be used stays as it is. Each change is told in words.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, replace

from qdgrasp_assets.hands.splitting import Splitter, Tell
from qdgrasp_assets.hands.structure import edges, listed
from qdgrasp_assets.hands.visuals import drop_visuals
from qdgrasp_assets.hands.weighing import weigh
from qdgrasp_assets.urdf import Urdf, tree
from qdgrasp_protocol.phrases import counted


@dataclass(frozen=True)
class Mended:
    """A hand that was mended."""

    element: ET.Element
    """Its `<robot>`."""
    meshes: dict[str, bytes]
    """Its meshes, by the path that the URDF names them with."""
    changes: tuple[str, ...]
    """What was done, one sentence each; empty where nothing was."""


def mend(robot: Urdf, base: str, folder: str, tell: Tell) -> Mended:
    """The hand from link `base` on, mended.

    Parameters
    ----------
    robot
        A URDF whose links and joints are one tree.
    folder
        What meshes lie in, relative to the URDF that will be written.
    tell
        Hears what takes long.

    Raises
    ------
    AssetError
        A mesh is missing or cannot be read, or CoACD failed.
    """
    hand = replace(robot, element=robot.subtree(base).element)
    splitter = Splitter(hand.path, folder, tell)
    changes = [
        *_joints(hand.element),
        *_shapes(hand.element),
        *splitter.mend(hand),
        *_without_visuals(hand.element),
    ]
    written = tree(hand.path, hand.element)
    changes += weigh(written, splitter.corners)
    return Mended(hand.element, splitter.files, tuple(changes))


def _joints(element: ET.Element) -> Iterator[str]:
    """Joints that float are fixed, and limits the wrong way round are swapped."""
    floating, turned = [], []
    for joint in element.findall("joint"):
        limit, name = joint.find("limit"), joint.get("name", "")
        if joint.get("type") == "floating":
            joint.set("type", "fixed")
            floating.append(name)
        elif limit is not None and float(limit.get("lower", "0")) > float(limit.get("upper", "0")):
            lower, upper = limit.get("lower", "0"), limit.get("upper", "0")
            limit.set("lower", upper)
            limit.set("upper", lower)
            turned.append(name)
    if floating:
        yield f"{listed('joint', floating)} fixed, as no motor drives what floats"
    if turned:
        yield f"{listed('joint', turned)} limited the right way round: lower and upper were swapped"


def _shapes(element: ET.Element) -> Iterator[str]:
    """Where nothing that moves has collision shapes, the visual ones are taken."""
    moving = {child for joint, (_, child) in zip(element.findall("joint"), edges(element), strict=True)
              if joint.get("type") != "fixed"}  # fmt: skip
    links = element.findall("link")
    if any(link.find("collision") is not None for link in links if link.get("name") in moving):
        return
    taken = [link.get("name", "") for link in links if link.find("visual") is not None]
    for link in links:
        for visual in link.findall("visual"):
            shape = ET.SubElement(link, "collision")
            shape.extend(child for child in visual if child.tag in ("origin", "geometry"))
    if taken:
        yield f"{listed('link', taken)} given the visual shapes for collision, as there were no others"


def _without_visuals(element: ET.Element) -> Iterator[str]:
    """Visual shapes are left out: their meshes may be missing."""
    left = drop_visuals(element)
    if left:
        yield f"{counted(left, 'visual shape')} left out, which no evaluation needs"
