"""YAML files of grasps: Isaac Grasp, format version 1.0, and MoveIt.

An Isaac file is for one hand and one object, joints by name. Public descriptions: Isaac Sim, "Grasp Editor"
(keys `object_frame_link`, `gripper_frame_link`), and Isaac ROS, "Isaac Grasp File" (`object_frame`,
`gripper_frame`); files here have both. Readers of either take the poses from `grasps` and pass over what they
do not know, such as the block `qdgrasp`. GraspDataGen's files have `object_file`, `object_scale` and
`gripper_file` too, which its converter for GraspGen asks for.

Isaac Sim replicates a grasp from `position`, `orientation` and `cspace_position`: they are the settled pose
and the joints after closing. The commanded pose, which goes with `pregrasp_cspace_position`, has keys of our
own beside it.

For MoveIt the list `grasps` has messages `moveit_msgs/msg/Grasp` (ROS 2). `grasp_pose` is that of the hand's
root link, the parent link of the end effector, in the object's frame: the commanded pose, to which the hand
comes with `pre_grasp_posture` and where it closes. Messages have no place for the settled pose; it is in the
block `qdgrasp`. Approach and retreat, along the hand's own approach axis, are suggestions.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.grippers.hand_model import followers
from qdgrasp_assets.grippers.urdf import scene_robot
from qdgrasp_assets.scene import Scene, SceneGripper
from qdgrasp_protocol.drives import JAW_PRELOAD
from qdgrasp_protocol.rows import DISTURBANCES, NO_SYNERGY, nominal_protocol
from qdgrasp_tools.export.grasp_set import Grasps
from qdgrasp_tools.export.grasp_table import (
    GraspMetadata,
    GraspTable,
    UnreadableGrasps,
    exact_decimals,
    plain_values,
)

FORMAT, VERSION = "isaac_grasp", 1.0
WXYZ = "w, then xyz = [x, y, z]"


def to_yaml(values: Any) -> str:
    """Return values as YAML without aliases, innermost lists in one line."""
    import yaml

    class Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]  # chosen at run time
        """Writes no aliases."""

        def ignore_aliases(self, data: Any) -> bool:
            return True

    options: dict[str, Any] = {
        "sort_keys": False,
        "allow_unicode": True,
        "width": 1 << 20,
        "default_flow_style": None,
    }
    return str(yaml.dump(values, Dumper=Dumper, **options))


def _numbers(values: NDArray[np.floating]) -> list[Any]:
    """Return numbers as plain values whose decimals are the shortest in their precision."""
    return list(exact_decimals(values).tolist())


def _extra_lists(grasps: Grasps, about: GraspMetadata) -> dict[str, Any]:
    """Return values without a place in the format, lists in the order of the grasps."""
    names = ("fitness", "eta", "margin", "penetration", "width", "grip_force")
    columns = grasps.columns(about.frame)
    lists: dict[str, Any] = {name: plain_values(columns[name]) for name in names}
    lists = {name: values for name, values in lists.items() if any(each is not None for each in values)}
    if (grasps.synergies != NO_SYNERGY).any():
        lists["synergy"] = grasps.synergy_words.tolist()
    if grasps.approach is not None:
        lists["approach_directions"] = _numbers(grasps.approach_directions + 0.0)
        lists["approach_positions"] = _numbers(grasps.approach_poses(about.frame)[:, :3] + 0.0)
    if about.resting_poses:
        lists["resting_poses"] = grasps.resting_poses
        lists["resting_probability"] = _numbers(columns["resting_probability"])
    return lists


def write_isaac(path: Path, grasps: Grasps, about: GraspMetadata) -> None:
    """Write grasps as Isaac Grasp YAML."""
    about, postures = msgspec.structs.replace(about, quaternions=WXYZ), grasps.postures
    names = {"object_frame": about.object, "gripper_frame": about.gripper_frame}
    kinds = (
        ("", grasps.settled_poses(about.frame), postures.joints),
        ("pregrasp_", grasps.poses(about.frame), postures.pregrasp),
    )
    numbers = [(kind, _numbers(poses), _numbers(joints)) for kind, poses, joints in kinds]
    targets = [dict(zip(postures.names, each, strict=True)) for each in _numbers(postures.squeeze)]
    items = {}
    for place, (name, confidence) in enumerate(zip(grasps.numbers, _numbers(grasps.confidence), strict=True)):
        grasp = items[f"grasp_{name}"] = {"confidence": confidence}
        for kind, poses, joints in numbers:
            x, y, z, qx, qy, qz, qw = poses[place]
            grasp |= {
                f"{kind}position": [x, y, z],
                f"{kind}orientation": {"w": qw, "xyz": [qx, qy, qz]},
                f"{kind}cspace_position": dict(zip(postures.names, joints[place], strict=True)),
            }
        grasp["squeeze_cspace_position"] = targets[place]
    head = {"format": FORMAT, "format_version": VERSION}
    head |= {f"{key}_link": name for key, name in names.items()} | names
    head |= {"object_file": about.object_file or f"{about.object}.obj", "object_scale": about.object_scale}
    head["gripper_file"] = f"{about.gripper}.urdf"
    ours = about.values | {"grasps": _extra_lists(grasps, about)}
    values = head | {"qdgrasp": ours, "grasps": items}
    path.write_text(to_yaml(values), encoding="utf-8")


def write_moveit(path: Path, grasps: Grasps, about: GraspMetadata) -> None:
    """Write grasps as a YAML list of MoveIt's messages."""
    hand, postures, following = grasps.scene.gripper, grasps.postures, following_joints(grasps.scene.gripper)
    places = [place for place, name in enumerate(postures.names) if name not in following]
    names = [postures.names[place] for place in places]
    drives = grip_efforts(grasps.scene)
    effort = [drives.get(name, 0.0) for name in names]
    way = about.approach_distance or hand.reach
    moves = {
        name: {
            "direction": {"header": _header(hand.base_link), "vector": _xyz(axis)},
            "desired_distance": round(way, 6),
            "min_distance": round(min(way, hand.standoff[1]), 6),
        }
        for name, axis in (
            ("pre_grasp_approach", np.array(hand.approach_axis)),
            ("post_grasp_retreat", -np.array(hand.approach_axis) + 0.0),
            ("post_place_retreat", -np.array(hand.approach_axis) + 0.0),
        )
    }
    ends = (postures.pregrasp[:, places], postures.joints[:, places])
    columns = (grasps.numbers, grasps.poses(about.frame), *ends, _numbers(grasps.confidence))
    messages = [
        {
            "id": f"grasp_{name}",
            "pre_grasp_posture": _posture(names, start),
            "grasp_posture": _posture(names, closed, effort),
            "grasp_pose": {
                "header": _header(about.object),
                "pose": {
                    "position": _xyz(pose[:3]),
                    "orientation": dict(zip("xyzw", _numbers(pose[3:]), strict=True)),
                },
            },
            "grasp_quality": quality,
            **moves,
            "max_contact_force": 0.0,
            "allowed_touch_objects": [about.object],
        }
        for name, pose, start, closed, quality in zip(*columns, strict=True)
    ]
    lists = _extra_lists(grasps, about)
    lists["settled_poses"] = _numbers(grasps.settled_poses(about.frame))
    lists["squeeze_positions"] = _numbers(postures.squeeze[:, places])
    path.write_text(
        to_yaml({"qdgrasp": about.values | {"grasps": lists}, "grasps": messages}), encoding="utf-8"
    )


def grip_efforts(scene: Scene) -> dict[str, float]:
    """Return the effort with which each drive of a hand closes in its protocol [N or Nm]."""
    hand = scene.gripper
    if nominal_protocol(scene.protocol, scene.base) not in DISTURBANCES:
        return {joint.name: joint.effort for joint in hand.joints}
    share = JAW_PRELOAD if hand.jaw else 1.0
    return {joint.name: share * (joint.rated_effort or joint.effort) for joint in hand.joints}


def following_joints(hand: SceneGripper) -> set[str]:
    """Return the joints of a hand that have no drive of their own.

    Those of a jaw move together, and follow the first; others follow where the URDF says that they mimic.
    """
    following = set(followers(scene_robot(hand)))
    if hand.jaw:
        driven = [joint.name for joint in hand.joints if joint.driven and joint.opened != joint.closed]
        following = {*following, *driven[1:]} - {*driven[:1]}
    return following


def _header(frame: str) -> dict[str, Any]:
    return {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}


def _xyz(vector: NDArray[np.floating]) -> dict[str, float]:
    return dict(zip("xyz", _numbers(vector), strict=True))


def _posture(names: list[str], positions: NDArray[np.floating], effort: Sequence[float] = ()) -> Any:
    """Return a trajectory_msgs/msg/JointTrajectory of one point."""
    point: dict[str, Any] = {"positions": _numbers(positions), "velocities": [], "accelerations": []}
    point |= {"effort": list(effort), "time_from_start": {"sec": 0, "nanosec": 0}}
    return {"header": _header(""), "joint_names": names, "points": [point]}


def read_isaac(path: Path) -> GraspTable:
    """Read the grasps in an Isaac Grasp YAML file, of ours or of others."""
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    with path.open("rb") as text:
        file = yaml.load(text, Loader=loader)  # noqa: S506  # a safe one
    if not isinstance(file, dict) or file.get("format") != FORMAT:
        raise UnreadableGrasps(path, f"it is YAML, but not an Isaac grasp file: it has no 'format: {FORMAT}'")
    if float(file.get("format_version", 0.0)) != VERSION:
        raise UnreadableGrasps(path, f"it is of format version {file['format_version']}; {VERSION} is read")
    grasps, ours = list(file["grasps"].values()), file.get("qdgrasp")
    names = dict.fromkeys(name for each in grasps for name in each.get("pregrasp_cspace_position", ()))
    names |= dict.fromkeys(name for each in grasps for name in each.get("cspace_position", ()))
    starts = [[each.get("pregrasp_cspace_position", {}).get(name) for name in names] for each in grasps]
    link = file.get("gripper_frame_link") or file.get("gripper_frame")
    table = GraspTable(
        names=np.array(list(file["grasps"]), dtype=str),
        poses=np.array([_commanded_pose(each) for each in grasps], dtype=np.float64).reshape(-1, 7),
        link=link and link.rsplit("/", 1)[-1],  # a path in the stage
        joint_names=tuple(names),
        pregrasp=np.array(starts, dtype=np.float64).reshape(-1, len(names)),  # NaN for None
        confidence=np.array([each.get("confidence") for each in grasps], dtype=np.float64),
    )
    if ours is None:
        return table
    synergies = ours["grasps"].get("synergy")
    table = replace(table, synergies=synergies and np.array(synergies, dtype=str))
    return table.with_metadata(msgspec.convert(ours, GraspMetadata))


def _commanded_pose(grasp: dict[str, Any]) -> list[float]:
    """Return position [m] and quaternion xyzw of the commanded pose, else the only one."""
    kind = "pregrasp_" if "pregrasp_position" in grasp else ""
    turn = grasp[f"{kind}orientation"]
    return [*grasp[f"{kind}position"], *turn["xyz"], turn["w"]]
