"""Readers of files of grasps from public descriptions, sharing nothing with the writers."""

import csv
import io
import json
import tarfile
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import pandas
import yaml
from scipy.spatial.transform import Rotation


class Contact(NamedTuple):
    """A contact as a file tells it: the hand's link, point and normal (3,), force."""

    link: str
    point: np.ndarray
    normal: np.ndarray
    force: float


class Read(NamedTuple):
    matrices: np.ndarray
    """(n, 4, 4): the commanded poses, which go with the open joints."""
    settled: np.ndarray
    """(n, 4, 4): the settled poses, which go with the joints after closing; NaN where there is none."""
    quality: np.ndarray
    beside: Any


def isaac(path: Path) -> Read:
    """Isaac Sim, "Grasp Editor": position and orientation {w, xyz}, object's frame."""
    told = yaml.safe_load(path.read_text())
    assert told["format"] == "isaac_grasp"
    assert told["format_version"] == 1.0
    grasps = list(told["grasps"].values())

    def poses(kind: str) -> np.ndarray:
        turns = [each[f"{kind}orientation"] for each in grasps]
        quaternions = [[*turn["xyz"], turn["w"]] for turn in turns]
        return homogeneous([each[f"{kind}position"] for each in grasps], quaternions)

    return Read(poses("pregrasp_"), poses(""), np.array([each["confidence"] for each in grasps]), told)


POSTURES = ("grasps/joint_positions", "grasps/pregrasp_joint_positions")
MOTION = tuple(f"grasps/qualities/flex/object_motion_during_closing_{kind}" for kind in ("linear", "angular"))
OBJECT = ("scale", "mass", "density", "volume", "friction", "com", "inertia")


def acronym(path: Path) -> Read:
    """ACRONYM: `grasps/transforms` and the bits of its simulation, as its own tools load them."""
    with h5py.File(path) as file:
        beside = {
            "file": file["object/file"][()].decode(),
            "type": file["gripper/type"][()].decode(),
            "joint_names": [name.decode() for name in file["gripper/joint_names"]],
            **{name: np.array(file[name]) for name in POSTURES + MOTION},
            "contacts": acronym_contacts(file),
            "penetration": np.array(file["qdgrasp/penetration"]),
            "axes": file["qdgrasp"].attrs["gripper_axes"],
            **{name: np.array(file[f"object/{name}"]) for name in OBJECT},
        }
        return Read(
            np.array(file["grasps/transforms"]),
            np.array(file["grasps/settled_transforms"]),
            np.array(file["grasps/qualities/flex/object_in_gripper"]),
            beside,
        )


def acronym_contacts(file: h5py.File) -> list[list[Contact]]:
    names = [name.decode() for name in file["gripper/link_names"]]
    links, *values = (
        np.array(file[f"grasps/contact_{kind}"]) for kind in ("links", "points", "normals", "forces")
    )
    return [
        [Contact(names[link], *each) for link, *each in zip(*slots, strict=True) if link >= 0]
        for slots in zip(links, *values, strict=True)
    ]


def contacts_of(lists: Any) -> list[list[Contact] | None]:
    """Contacts from lists of mappings, or of nothing."""
    return [
        None
        if each is None
        else [
            Contact(
                one["link"],
                np.array([one[axis] for axis in "xyz"]),
                np.array([one[f"n{axis}"] for axis in "xyz"]),
                one["force"],
            )
            for one in each
        ]
        for each in lists
    ]


def graspgen(path: Path) -> Read:
    """GraspGen dataset format v1.0.0: an object of a split, found in the index, and its JSON."""
    (uuid,) = (path / "splits" / "train.txt").read_text().split()
    assert (path / "splits" / "valid.txt").read_text().split() == [uuid]
    index = json.loads((path / "grasp_data" / "map_uuid_to_path.json").read_text())
    told = json.loads((path / "grasp_data" / index[uuid]).read_text())
    assert told["object"]["file"] == uuid
    settled = [np.full((4, 4), np.nan) if one is None else one for one in beside(told)["settled_transforms"]]
    return Read(
        np.array(told["grasps"]["transforms"]),
        np.array(settled),
        np.array(told["grasps"]["object_in_gripper"]),
        told,
    )


def beside(told: Any) -> Any:
    """The lists in the block `qdgrasp`."""
    return told["qdgrasp"]["grasps"]


def comma_separated(path: Path) -> Read:
    """RFC 4180, once the lines that begin with # are left out."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return table_read(pandas.DataFrame(rows))


def table_read(table: pandas.DataFrame) -> Read:
    axes = ["x", "y", "z", "qx", "qy", "qz", "qw"]
    poses, settled = (
        table[[f"{kind}{axis}" for axis in axes]].replace("", np.nan).astype(float).to_numpy()
        for kind in ("", "settled_")
    )
    quality = table["confidence"].astype(float).to_numpy()
    return Read(
        homogeneous(poses[:, :3], poses[:, 3:]), homogeneous(settled[:, :3], settled[:, 3:]), quality, table
    )


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
    settled = np.array(beside(told)["settled_poses"])
    poses = [message["grasp_pose"]["pose"] for message in told["grasps"]]
    positions = [[pose["position"][axis] for axis in "xyz"] for pose in poses]
    turns = [[pose["orientation"][axis] for axis in "xyzw"] for pose in poses]
    quality = np.array([message["grasp_quality"] for message in told["grasps"]])
    return Read(homogeneous(positions, turns), homogeneous(settled[:, :3], settled[:, 3:]), quality, told)


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
    """Positions (n, 3) and quaternions (n, 4), xyzw, as matrices (n, 4, 4); NaN where one is."""
    matrices = np.tile(np.eye(4), (len(positions), 1, 1))
    known = ~np.isnan(np.asarray(positions)).any(axis=1)
    matrices[known, :3, :3] = Rotation.from_quat(np.asarray(quaternions)[known]).as_matrix()
    matrices[:, :3, 3] = positions
    matrices[~known] = np.nan
    return matrices


def webdataset(path: Path) -> Read:
    """WebDataset: members of a tar, grouped to samples by what stands before the first point."""
    samples: dict[str, dict[str, Any]] = {}
    with tarfile.open(path) as tar:
        for member in tar:
            key, _, suffix = member.name.partition(".")
            samples.setdefault(key, {})[suffix] = tar.extractfile(member).read()
    columns, told = [], []
    for sample in samples.values():
        told.append(json.loads(sample["json"]))
        with np.load(io.BytesIO(sample["npz"]), allow_pickle=False) as arrays:
            columns.append({name: arrays[name] for name in arrays.files})
    every = {name: np.concatenate([each[name] for each in columns]) for name in columns[0]}
    table = pandas.DataFrame({name: values for name, values in every.items() if values.ndim == 1})
    table["contact_points"] = [
        [
            {"link": told[0]["links"][link]} | dict(zip(CONTACT, map(float, numbers), strict=True))
            for link, numbers in zip(links, slots, strict=True)
            if link >= 0
        ]
        for links, slots in zip(every["contact_links"], numbers_of(every), strict=True)
    ]
    table.attrs = told[0]
    return table_read(table)


CONTACT = ("x", "y", "z", "nx", "ny", "nz", "force")


def numbers_of(every: dict[str, np.ndarray]) -> np.ndarray:
    """Point, normal and force (n, k, 7) of each contact."""
    points, normals, forces = (every[f"contact_{kind}"] for kind in ("points", "normals", "forces"))
    return np.concatenate([points, normals, forces[..., None]], axis=2)


READERS = {
    "isaac": isaac,
    "acronym": acronym,
    "graspgen": graspgen,
    "parquet": lambda path: table_read(pandas.read_parquet(path)),
    "webdataset": webdataset,
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


def graspgen_joints(told: Any, names: list[str]) -> list[np.ndarray]:
    places = [told["qdgrasp"]["joint_names"].index(name) for name in names]
    kinds = ("joint_positions", "pregrasp_joint_positions")
    return [np.array(beside(told)[kind])[:, places] for kind in kinds]


JOINTS = {
    "graspgen": graspgen_joints,
    "isaac": isaac_joints,
    "acronym": acronym_joints,
    "parquet": table_joints,
    "webdataset": table_joints,
    "moveit": moveit_joints,
    "csv": table_joints,
}
"""Joints by name at the grasp and before it, (n, k) each, of a reader's other findings."""
PENETRATIONS = {
    "isaac": lambda told: beside(told)["penetration"],
    "acronym": lambda told: told["penetration"],
    "graspgen": lambda told: beside(told)["penetration"],
    "parquet": lambda told: told["penetration"].to_numpy(),
    "webdataset": lambda told: told["penetration"].to_numpy(),
    "moveit": lambda told: beside(told)["penetration"],
    "csv": lambda told: told["penetration"].astype(float).to_numpy(),
}
CONTACTS = {
    "acronym": lambda told: told["contacts"],
    "graspgen": lambda told: contacts_of(beside(told)["contacts"]),
    "parquet": lambda told: contacts_of(told["contact_points"]),
    "webdataset": lambda told: contacts_of(told["contact_points"]),
}
TURNED = {"acronym", "graspgen"}
"""Formats whose hand axes are +z towards the object and x across the jaw."""
