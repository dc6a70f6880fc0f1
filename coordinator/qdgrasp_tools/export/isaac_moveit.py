"""YAML files of grasps: Isaac Grasp, format version 1.0, and MoveIt.

An Isaac file is for one hand and one object, joints by name. Public descriptions: Isaac Sim, "Grasp Editor"
(keys `object_frame_link`, `gripper_frame_link`), and Isaac ROS, "Isaac Grasp File" (`object_frame`,
`gripper_frame`); files here have both. Readers of either take the poses from `grasps` and pass over what they
do not know, such as the block `qdgrasp`.

Isaac Sim replicates a grasp from `position`, `orientation` and `cspace_position`: they are the settled pose
and the joints after closing. The commanded pose, which goes with `pregrasp_cspace_position`, stands in keys
of our own beside it.

For MoveIt the list `grasps` has messages `moveit_msgs/msg/Grasp` (ROS 2). `grasp_pose` is that of the hand's
root link, the parent link of the end effector, in the object's frame: the commanded pose, to which the hand
comes with `pre_grasp_posture` and where it closes. Messages have no place for the settled pose; it stands in
the block `qdgrasp`. Approach and retreat, along the hand's own approach axis, are suggestions.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_protocol.rows import NO_SYNERGY
from qdgrasp_tools.export.frames import Frame
from qdgrasp_tools.export.grasp_set import Grasps
from qdgrasp_tools.export.imported_grasps import ImportedGrasps, UnreadableGrasps, to_words
from qdgrasp_tools.export.metadata import GraspMetadata
from qdgrasp_tools.export.text_format import (
    Tree,
    grasp_decimals,
    read_yaml,
    shortest_decimals,
    table_decimals,
    yaml_block,
    yaml_word,
)

FORMAT, VERSION = "isaac_grasp", 1.0
EXTRA_KEY = "grasps"  # The lists in the block `qdgrasp` that have an item for each grasp
MOST_JOINTS = 1000  # Of a hand, at most
PREGRASP = "pregrasp_"  # Prefix of keys of the commanded pose and the open joints
WXYZ = "w, then xyz = [x, y, z]"


def write_isaac(path: Path, grasps: Grasps, metadata: GraspMetadata) -> None:
    """Write grasps as Isaac Grasp YAML."""
    with path.open("w", encoding="utf-8") as file:
        file.write(f"format: {FORMAT}\nformat_version: {VERSION}\n")
        names = {"object_frame": metadata.object, "gripper_frame": metadata.gripper_frame}
        frames = {f"{key}_link": name for key, name in names.items()} | names
        ours = msgspec.structs.replace(metadata, quaternions=WXYZ)
        file.write(yaml_block(frames | {"qdgrasp": ours.values}))
        file.writelines(_extra_lines(grasps, metadata.frame))
        file.write("grasps:\n")
        file.writelines(_lines(grasps, metadata))


def _extra_lines(grasps: Grasps, frame: Frame) -> Iterator[str]:
    """Yield values without a place in the format, as the end of the block `qdgrasp`.

    They are in the order of the grasps; lists of nothing are left out.
    """
    yield f"  {EXTRA_KEY}:\n"
    names = [yaml_word(name) for name in grasps.synergy_names] + ["''"]
    for key, values in (
        ("fitness", grasps.fitness), ("eta", grasps.eta),
        ("margin", grasps.margin), ("penetration", grasps.rows["penetration"]),
    ):  # fmt: skip
        known = ~np.isnan(values)
        if known.any():
            yield f"    {key}: [{', '.join(np.where(known, shortest_decimals(values), 'null'))}]\n"
    if (grasps.synergies != NO_SYNERGY).any():
        yield f"    synergy: [{', '.join(names[label] for label in grasps.synergies.tolist())}]\n"
    if grasps.approach is not None:
        for key, table in (
            ("approach_directions", grasps.approach_directions),
            ("approach_positions", grasps.approach_poses(frame)[:, :3]),
        ):
            vectors = (f"[{', '.join(vector)}]" for vector in table_decimals(table + 0.0))
            yield f"    {key}: [{', '.join(vectors)}]\n"
        if grasps.approach.poses:
            yield f"    resting_poses: {grasps.resting_poses}\n"
            shares = ", ".join(shortest_decimals(grasps.reach.probability))
            yield f"    resting_probability: [{shares}]\n"


def _lines(grasps: Grasps, metadata: GraspMetadata) -> Iterator[str]:
    joints = [yaml_word(name) for name in grasps.joint_names]
    for number, confidence, *pairs in grasp_decimals(grasps, metadata.frame):
        yield f"  grasp_{number}:\n    confidence: {confidence}\n"
        for kind, (pose, positions) in zip(("", PREGRASP), pairs, strict=True):
            x, y, z, qx, qy, qz, qw = pose
            yield (
                f"    {kind}position: [{x}, {y}, {z}]\n"
                f"    {kind}orientation: {{w: {qw}, xyz: [{qx}, {qy}, {qz}]}}\n"
                f"    {kind}cspace_position:{_mapping(joints, positions)}"
            )


def _mapping(names: list[str], values: list[str]) -> str:
    if not names:
        return " {}\n"
    return "\n" + "".join(f"      {name}: {value}\n" for name, value in zip(names, values, strict=True))


def read_isaac(path: Path) -> ImportedGrasps:
    """Read the grasps in an Isaac Grasp YAML file, of ours or of others."""
    tree = read_yaml(path)
    if isinstance(tree, dict) and "qdgrasp" in tree and isinstance(tree.get("grasps"), list):
        raise UnreadableGrasps(
            path, "it is MoveIt of `qdgrasp export`, which is not read back; export parquet instead"
        )
    if not isinstance(tree, dict) or tree.get("format") != FORMAT:
        raise UnreadableGrasps(path, f"it is YAML, but not an Isaac grasp file: it has no 'format: {FORMAT}'")
    if _numbers(path, ("format_version",), [tree.get("format_version", "")], 1) != [VERSION]:
        raise UnreadableGrasps(path, f"it is of format version {tree['format_version']}; {VERSION} is read")
    grasps = tree.get("grasps")
    if not isinstance(grasps, dict):
        raise UnreadableGrasps(path, "its key 'grasps' must hold grasps by name")
    metadata = _metadata(path, tree)
    stage_path = tree.get("gripper_frame_link", tree.get("gripper_frame"))  # its last part is the link
    link = stage_path.rsplit("/", 1)[-1] if isinstance(stage_path, str) else None
    return ImportedGrasps(
        names=to_words(path, "names", grasps),
        poses=np.array([_pose(path, name, grasp) for name, grasp in grasps.items()]).reshape(-1, 7),
        frame=metadata.frame if metadata else None,
        gripper=metadata.gripper if metadata else None,
        link=metadata.gripper_frame if metadata else link,
        start_positions=_joints(path, grasps, f"{PREGRASP}cspace_position"),
        joints=tuple(_joints(path, grasps, "cspace_position")),
        synergies=_synergies(path, tree, len(grasps)),
        confidence=np.array([_confidence(path, name, grasp) for name, grasp in grasps.items()]),
        scale=metadata.object_scale if metadata else None,
        metadata=metadata,
    )


def _metadata(path: Path, tree: dict[str, Tree]) -> GraspMetadata | None:
    if "qdgrasp" not in tree:
        return None
    try:
        return msgspec.convert(tree["qdgrasp"], GraspMetadata, strict=False)  # every number is a word yet
    except msgspec.ValidationError as error:
        raise UnreadableGrasps(path, f"its block 'qdgrasp' cannot be read ({error})") from None


def _synergies(path: Path, tree: dict[str, Tree], count: int) -> NDArray[np.str_] | None:
    ours = tree.get("qdgrasp")
    beside = ours.get(EXTRA_KEY) if isinstance(ours, dict) else None
    if not isinstance(beside, dict) or "synergy" not in beside:
        return None
    names = beside["synergy"]
    if not isinstance(names, list) or len(names) != count or not all(isinstance(name, str) for name in names):
        raise UnreadableGrasps(path, f"the list 'synergy' of its block 'qdgrasp' must have {count} names")
    return to_words(path, "synergies", names)  # type: ignore[arg-type]  # each is a word


def _pose(path: Path, name: str, grasp: Tree) -> list[float]:
    """Return position [m] and quaternion xyzw, of the commanded pose where the file has it."""
    values = grasp if isinstance(grasp, dict) else {}
    kind = PREGRASP if f"{PREGRASP}position" in values else ""
    position, orientation = f"{kind}position", f"{kind}orientation"
    turn = values.get(orientation)
    turn = turn if isinstance(turn, dict) else {}
    return [
        *_numbers(path, (name, position), values.get(position), 3),
        *_numbers(path, (name, orientation, "xyz"), turn.get("xyz"), 3),
        *_numbers(path, (name, orientation, "w"), [turn.get("w", "")], 1),
    ]


def _confidence(path: Path, name: str, grasp: Tree) -> float:
    value = grasp.get("confidence") if isinstance(grasp, dict) else None
    return np.nan if value is None else _numbers(path, (name, "confidence"), [value], 1)[0]


def _joints(path: Path, grasps: dict[str, Tree], key: str) -> dict[str, Floats]:
    """Return joints by name (n,), NaN where a grasp lacks one."""
    found: dict[str, Floats] = {}
    for place, (name, grasp) in enumerate(grasps.items()):
        positions = grasp.get(key, {}) if isinstance(grasp, dict) else {}
        if not isinstance(positions, dict):
            raise UnreadableGrasps(path, f"{name}: {key} must hold joints by name")
        for joint, value in positions.items():
            if joint not in found:
                if len(found) == MOST_JOINTS:
                    raise UnreadableGrasps(path, f"{name}: {key}: there are more than {MOST_JOINTS} joints")
                found[joint] = np.full(len(grasps), np.nan)
            (found[joint][place],) = _numbers(path, (name, key, joint), [value], 1)
    return found


def _numbers(path: Path, what: tuple[str, ...], values: Tree | None, count: int) -> list[float]:
    """Convert words to `count` numbers; the keys `what` name them in errors."""
    if isinstance(values, list) and len(values) == count:
        try:
            return [float(value) for value in values]  # type: ignore[arg-type]  # what is no word is no number
        except (ValueError, TypeError):
            pass
    wanted = "a number" if count == 1 else f"{count} numbers"
    raise UnreadableGrasps(path, f"{': '.join(what)} must be {wanted}")


HEADER = "{{stamp: {{sec: 0, nanosec: 0}}, frame_id: {}}}"


def write_moveit(path: Path, grasps: Grasps, metadata: GraspMetadata) -> None:
    """Write grasps as a YAML list of MoveIt's messages."""
    with path.open("w", encoding="utf-8") as file:
        file.write(yaml_block({"qdgrasp": metadata.values}))
        file.writelines(_extra_lines(grasps, metadata.frame))
        poses = [f"[{', '.join(pose)}]" for pose in table_decimals(grasps.settled_poses(metadata.frame))]
        file.write(f"    settled_poses: [{', '.join(poses)}]\n")
        file.write("grasps:\n")
        file.writelines(_messages(grasps, metadata))


def _messages(grasps: Grasps, metadata: GraspMetadata) -> Iterator[str]:
    names = ", ".join(map(_quoted, grasps.joint_names))
    moves = _moves(grasps)
    object_frame, touched = HEADER.format(_quoted(metadata.object)), _quoted(metadata.object)
    for number, quality, (_, closed), (pose, start) in grasp_decimals(grasps, metadata.frame):
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
    """Write approach and retreats: as looked at, or the hand's reach and its stand-off."""
    hand, check = grasps.scene.gripper, grasps.approach
    way = check.distance if check and check.distance else hand.reach
    header = HEADER.format(_quoted(hand.base_link))
    lines = ""
    for name, sign in (("pre_grasp_approach", 1), ("post_grasp_retreat", -1), ("post_place_retreat", -1)):
        ((x, y, z),) = table_decimals(sign * np.array([hand.approach_axis]) + 0.0)
        lines += (
            f"  {name}: {{direction: {{header: {header}, vector: {{x: {x}, y: {y}, z: {z}}}}}, "
            f"desired_distance: {way:.6f}, min_distance: {min(way, hand.standoff[1]):.6f}}}\n"
        )
    return lines


def _quoted(name: str) -> str:
    return json.dumps(name, ensure_ascii=False)
