"""Readers of files of grasps from public descriptions, sharing nothing with the writers."""

import csv
import json
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import pandas
import yaml
from scipy.spatial.transform import Rotation


class Read(NamedTuple):
    matrices: np.ndarray
    quality: np.ndarray
    beside: Any


def isaac(path: Path) -> Read:
    """Isaac Sim, "Grasp Editor": position and orientation {w, xyz}, object's frame."""
    told = yaml.safe_load(path.read_text())
    assert told["format"] == "isaac_grasp"
    assert told["format_version"] == 1.0
    grasps = list(told["grasps"].values())
    turns = [[*each["orientation"]["xyz"], each["orientation"]["w"]] for each in grasps]
    matrices = homogeneous([each["position"] for each in grasps], turns)
    return Read(matrices, np.array([each["confidence"] for each in grasps]), told)


POSTURES = ("grasps/joint_positions", "grasps/pregrasp_joint_positions")
OBJECT = ("scale", "mass", "density", "volume", "friction", "com", "inertia")


def acronym(path: Path) -> Read:
    """ACRONYM: `grasps/transforms` and the bits of its simulation, as its own tools load them."""
    with h5py.File(path) as file:
        beside = {
            "file": file["object/file"][()].decode(),
            "type": file["gripper/type"][()].decode(),
            "joint_names": [name.decode() for name in file["gripper/joint_names"]],
            **{name: np.array(file[name]) for name in POSTURES},
            **{name: np.array(file[f"object/{name}"]) for name in OBJECT},
        }
        return Read(
            np.array(file["grasps/transforms"]),
            np.array(file["grasps/qualities/flex/object_in_gripper"]),
            beside,
        )


def graspgen(path: Path) -> Read:
    """GraspGen dataset format v1.0.0: an object of a split, found in the index, and its JSON."""
    (uuid,) = (path / "splits" / "train.txt").read_text().split()
    assert (path / "splits" / "valid.txt").read_text().split() == [uuid]
    index = json.loads((path / "grasp_data" / "map_uuid_to_path.json").read_text())
    told = json.loads((path / "grasp_data" / index[uuid]).read_text())
    assert told["object"]["file"] == uuid
    return Read(np.array(told["grasps"]["transforms"]), np.array(told["grasps"]["object_in_gripper"]), told)


def comma_separated(path: Path) -> Read:
    """RFC 4180, once the lines that begin with # are left out."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return table_read(pandas.DataFrame(rows))


def table_read(table: pandas.DataFrame) -> Read:
    numbers = table[["x", "y", "z", "qx", "qy", "qz", "qw", "confidence"]].astype(float).to_numpy()
    return Read(homogeneous(numbers[:, :3], numbers[:, 3:7]), numbers[:, 7], table)


HEADER = {"stamp": {"sec": int, "nanosec": int}, "frame_id": str}
POINT = {
    "positions": [float],
    "velocities": [float],
    "accelerations": [float],
    "effort": [float],
    "time_from_start": {"sec": int, "nanosec": int},
}
TRAJECTORY = {"header": HEADER, "joint_names": [str], "points": [POINT]}
XYZ = dict.fromkeys("xyz", float)
TRANSLATION = {
    "direction": {"header": HEADER, "vector": XYZ},
    "desired_distance": float,
    "min_distance": float,
}
GRASP = {
    "id": str,
    "pre_grasp_posture": TRAJECTORY,
    "grasp_posture": TRAJECTORY,
    "grasp_pose": {"header": HEADER, "pose": {"position": XYZ, "orientation": XYZ | {"w": float}}},
    "grasp_quality": float,
    "pre_grasp_approach": TRANSLATION,
    "post_grasp_retreat": TRANSLATION,
    "post_place_retreat": TRANSLATION,
    "max_contact_force": float,
    "allowed_touch_objects": [str],
}
"""moveit_msgs/msg/Grasp with the messages that it is made of."""


def moveit(path: Path) -> Read:
    """The messages, each checked against its definition."""
    told = yaml.safe_load(path.read_text())
    for message in told["grasps"]:
        check_message(message, GRASP)
    poses = [message["grasp_pose"]["pose"] for message in told["grasps"]]
    positions = [[pose["position"][axis] for axis in "xyz"] for pose in poses]
    turns = [[pose["orientation"][axis] for axis in "xyzw"] for pose in poses]
    quality = np.array([message["grasp_quality"] for message in told["grasps"]])
    return Read(homogeneous(positions, turns), quality, told)


def check_message(message: Any, definition: Any) -> None:
    """Every field of the definition is there and of its type, and no other."""
    if isinstance(definition, dict):
        assert set(message) == set(definition)
        for field, kind in definition.items():
            check_message(message[field], kind)
    elif isinstance(definition, list):
        assert isinstance(message, list)
        for item in message:
            check_message(item, definition[0])
    else:
        assert type(message) is definition, (message, definition)


def homogeneous(positions: Any, quaternions: Any) -> np.ndarray:
    """Positions (n, 3) and quaternions (n, 4), xyzw, as matrices (n, 4, 4)."""
    matrices = np.tile(np.eye(4), (len(positions), 1, 1))
    matrices[:, :3, :3] = Rotation.from_quat(quaternions).as_matrix()
    matrices[:, :3, 3] = positions
    return matrices


READERS = {
    "isaac": isaac,
    "acronym": acronym,
    "graspgen": graspgen,
    "parquet": lambda path: table_read(pandas.read_parquet(path)),
    "moveit": moveit,
    "csv": comma_separated,
}


def isaac_joints(told: Any, names: list[str]) -> list[np.ndarray]:
    return [
        np.array([[grasp[key][name] for name in names] for grasp in told["grasps"].values()])
        for key in ("cspace_position", "pregrasp_cspace_position")
    ]


def acronym_joints(told: Any, names: list[str]) -> list[np.ndarray]:
    places = [told["joint_names"].index(name) for name in names]
    return [told[key][:, places] for key in POSTURES]


def table_joints(told: pandas.DataFrame, names: list[str]) -> list[np.ndarray]:
    kinds = ("joint", "pregrasp")
    return [told[[f"{kind}.{name}" for name in names]].astype(float).to_numpy() for kind in kinds]


def moveit_joints(told: Any, names: list[str]) -> list[np.ndarray]:
    def positions(posture: Any) -> list[float]:
        (point,) = posture["points"]
        return [point["positions"][posture["joint_names"].index(name)] for name in names]

    kinds = ("grasp_posture", "pre_grasp_posture")
    return [np.array([positions(grasp[kind]) for grasp in told["grasps"]]) for kind in kinds]


JOINTS = {
    "isaac": isaac_joints,
    "acronym": acronym_joints,
    "parquet": table_joints,
    "moveit": moveit_joints,
    "csv": table_joints,
}
"""Joints by name at the grasp and before it, (n, k) each, of a reader's other findings."""
TURNED = {"acronym", "graspgen"}
"""Formats whose hand axes are +z towards the object and x across the jaw."""
