"""The body of a hand: its collision shapes as the simulator takes them, where its joints put them."""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from qdgrasp_assets.hands.mimicry import Follower, followers
from qdgrasp_assets.hands.overlap import Floats, Solid
from qdgrasp_assets.hulls import convex_parts
from qdgrasp_assets.shapes import shapes
from qdgrasp_assets.urdf import Urdf, UrdfJoint
from qdgrasp_protocol.errors import AssetError


@dataclass(frozen=True)
class Body:
    """A hand's links, joints and convex parts."""

    robot: Urdf
    """From the base link outward."""
    parts: Mapping[str, tuple[Solid, ...]]
    """The convex parts of each link, link frame; links without any are left out."""

    @cached_property
    def moving(self) -> tuple[str, ...]:
        """The joints that move, as the file orders them."""
        return tuple(joint.name for joint in self.robot.joints if joint.moves)

    @cached_property
    def followers(self) -> dict[str, Follower]:
        """The joints that follow others."""
        return followers(self.robot)

    @cached_property
    def mounts(self) -> dict[str, str]:
        """For each link the first link of the rigid piece that it is in."""
        mounts = {self.robot.root: self.robot.root}
        for joint in self.robot.outward(self.robot.root):
            mounts[joint.child] = joint.child if joint.moves else mounts[joint.parent]
        return mounts

    def frames(self, posture: Mapping[str, float]) -> dict[str, Floats]:
        """Each link's frame (4, 4) in the base link's, followers where `posture` says [rad or m]."""
        return self.robot.forward(posture)

    def placed(
        self, posture: Mapping[str, float], links: Iterable[str] | None = None
    ) -> dict[str, tuple[Solid, ...]]:
        """The convex parts of some links, or of all, in the base link's frame."""
        frames = self.frames(posture)
        return {
            link: tuple(part.placed(frames[link]) for part in self.parts[link])
            for link in (self.parts if links is None else links)
        }

    def corners(self, links: Iterable[str], posture: Mapping[str, float]) -> Floats:
        """All corners (n, 3) [m] of some links, the base link's frame."""
        frames = self.frames(posture)
        found = [
            part.corners @ frames[link][:3, :3].T + frames[link][:3, 3]
            for link in links
            for part in self.parts.get(link, ())
        ]
        return np.concatenate([np.zeros((0, 3)), *found])

    def joint(self, name: str) -> UrdfJoint:
        """The joint of this name, which is one of the hand's."""
        return next(joint for joint in self.robot.joints if joint.name == name)

    def range(self, name: str) -> tuple[float, float]:
        """How far a joint may go [rad or m]; half a turn about zero for one without limits."""
        joint = self.joint(name)
        if joint.kind != "continuous" and joint.lower < joint.upper:
            return joint.lower, joint.upper
        return (-np.pi / 2, np.pi / 2) if joint.kind != "prismatic" else (-0.05, 0.05)


def read_body(robot: Urdf, base: str) -> Body:
    """The body of the hand that begins with link `base`.

    Raises
    ------
    AssetError
        A mesh is missing, or cannot be read.
    """
    hand = robot.subtree(base)
    parts: dict[str, tuple[Solid, ...]] = {}
    for link, collision in collisions(hand):
        parts[link] = parts.get(link, ()) + tuple(
            Solid(corners) for corners in corners_of(hand, link, collision)
        )
    return Body(hand, parts)


def collisions(robot: Urdf) -> Iterator[tuple[str, ET.Element]]:
    """Each collision shape with its link's name."""
    for link in robot.element.findall("link"):
        for collision in link.findall("collision"):
            yield link.get("name", ""), collision


def corners_of(robot: Urdf, link: str, collision: ET.Element) -> tuple[Floats, ...]:
    """The corners (v, 3) of the convex parts of a collision shape [m], link frame.

    Raises
    ------
    AssetError
        Its mesh is missing, cannot be read, or is empty; or its form is none of URDF's.
    """
    alone = ET.Element("robot")
    ET.SubElement(alone, "link", name=link).append(collision)
    element, files = replace(robot, element=alone, joints=()).bundled()
    shape = replace(robot, element=element, joints=())
    try:
        found = tuple(part.corners for part in convex_parts(shape, files))
        return found or tuple(each.vertices for each in shapes(shape, files))
    except AssetError:
        raise
    except Exception as error:  # noqa: BLE001  # readers of meshes raise whatever they stumble over
        raise AssetError(
            f"a collision shape of the link '{link}' cannot be read ({type(error).__name__}: {error}); "
            "save its mesh as a binary STL or an OBJ file"
        ) from None


def mesh_bytes(path: Path, name: str) -> bytes:
    """The content of the mesh that the URDF at `path` refers to as `name`.

    Raises
    ------
    AssetError
        It does not exist, or cannot be read.
    """
    element = ET.Element("robot")
    link = ET.SubElement(element, "link", name="")
    ET.SubElement(ET.SubElement(ET.SubElement(link, "collision"), "geometry"), "mesh", filename=name)
    try:
        _, files = Urdf(path, element, (), ()).bundled()
    except OSError as error:
        raise AssetError(f"The mesh '{name}' of '{path}' cannot be read: {error.strerror}.") from None
    return next(iter(files.values()))
