"""Examinations: everything that is known of a hand before a run is made of it."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from qdgrasp_assets.findings import Findings
from qdgrasp_assets.gripper import Gripper
from qdgrasp_assets.gripper_faults import gripper_faults
from qdgrasp_assets.gripper_file import GripperFile, read_gripper_file, urdf_path
from qdgrasp_assets.hands.base import guess_base
from qdgrasp_assets.hands.body import Body, read_body
from qdgrasp_assets.hands.draft import Told, draft
from qdgrasp_assets.hands.hollows import hollows
from qdgrasp_assets.hands.meshes import mesh_faults
from qdgrasp_assets.hands.motion import motion_faults
from qdgrasp_assets.hands.posture_notes import posture_notes
from qdgrasp_assets.hands.postures import Postures, posture_faults
from qdgrasp_assets.hands.source import read_source
from qdgrasp_assets.hands.structure import structure_faults
from qdgrasp_assets.hands.weight import weight_faults
from qdgrasp_assets.urdf import Urdf, tree
from qdgrasp_protocol.errors import AssetError, QdgraspError
from qdgrasp_protocol.phrases import counted

NOTHING = Told()


class Examination(Findings, frozen=True, kw_only=True):
    """What was found of a hand."""

    urdf: str = ""
    base_link: str = ""
    licence: str = ""
    joints: int = 0
    """That move."""
    followers: int = 0
    """Of these, how many mimic another one."""
    fingers: int = 0
    finger_links: tuple[str, ...] = ()
    synergies: tuple[str, ...] = ()
    mass: float | None = None
    """[kg]"""
    extents: tuple[float, float, float] | None = None
    """Sides of the box around the open hand, base link's frame [m]."""
    parts: int = 0
    """Convex parts that the simulator makes of the collision shapes."""

    @property
    def facts(self) -> tuple[str, ...]:
        """The most of it, in a few words each."""
        if not self.base_link:
            return ()
        fingers = f"fingers {', '.join(self.finger_links)}"
        return (f"base {self.base_link}", counted(self.joints, "joint"), fingers, f"licence {self.licence}")

    def _lines(self) -> Iterator[tuple[str, str]]:
        yield "gripper", self.name
        if self.base_link:
            yield "URDF", self.urdf
            yield "base link", self.base_link
            mimics = f", {self.followers} of them mimic others" if self.followers else ""
            yield "joints", f"{self.joints} move{mimics}"
            yield "fingers", f"{self.fingers}, with {counted(len(self.finger_links), 'finger link')}"
            if self.synergies:
                yield "synergies", ", ".join(self.synergies)
            yield "licence", self.licence
        if self.extents is not None:
            yield "size", f"{' x '.join(f'{side:.4f}' for side in self.extents)} m, open"
            yield "mass", f"{self.mass:.4g} kg"
            yield "shapes", f"{self.parts} convex parts"


def examine(path: Path, name: str) -> Examination:
    """Examine a gripper's TOML file, and the URDF that it names; whatever is wrong is among the faults."""
    try:
        file = read_gripper_file(path)
        urdf = urdf_path(path, file)
        robot, faults = read_robot(urdf, read_source(urdf))
    except QdgraspError as error:
        return Examination(name=name, faults=(_plain(error),))
    return Examination(name=name, faults=faults) if robot is None else examine_hand(robot, file, name)


def examine_urdf(urdf: Path, name: str, told: Told = NOTHING) -> tuple[Examination, Gripper | None]:
    """Examine a URDF with the file that would be guessed of it, and the gripper that the two make.

    None where there is none.
    """
    try:
        robot, faults = read_robot(urdf, read_source(urdf))
        if robot is not None:
            base = told.base_link or guess_base(robot)[0]
            faults = hand_faults(robot, base)
            if not faults:
                file = draft(robot, str(urdf), replace(told, base_link=base)).file
                return examine_hand(robot, file, name), Gripper(name, urdf.name, file, robot)
    except QdgraspError as error:
        faults = (_plain(error),)
    return Examination(name=name, faults=faults), None


def examine_hand(robot: Urdf, file: GripperFile, name: str) -> Examination:
    """Examine a hand, of which the file and the URDF are read already."""
    faults = (*gripper_faults(file, robot), *hand_faults(robot, file.base_link))
    if faults:
        return Examination(name=name, faults=tuple(dict.fromkeys(faults)))
    return _measured(name, file, read_body(robot, file.base_link))


def read_robot(urdf: Path, element: ET.Element) -> tuple[Urdf | None, tuple[str, ...]]:
    """The links and joints of a `<robot>`; None where they are no tree, with all that is wrong with them."""
    faults = structure_faults(element)
    if faults:
        return None, (*faults, *motion_faults(element), *weight_faults(element))
    try:
        return tree(urdf, element), ()
    except AssetError as error:
        return None, (_plain(error), *motion_faults(element), *weight_faults(element))


def hand_faults(robot: Urdf, base: str) -> tuple[str, ...]:
    """What is wrong with the joints, masses and shapes of the hand from link `base` on."""
    if base not in robot.links:
        return ()
    hand = robot.subtree(base)
    return (*motion_faults(hand.element), *weight_faults(hand.element), *mesh_faults(hand))


def _measured(name: str, file: GripperFile, body: Body) -> Examination:
    """What is known of a hand that can be simulated."""
    hand = Postures(file, body)
    corners = body.corners(body.parts, hand.posture(0.0))
    x, y, z = (float(side) for side in (np.ptp(corners, axis=0) if len(corners) else np.zeros(3)))
    faults = posture_faults(file, body)
    return Examination(
        name=name,
        urdf=str(body.robot.path),
        base_link=file.base_link,
        licence=file.licence,
        joints=len(body.moving),
        followers=len(body.followers),
        fingers=len(hand.closing.fingers),
        finger_links=file.finger_links,
        synergies=tuple(synergy.name for synergy in file.synergies),
        mass=body.robot.mass,
        extents=(x, y, z),
        parts=sum(map(len, body.parts.values())),
        notes=() if faults else (*posture_notes(file, body), *_hollow(body.robot)),
        faults=faults,
    )


def _hollow(hand: Urdf) -> Iterator[str]:
    found = [f"{each.link} {100 * each.filled:.0f} %" for each in hollows(hand)]
    if found:
        yield (
            "the simulator wraps each collision mesh in its convex hull, which fills the room before "
            f"much of the surface of {', '.join(found)}: "
            "`qdgrasp gripper new --mend` splits such meshes into convex parts"
        )


def _plain(error: Exception) -> str:
    return str(error).rstrip(".")
