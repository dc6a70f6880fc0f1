"""Whether a gripper's file fits its URDF, and says what can be: all in which it does not, in words."""

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from qdgrasp_assets.finite import endless
from qdgrasp_assets.gripper_file import FreeJointTable, GripperFile, JawTable, JointTable
from qdgrasp_assets.hands.motion import kind_fault
from qdgrasp_assets.urdf import Urdf, UrdfJoint

RIGHT = 1e-3  # the cosine up to which an angle is taken for a right one


def gripper_faults(file: GripperFile, robot: Urdf) -> Iterator[str]:
    """All in which a gripper's file does not fit its URDF, or is impossible, in words.

    Names exist, every joint that moves is told of, numbers are possible.
    """
    if numbers := tuple(endless(file)):
        yield from numbers
        return
    unknown = tuple(_unknown(robot, "base_link", [file.base_link], robot.links))
    yield from unknown
    if not unknown:
        yield from _hand_faults(file, robot, robot.subtree(file.base_link))
    yield from _synergy_faults(file)
    yield from _number_faults(file)


def _hand_faults(file: GripperFile, robot: Urdf, hand: Urdf) -> Iterator[str]:
    moving = {joint.name: joint for joint in hand.joints if joint.moves}
    yield from (fault for joint in hand.joints if (fault := kind_fault(joint.name, joint.kind)))
    yield from _unknown(robot, "finger_links", file.finger_links, hand.links)
    yield from _unknown(robot, "joints", file.joints, moving)
    yield from _unknown(robot, "free_joints", file.free_joints, file.joints)
    for synergy in file.synergies:
        yield from _unknown(robot, f"synergy '{synergy.name}'", synergy.joints, file.joints)
    for name in moving:
        if name not in file.joints:
            yield (
                f"it says nothing about the joint '{name}' of '{robot.path}', which moves; "
                f"add [joints.{name}] with its open and closed positions, or with driven = false"
            )
    for name, table in file.joints.items():
        if name in moving:
            yield from _joint_faults(moving[name], table)
    for name, free in file.free_joints.items():
        if name in moving:
            yield from _free_faults(moving[name], free)


def _unknown(robot: Urdf, field: str, names: Any, known: Any) -> Iterator[str]:
    for name in names:
        if name not in known:
            yield (
                f"{field} names '{name}', which '{robot.path}' does not have below its base link; "
                f"it has {', '.join(sorted(known)) or 'none'}"
            )


def _joint_faults(joint: UrdfJoint, table: JointTable) -> Iterator[str]:
    for label, position in (("open", table.open), ("closed", table.closed)):
        if position is not None:
            yield from _limit_faults(joint, f"joints.{joint.name}.{label}", position)
    for label, told, value in (
        ("effort", table.effort, joint.effort),
        ("velocity", table.velocity, joint.velocity),
    ):
        if table.driven and (value if told is None else told) <= 0:
            yield (
                f"the {label} of the joint '{joint.name}' must be greater than 0; the URDF has {value:g}, "
                f"so give {label} in [joints.{joint.name}]"
            )


def _free_faults(joint: UrdfJoint, free: FreeJointTable) -> Iterator[str]:
    for label, position in (("low", free.low), ("high", free.high)):
        yield from _limit_faults(joint, f"free_joints.{joint.name}.{label}", position)
    if free.low == free.high:
        yield (
            f"free_joints.{joint.name} has one place, {free.low:g}, for low and high; make it a range, or "
            "leave it out"
        )


def _limit_faults(joint: UrdfJoint, field: str, position: float) -> Iterator[str]:
    limited = joint.lower < joint.upper and joint.kind != "continuous"
    if limited and not joint.lower - 1e-6 <= position <= joint.upper + 1e-6:
        yield f"{field} is {position:g}, outside the URDF's limits {joint.lower:g} to {joint.upper:g}"


def _synergy_faults(file: GripperFile) -> Iterator[str]:
    for name in _repeated(synergy.name for synergy in file.synergies if synergy.name):
        yield f"more than one of the synergies is called '{name}'; give each a name of its own"
    for synergy in file.synergies:
        if not synergy.name:
            yield f"a synergy of {', '.join(synergy.joints) or 'no joints'} has no name; give it one"
        if not synergy.joints:
            yield f"the synergy '{synergy.name}' has no joints; name those that close together"
        for joint in _repeated(synergy.joints):
            yield f"the synergy '{synergy.name}' names '{joint}' more than once; name each joint once"
        for joint in synergy.joints:
            if joint in file.joints and not file.joints[joint].driven:
                yield (
                    f"the synergy '{synergy.name}' names '{joint}', which is not driven; leave it out, or "
                    f"take driven = false out of [joints.{joint}]"
                )


def _repeated(names: Iterable[str]) -> list[str]:
    """Those that are there more than once."""
    return sorted(name for name, times in Counter(names).items() if times > 1)


def _number_faults(file: GripperFile) -> Iterator[str]:
    low, high = file.standoff
    if not 0 <= low <= high:
        yield f"standoff must be [least, greatest], 0 or more, got [{low:g}, {high:g}]"
    if file.palm_offset < 0:
        yield f"palm_offset must be 0 or more, got {file.palm_offset:g}"
    if not file.carrier_hold_force > 0:
        yield f"carrier_hold_force must be greater than 0, got {file.carrier_hold_force:g}"
    if not np.linalg.norm(file.approach_axis) > 0:
        yield "approach_axis must not be zero"
    if file.jaw is not None:
        yield from _jaw_faults(file, file.jaw)
    if not file.finger_links:
        yield "finger_links must name at least one link"
    for link in _repeated(file.finger_links):
        yield f"finger_links names '{link}' more than once; name each link once"


def _jaw_faults(file: GripperFile, jaw: JawTable) -> Iterator[str]:
    if not jaw.opening > 0:
        yield f"jaw.opening must be greater than 0, got {jaw.opening:g}"
    lengths = np.linalg.norm(jaw.axis) * np.linalg.norm(file.approach_axis)
    if not lengths > 0 or abs(np.dot(jaw.axis, file.approach_axis)) > RIGHT * lengths:
        yield f"jaw.axis must be at right angles to approach_axis, got {list(jaw.axis)}"
