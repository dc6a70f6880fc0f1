"""Joints that follow others: URDF's <mimic>, which the simulator does not know.

So each of them is driven by a motor of its own, to where its leader is told to go, and they move together as
long as nothing is in their way.
"""

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass

from qdgrasp_assets.urdf import Urdf


@dataclass(frozen=True)
class Follower:
    """A joint whose position is `multiplier` times its leader's, plus `offset`."""

    leader: str
    """A joint that follows none."""
    multiplier: float
    offset: float
    """[rad or m]."""

    def at(self, position: float) -> float:
        """Where it is when its leader is at `position` [rad or m]."""
        return self.multiplier * position + self.offset


def followers(robot: Urdf) -> dict[str, Follower]:
    """The joints of a robot that follow others which move, by name."""
    told = {
        joint.get("name", ""): _told(mimic)
        for joint in robot.element.findall("joint")
        if (mimic := joint.find("mimic")) is not None
    }
    moving = {joint.name for joint in robot.joints if joint.moves}
    found = {name: _at_its_root(name, told) for name in told if name in moving}
    return {name: follower for name, follower in found.items() if follower.leader in moving - {name}}


def followed(robot: Urdf, positions: Mapping[str, float]) -> dict[str, float]:
    """The positions of leaders [rad or m], and those at which their followers are."""
    following = {
        name: each.at(positions[each.leader])
        for name, each in followers(robot).items()
        if each.leader in positions
    }
    return {**positions, **following}


def _told(mimic: ET.Element) -> Follower:
    return Follower(
        mimic.get("joint", ""), float(mimic.get("multiplier", "1")), float(mimic.get("offset", "0"))
    )


def _at_its_root(name: str, told: Mapping[str, Follower]) -> Follower:
    """What a joint follows in the end, where its leader is a follower too."""
    follower, seen = told[name], {name}
    while follower.leader in told and follower.leader not in seen:
        seen.add(follower.leader)
        further = told[follower.leader]
        follower = Follower(
            further.leader, follower.multiplier * further.multiplier, follower.at(further.offset)
        )
    return follower
