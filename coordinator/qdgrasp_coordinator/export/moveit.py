"""MoveIt: messages `moveit_msgs/msg/Grasp` (ROS 2) as YAML, in the list `grasps`.

`grasp_pose` is that of the hand's root link, the parent link of the end effector, in the object's frame. The
hand closes at that pose, as it was simulated; approach and retreat, along the hand's own approach axis, are
suggestions.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from qdgrasp_coordinator.export.grasp_set import Grasps
from qdgrasp_coordinator.export.metadata import GraspMetadata
from qdgrasp_coordinator.export.text_format import grasp_decimals, table_decimals, yaml_block

HEADER = "{{stamp: {{sec: 0, nanosec: 0}}, frame_id: {}}}"


def write(path: Path, grasps: Grasps, metadata: GraspMetadata) -> None:
    """Write grasps as a YAML list of messages."""
    with path.open("w", encoding="utf-8") as file:
        file.write(yaml_block({"qdgrasp": metadata.values}))
        file.write("grasps:\n")
        file.writelines(_messages(grasps, metadata))


def _messages(grasps: Grasps, metadata: GraspMetadata) -> Iterator[str]:
    """Yield the lines of each message."""
    names = ", ".join(map(_quoted, grasps.joint_names))
    moves = _moves(grasps)
    object_frame, touched = HEADER.format(_quoted(metadata.object)), _quoted(metadata.object)
    for number, quality, pose, closed, start in grasp_decimals(grasps, metadata.frame):
        x, y, z, qx, qy, qz, qw = pose
        yield (
            f"- id: grasp_{number}\n"
            f"  pre_grasp_posture: {_posture(names, start)}\n"
            f"  grasp_posture: {_posture(names, closed)}\n"
            f"  grasp_pose:\n"
            f"    header: {object_frame}\n"
            f"    pose: {{position: {{x: {x}, y: {y}, z: {z}}}, "
            f"orientation: {{x: {qx}, y: {qy}, z: {qz}, w: {qw}}}}}\n"
            f"  grasp_quality: {quality}\n"
            f"{moves}"
            f"  max_contact_force: 0.0\n"
            f"  allowed_touch_objects: [{touched}]\n"
        )


def _posture(names: str, positions: list[str]) -> str:
    """Write a trajectory_msgs/msg/JointTrajectory of one point."""
    point = (
        f"{{positions: [{', '.join(positions)}], velocities: [], accelerations: [], effort: [], "
        "time_from_start: {sec: 0, nanosec: 0}}"
    )
    return f"{{header: {HEADER.format(_quoted(''))}, joint_names: [{names}], points: [{point}]}}"


def _moves(grasps: Grasps) -> str:
    """Write approach and retreats: the hand's reach, at least the range of its stand-off."""
    hand = grasps.scene.gripper
    header = HEADER.format(_quoted(hand.base_link))
    lines = ""
    for name, sign in (("pre_grasp_approach", 1), ("post_grasp_retreat", -1), ("post_place_retreat", -1)):
        ((x, y, z),) = table_decimals(sign * np.array([hand.approach_axis]) + 0.0)
        lines += (
            f"  {name}: {{direction: {{header: {header}, vector: {{x: {x}, y: {y}, z: {z}}}}}, "
            f"desired_distance: {hand.reach:.6f}, min_distance: {hand.standoff[1]:.6f}}}\n"
        )
    return lines


def _quoted(name: str) -> str:
    return json.dumps(name, ensure_ascii=False)
