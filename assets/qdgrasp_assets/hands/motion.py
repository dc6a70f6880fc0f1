"""The joints of a hand: kinds, limits and mimicry that the simulator does not take as they are, in words."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping

from qdgrasp_assets.hands.structure import listed

PAIR = 2
LIMITED = ("revolute", "prismatic")
KINDS = {
    "fixed": "",
    "revolute": "",
    "continuous": "",
    "prismatic": "",
    "floating": "a floating one, which no motor drives, and the simulator would fix it: make it fixed",
    "planar": "a planar one, which no motor drives: make it fixed, or two prismatic joints",
}
"""The kinds of joints of URDF, and what is wrong with them here."""


def motion_faults(element: ET.Element) -> tuple[str, ...]:
    """What is wrong with the joints of a `<robot>`; empty when nothing is."""
    joints = {joint.get("name", ""): joint for joint in element.findall("joint")}
    found = [fault for name, joint in joints.items() for fault in _faults(name, joint, joints)]
    return (*found, *_reversed(joints))


def kind_fault(name: str, kind: str) -> str:
    """What is wrong with the kind of a joint; empty when nothing is."""
    told = KINDS.get(kind, f"of the type '{kind}', and URDF knows {', '.join(KINDS)}")
    return f"the joint '{name}' is {told}" if told else ""


def _faults(name: str, joint: ET.Element, joints: Mapping[str, ET.Element]) -> Iterator[str]:
    kind = joint.get("type", "")
    if fault := kind_fault(name, kind):
        yield fault
        return
    if kind in LIMITED and joint.find("limit") is None:
        yield f"the joint '{name}' is {kind} and has no <limit>: give it lower, upper, effort and velocity"
    axis = joint.find("axis")
    if kind != "fixed" and axis is not None and not any(_numbers(axis.get("xyz", ""))):
        yield f"the joint '{name}' has the axis '{axis.get('xyz')}'; an axis has a direction, such as '0 0 1'"
    mimic = joint.find("mimic")
    leader = None if mimic is None else mimic.get("joint", "")
    if leader is not None and (leader not in joints or leader == name):
        yield f"the joint '{name}' mimics '{leader}', which is no other joint of the robot; correct the name"
    if mimic is not None and len(_numbers(f"{mimic.get('multiplier', 1)} {mimic.get('offset', 0)}")) != PAIR:
        yield f"the joint '{name}' mimics another by what is no number; correct multiplier and offset"


def _reversed(joints: Mapping[str, ET.Element]) -> Iterator[str]:
    """Joints whose limits the simulator leaves aside, or that have no room between them."""
    limits = {name: _limits(joint) for name, joint in joints.items() if joint.get("type") in LIMITED}
    turned = [name for name, (lower, upper) in limits.items() if lower > upper]
    if turned:
        yield (
            f"{listed('joint', turned)} limited the wrong way round, lower above upper, which the simulator "
            "takes for no limits: swap them"
        )
    still = [name for name, (lower, upper) in limits.items() if lower == upper]
    if still:
        yield (
            f"{listed('joint', still)} limited to one place, lower equal to upper: make it fixed, or widen it"
        )


def _limits(joint: ET.Element) -> tuple[float, float]:
    """Lower and upper limit; a range where they are not to be judged."""
    limit = joint.find("limit")
    found = [] if limit is None else _numbers(f"{limit.get('lower', '0')} {limit.get('upper', '0')}")
    return (found[0], found[1]) if len(found) == PAIR else (0.0, 1.0)


def _numbers(text: str) -> list[float]:
    """The numbers of an attribute; none where it holds something else."""
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        return []
