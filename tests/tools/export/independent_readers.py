"""Readers of every format by its own description, apart from the code that writes it."""

import csv
import io
import json
import tarfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import pandas
import pyarrow.parquet
import pytest
import trimesh
import yaml
from scipy.spatial.transform import Rotation


class Contact(NamedTuple):
    """A contact as a file has it: the hand's link; point, normal (3,) and force as one array (7,)."""

    link: str
    values: np.ndarray


@dataclass(frozen=True)
class Read:
    """The grasps of a file."""

    matrices: np.ndarray
    """(n, 4, 4): the commanded poses, which go with the open joints."""
    settled: np.ndarray
    """(n, 4, 4): the settled poses, which go with the joints after closing; NaN where there is none."""
    quality: np.ndarray
    joints: dict[str, np.ndarray]
    """(n,) each, by name, after closing."""
    starts: dict[str, np.ndarray]
    """(n,) each, before it."""
    squeeze: dict[str, np.ndarray]
    """(n,) each, targets that press."""
    penetration: np.ndarray
    about: Mapping[str, Any]
    """The metadata."""
    beside: Any
    """The file itself."""
    contacts: list[list[Contact] | None] | None = None
    """None: the format has no place for them."""


def homogeneous(poses: Any) -> np.ndarray:
    """Poses (n, 7), xyz and xyzw, as matrices (n, 4, 4); NaN where one is."""
    poses = np.asarray(poses, dtype=float)
    matrices = np.tile(np.eye(4), (len(poses), 1, 1))
    known = ~np.isnan(poses).any(axis=1)
    matrices[known, :3, :3] = Rotation.from_quat(poses[known, 3:]).as_matrix()
    matrices[:, :3, 3] = poses[:, :3]
    matrices[~known] = np.nan
    return matrices


def columns(names: Iterable[str], values: Any) -> dict[str, np.ndarray]:
    """Columns of (n, j) by name."""
    return dict(zip(names, np.asarray(values, dtype=float).T, strict=True))


def isaac(path: Path) -> Read:
    """Isaac Sim, "Grasp Editor": position and orientation {w, xyz}, object's frame."""
    file = yaml.safe_load(path.read_text())
    assert (file["format"], file["format_version"]) == ("isaac_grasp", 1.0)
    grasps = list(file["grasps"].values())

    def poses(kind: str) -> np.ndarray:
        turns = [grasp[f"{kind}orientation"] for grasp in grasps]
        places = [grasp[f"{kind}position"] for grasp in grasps]
        return homogeneous([[*p, *turn["xyz"], turn["w"]] for p, turn in zip(places, turns, strict=True)])

    def joints(kind: str) -> dict[str, np.ndarray]:
        table = pandas.DataFrame([grasp[f"{kind}cspace_position"] for grasp in grasps])
        return {name: table[name].to_numpy() for name in table}

    return Read(
        poses("pregrasp_"),
        poses(""),
        np.array([grasp["confidence"] for grasp in grasps]),
        joints(""),
        joints("pregrasp_"),
        joints("squeeze_"),
        np.array(file["qdgrasp"]["grasps"]["penetration"]),
        file["qdgrasp"],
        file,
    )


def acronym(path: Path) -> Read:
    """ACRONYM: `grasps/transforms` and the bits of its simulation, as its own tools load them."""
    with h5py.File(path) as file:
        every = dict[str, np.ndarray]()
        file.visititems(
            lambda name, item: every.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None
        )
        attributes = dict(file["qdgrasp"].attrs)
    names = [name.decode() for name in every["gripper/joint_names"]]
    links = [name.decode() for name in every["gripper/link_names"]]
    numbers = [every[f"qdgrasp/contact_{kind}"] for kind in ("points", "normals", "forces")]
    return Read(
        every["grasps/transforms"],
        every["grasps/settled_transforms"],
        every["grasps/qualities/flex/object_in_gripper"],
        columns(names, every["grasps/joint_positions"]),
        columns(names, every["grasps/pregrasp_joint_positions"]),
        columns(names, every["grasps/squeeze_joint_positions"]),
        every["qdgrasp/penetration"],
        attributes | {"runs": json.loads(every["qdgrasp/about"])["runs"]},
        every,
        slots(links, every["qdgrasp/contact_links"], *numbers),
    )


def slots(links: Any, places: Any, points: Any, normals: Any, forces: Any) -> list[list[Contact] | None]:
    """Contacts in slots, of which those with link -1 are empty."""
    values = np.concatenate([points, normals, forces[..., None]], axis=2)
    return [
        [Contact(links[link], each) for link, each in zip(*row, strict=True) if link >= 0]
        for row in zip(places, values, strict=True)
    ]


def mappings(lists: Iterable[Any]) -> list[list[Contact] | None]:
    """Contacts from lists of mappings, or of nothing."""
    keys = ("x", "y", "z", "nx", "ny", "nz", "force")
    return [
        None if each is None else [Contact(one["link"], np.array([one[key] for key in keys])) for one in each]
        for each in lists
    ]


def graspgen(path: Path) -> Read:
    """GraspGen dataset format v1.0.0: an object of a split, found in the index, and its JSON."""
    (uuid,) = (path / "splits" / "train.txt").read_text().split()
    assert (path / "splits" / "valid.txt").read_text().split() == [uuid]
    index, meshes = (
        json.loads((path / folder / "map_uuid_to_path.json").read_text())
        for folder in ("grasp_data", "object_data")
    )
    file = json.loads((path / "grasp_data" / index[uuid]).read_text())
    assert file["object"]["file"] == meshes[uuid]
    ours, names = file["qdgrasp"]["grasps"], file["qdgrasp"]["joint_names"]
    return Read(
        np.array(file["grasps"]["transforms"]),
        np.array([np.full((4, 4), np.nan) if each is None else each for each in ours["settled_transforms"]]),
        np.array(file["grasps"]["object_in_gripper"]),
        columns(names, ours["joint_positions"]),
        columns(names, ours["pregrasp_joint_positions"]),
        columns(names, ours["squeeze_joint_positions"]),
        np.array(ours["penetration"]),
        file["qdgrasp"],
        file,
        mappings(ours["contacts"]),
    )


def graspgen_shards(path: Path) -> dict[str, Any]:
    """GraspGen's reader of WebDataset shards: objects by uuid, with the JSON of each."""
    webdataset = pytest.importorskip("webdataset", reason="its own reader is not installed")
    found = {}
    for uuid, shard in json.loads((path / "uuid_index.json").read_text()).items():
        samples = webdataset.WebDataset(str(path / f"shard_{shard:03d}.tar"), shardshuffle=False)
        (found[uuid],) = (json.loads(each["grasps.json"]) for each in samples if each["__key__"] == uuid)
    return found


def graspgen_contacts(file: Any) -> tuple[np.ndarray, np.ndarray]:
    """Its grasps that hold and have two contacts: transforms (n, 4, 4) and contacts (n, 2, 3)."""
    holds = np.array(file["grasps"]["object_in_gripper"])
    contacts = np.array(file["grasps"]["contact_locations"])[holds]
    known = ~np.isnan(contacts).any(axis=(1, 2))
    return np.array(file["grasps"]["transforms"])[holds][known], contacts[known]


def acronym_mesh(path: Path) -> trimesh.Trimesh:
    """ACRONYM's own tools: the file that `object/file` names below a root, times `object/scale`."""
    with h5py.File(path) as file:
        name, scale = file["object/file"][()].decode(), file["object/scale"][()]
    return trimesh.load_mesh(path.parent / name).apply_scale(scale)


def graspdatagen(path: Path) -> dict[str, Any]:
    """GraspDataGen's converter of Isaac YAML into JSON of GraspGen: the keys that it reads."""
    file = yaml.safe_load(path.read_text())
    poses = [
        [*e["position"], *e["orientation"]["xyz"], e["orientation"]["w"]] for e in file["grasps"].values()
    ]
    return {
        "object": {"file": file["object_file"], "scale": file["object_scale"]},
        "gripper": file["gripper_file"],
        "transforms": homogeneous(poses),
        "object_in_gripper": [each["confidence"] > 0.0 for each in file["grasps"].values()],
    }


def table_read(table: pandas.DataFrame, about: Mapping[str, Any], contacts: Any = None) -> Read:
    """A table with a line for each grasp."""

    def numbers(name: str) -> np.ndarray:
        return table[name].replace("", np.nan).astype(float).to_numpy()

    axes = ("x", "y", "z", "qx", "qy", "qz", "qw")
    settled = np.column_stack([numbers(f"settled_{axis}") for axis in axes])
    return Read(
        homogeneous(np.column_stack([numbers(axis) for axis in axes])),
        homogeneous(settled),
        numbers("confidence"),
        *(
            {name.removeprefix(begin): numbers(name) for name in table if name.startswith(begin)}
            for begin in ("joint.", "pregrasp.", "squeeze.")
        ),
        numbers("penetration"),
        about,
        table,
        contacts,
    )


def comma_separated(path: Path) -> Read:
    """RFC 4180, once the lines that begin with # are left out."""
    text = path.read_text()
    head = [line[2:].rstrip() for line in text.splitlines() if line.startswith("# ")]
    about = dict(line.split(": ", 1) for line in head if ": " in line)
    rows = csv.DictReader(line for line in io.StringIO(text, newline="") if not line.startswith("#"))
    return table_read(pandas.DataFrame(list(rows)), about)


def parquet(path: Path) -> Read:
    """Parquet with metadata in its schema."""
    about = json.loads(pyarrow.parquet.read_schema(path).metadata[b"qdgrasp"])
    table = pandas.read_parquet(path)
    return table_read(table, about, mappings(table["contact_points"]))


def webdataset(path: Path) -> Read:
    """WebDataset: members of a tar, grouped to samples by what stands before the first point."""
    samples: dict[str, dict[str, Any]] = {}
    with tarfile.open(path) as tar:
        about = json.loads(tar.pax_headers["qdgrasp"])
        for member in tar:
            key, _, suffix = member.name.partition(".")
            samples.setdefault(key, {})[suffix] = tar.extractfile(member).read()
    table = pandas.DataFrame([json.loads(sample["json"]) for sample in samples.values()])
    arrays = [np.load(io.BytesIO(sample["contacts.npy"]), allow_pickle=False) for sample in samples.values()]
    links, points, normals, forces = np.split(np.array(arrays), (1, 4, 7), axis=2)
    places = links[..., 0].astype(int)
    return table_read(table, about, slots(about["links"], places, points, normals, forces[..., 0]))


HEADER = {"stamp": {"sec": int, "nanosec": int}, "frame_id": str}
POINT = {
    **{key: [float] for key in ("positions", "velocities", "accelerations", "effort")},
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
    **dict.fromkeys(("pre_grasp_approach", "post_grasp_retreat", "post_place_retreat"), TRANSLATION),
    "max_contact_force": float,
    "allowed_touch_objects": [str],
}
"""moveit_msgs/msg/Grasp with the messages that it is made of."""


def moveit(path: Path) -> Read:
    """The messages, each checked against its definition."""
    file = yaml.safe_load(path.read_text())
    messages, ours = file["grasps"], file["qdgrasp"]["grasps"]
    for message in messages:
        check_message(message, GRASP)
    poses = [message["grasp_pose"]["pose"] for message in messages]

    def joints(kind: str) -> dict[str, np.ndarray]:
        postures = [message[kind] for message in messages]
        return columns(postures[0]["joint_names"], [each["points"][0]["positions"] for each in postures])

    return Read(
        homogeneous([[*each["position"].values(), *each["orientation"].values()] for each in poses]),
        homogeneous(ours["settled_poses"]),
        np.array([message["grasp_quality"] for message in messages]),
        joints("grasp_posture"),
        joints("pre_grasp_posture"),
        columns(messages[0]["grasp_posture"]["joint_names"], ours["squeeze_positions"]),
        np.array(ours["penetration"]),
        file["qdgrasp"],
        file,
    )


def check_message(message: Any, definition: Any) -> None:
    """Check that every field of the definition is there and of its type, and no other."""
    if isinstance(definition, dict):
        assert list(message) == list(definition)
        for field, kind in definition.items():
            check_message(message[field], kind)
    elif isinstance(definition, list):
        for item in message:
            check_message(item, definition[0])
    else:
        assert type(message) is definition, (message, definition)


def dexgraspbench(path: Path) -> Read:
    """DexGraspBench: each `.npy` below a folder is a dict, as its evaluator takes it."""
    about = json.loads((path / "qdgrasp.json").read_text())
    found = [np.load(path / "graspdata" / about["object"] / f"{number}.npy", allow_pickle=True).item()
             for number in about["grasps"]["number"]]  # fmt: skip
    assert len(list(path.glob("graspdata/**/*.npy"))) == len(found)
    for grasp in found:
        assert (grasp["obj_scale"], grasp["obj_pose"].tolist()) == (1.0, [0, 0, 0, 1, 0, 0, 0])
        facts = json.loads((path / grasp["obj_path"] / "info/simplified.json").read_text())
        parts = [trimesh.load_mesh(part) for part in (path / grasp["obj_path"]).glob("urdf/meshes/*.obj")]
        volume = facts["mass"] / (facts["density"] * facts["scale"] ** 3)
        np.testing.assert_allclose(volume, sum(part.volume for part in parts), rtol=1e-6)
    kinds = ("pregrasp", "grasp", "squeeze")
    qpos = {kind: np.array([grasp[f"{kind}_qpos"] for grasp in found]) for kind in kinds}
    poses = {kind: homogeneous(values[:, [0, 1, 2, 4, 5, 6, 3]]) for kind, values in qpos.items()}
    np.testing.assert_array_equal(poses["squeeze"], poses["grasp"])
    joints = {kind: columns(about["joint_order"], values[:, 7:]) for kind, values in qpos.items()}
    lists = about["grasps"]
    starts = {name: np.array(lists[f"pregrasp.{name}"]) for name in about["joint_order"]}
    np.testing.assert_array_equal(poses["pregrasp"], poses["grasp"])
    for name, start in starts.items():
        way = start - joints["grasp"][name]
        np.testing.assert_allclose(
            joints["pregrasp"][name], joints["grasp"][name] + way.clip(-0.1, 0.1), atol=1e-7
        )
    return Read(
        homogeneous(np.transpose([lists[axis] for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")])),
        poses["grasp"],
        np.array(lists["confidence"]),
        joints["grasp"],
        starts,
        joints["squeeze"],
        np.array(lists["penetration"]),
        about,
        found,
    )


def arrays(path: Path, *names: str) -> tuple[Read, list[np.ndarray]]:
    """An npz of columns: what a table reads of it, and arrays of other shapes."""
    with np.load(path, allow_pickle=False) as file:
        every = {name: file[name] for name in file.files}
    about, others = json.loads(str(every.pop("qdgrasp"))), [every.pop(name) for name in names]
    return table_read(pandas.DataFrame(every), about), others


def molmospaces(path: Path) -> Read:
    """MolmoSpaces: `transforms` of the frame between the fingertips, +z forward, fingers along y.

    The made hand opens along y and approaches along z, as this frame does, whose origin is 0.101 m along z.
    """
    read, (transforms,) = arrays(path, "transforms")
    back = np.eye(4)
    back[2, 3] = -0.101
    return replace(read, matrices=transforms @ back, beside=transforms)


def curobo(path: Path) -> Read:
    """cuRobo: a `GoalToolPose` [batch, horizon, links, goals, 3 or 4], quaternions wxyz, float32."""
    read, (frames, position, quaternion) = arrays(path, "tool_frames", "position", "quaternion")
    goals = len(read.quality)
    assert frames.tolist() == [read.about["gripper_frame"]]
    assert (position.shape, quaternion.shape) == ((1, 1, 1, goals, 3), (1, 1, 1, goals, 4))
    poses = np.hstack([position[0, 0, 0], np.roll(quaternion[0, 0, 0], -1, axis=1)])
    return replace(read, matrices=homogeneous(poses), beside=position)


READERS = {
    "dexgraspbench": dexgraspbench,
    "molmospaces": molmospaces,
    "curobo": curobo,
    "isaac": isaac,
    "acronym": acronym,
    "graspgen": graspgen,
    "parquet": parquet,
    "webdataset": webdataset,
    "moveit": moveit,
    "csv": comma_separated,
}
TURNED = {"acronym", "graspgen"}
"""Formats whose hand axes are +z towards the object and x across the jaw."""
