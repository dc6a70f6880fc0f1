"""Whether a gripper's file fits its URDF, and says what can be: all in which it does not, in words."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from qdgrasp_assets.finite import endless
from qdgrasp_assets.gripper_file import GripperFile, JawTable, JointTable
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


def _unknown(robot: Urdf, field: str, names: Any, known: Any) -> Iterator[str]:
    for name in names:
        if name not in known:
            yield (
                f"{field} names '{name}', which '{robot.path}' does not have below its base link; "
                f"it has {', '.join(sorted(known)) or 'none'}"
            )


def _joint_faults(joint: UrdfJoint, table: JointTable) -> Iterator[str]:
    for label, position in (("open", table.open), ("closed", table.closed)):
        limited = joint.lower < joint.upper and joint.kind != "continuous"
        if position is not None and limited and not joint.lower - 1e-6 <= position <= joint.upper + 1e-6:
            yield (
                f"joints.{joint.name}.{label} is {position:g}, outside the URDF's limits "
                f"{joint.lower:g} to {joint.upper:g}"
            )
    for label, told, value in (
        ("effort", table.effort, joint.effort),
        ("velocity", table.velocity, joint.velocity),
    ):
        if table.driven and (value if told is None else told) <= 0:
            yield (
                f"the {label} of the joint '{joint.name}' must be greater than 0; the URDF has {value:g}, "
                f"so give {label} in [joints.{joint.name}]"
            )


def _number_faults(file: GripperFile) -> Iterator[str]:
    low, high = file.standoff
    if not 0 <= low <= high:
        yield f"standoff must be [least, greatest], 0 or more, got [{low:g}, {high:g}]"
    if file.palm_offset < 0:
        yield f"palm_offset must be 0 or more, got {file.palm_offset:g}"
    if not np.linalg.norm(file.approach_axis) > 0:
        yield "approach_axis must not be zero"
    if file.jaw is not None:
        yield from _jaw_faults(file, file.jaw)
    if not file.finger_links:
        yield "finger_links must name at least one link"
    for link in sorted(link for link, times in Counter(file.finger_links).items() if times > 1):
        yield f"finger_links names '{link}' more than once; name each link once"


def _jaw_faults(file: GripperFile, jaw: JawTable) -> Iterator[str]:
    if not jaw.opening > 0:
        yield f"jaw.opening must be greater than 0, got {jaw.opening:g}"
    lengths = np.linalg.norm(jaw.axis) * np.linalg.norm(file.approach_axis)
    if not lengths > 0 or abs(np.dot(jaw.axis, file.approach_axis)) > RIGHT * lengths:
        yield f"jaw.axis must be at right angles to approach_axis, got {list(jaw.axis)}"
