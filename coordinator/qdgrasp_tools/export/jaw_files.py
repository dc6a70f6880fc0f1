"""ACRONYM and GraspGen: matrices with axes of a jaw, +z toward the object, x across.

ACRONYM HDF5: Eppner et al. 2021, "ACRONYM: A Large-Scale Grasp Dataset Based on Simulation", and the data's
own keys. In its simulation an open gripper closed at a transform, and the motion of the object meanwhile was
recorded: `grasps/transforms` are the commanded poses. `object/file` and `object/scale` are those of a mesh
that lies beside the file. Joints, synergies, settled poses and the group `qdgrasp` are datasets of our own,
which other readers pass over; `grasps/contact_points` are what trainers for jaws add to such files.

GraspGen: "GraspGen Grasp Dataset Format" and "GraspGen Gripper Description", v1.0.0. The folder has

* `grasp_data/NAME.json`             transforms, bits and metadata
* `grasp_data/map_uuid_to_path.json` which object is in which file
* `splits/train.txt`, `valid.txt`    the object, in both: there is one
* `object_data/NAME.obj`             its mesh, in metres, in the frame of the transforms
* `object_data/map_uuid_to_path.json` which object has which mesh
* `grasp_shards`                     the same JSON in tar files, as `GraspWebDatasetReader` takes them

A WebDataset's keys end at a point, so objects are called by their names without any (`_uuid`).
"""

import json
import tarfile
from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from qdgrasp_assets.geometry.mesh import parts_to_obj
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.scene import SceneGripper, SceneObject
from qdgrasp_protocol.text import join_numbers
from qdgrasp_tools.export.grasp_set import Grasps
from qdgrasp_tools.export.grasp_table import (
    MATRIX_WORDS,
    Frame,
    GraspMetadata,
    GraspTable,
    check_matrices,
    from_matrices,
    jaw_turn,
    object_mesh,
    to_matrices,
    turn_hand_axes,
)
from qdgrasp_tools.export.tabular import add_member

TRANSFORMS = "grasps/transforms"
SUCCESSES = "grasps/qualities/flex/object_in_gripper"
MOTION = "grasps/qualities/flex/object_motion_during_closing"
JOINTS, SYNERGIES = "gripper/joint_names", "gripper/synergy_names"
STARTS, SYNERGY = "grasps/pregrasp_joint_positions", "grasps/synergy"
OWN_COLUMNS = ("fitness", "eta", "trials", "penetration", "margin", "width", "grip_force")
CONFIDENCE, NUMBERS, ABOUT = "grasps/confidence", "qdgrasp/number", "qdgrasp/about"


def mesh_beside(path: Path) -> Path:
    """Return where the mesh of a file of grasps lies."""
    return path.with_name(f"{path.stem}-object.obj")


def mesh_file(body: SceneObject, frame: Frame) -> bytes:
    """Return the surface of an object, in metres in one of its frames, as an OBJ file."""
    return parts_to_obj([object_mesh(body, frame)])


def jaw_matrices(hand: SceneGripper, poses: Floats) -> Floats:
    """Return poses (n, 7) of a root link as matrices (n, 4, 4) of the turned axes; NaN stays."""
    known = ~np.isnan(poses[:, 0])
    matrices = np.full((len(poses), 4, 4), np.nan)
    matrices[known] = to_matrices(turn_hand_axes(poses[known], jaw_turn(hand)))
    return matrices


def jaw_metadata(hand: SceneGripper, about: GraspMetadata) -> GraspMetadata:
    """Return metadata with a description of the turned axes."""
    across = (
        f"x from one finger to the other, along ({join_numbers(hand.jaw.axis)}) of it"
        if hand.jaw
        else "x at right angles to it, for the hand has no jaw"
    )
    turn = ", ".join(f"{value:.9g}" for value in jaw_turn(hand) + 0.0)
    words = (
        f"origin of link '{hand.base_link}'; +z approaches, along ({join_numbers(hand.approach_axis)}) "
        f"of the link; {across}: link axes turned by the quaternion (x, y, z, w) = ({turn})"
    )
    return msgspec.structs.replace(about, gripper_axes=words, quaternions=MATRIX_WORDS)


def write_acronym(path: Path, grasps: Grasps, about: GraspMetadata) -> None:
    """Write grasps as an ACRONYM file."""
    import h5py

    about = jaw_metadata(grasps.scene.gripper, about)
    with h5py.File(path, "w") as file:
        for name, value in _datasets(grasps, about).items():
            file[name] = value
        file["object/file"] = mesh_beside(path).name
        file[ABOUT] = about.json
        for name, value in about.values.items():
            if name not in ("runs", "resting_poses"):  # HDF5 has no nested attributes
                file["qdgrasp"].attrs[name] = json.dumps(value) if isinstance(value, dict) else value


def _datasets(grasps: Grasps, about: GraspMetadata) -> dict[str, Any]:
    contacts, columns = grasps.contacts_in(about.frame), grasps.columns(about.frame)
    hand, body = grasps.scene.gripper, object_mesh(grasps.scene.object, about.frame)
    postures = grasps.postures
    found = {
        "object/scale": 1.0,
        "object/mass": about.object_mass,
        "object/density": about.object_mass / body.volume,
        "object/friction": about.object_friction,
        "object/volume": body.volume,
        "object/com": np.array(about.object_com),
        "object/inertia": about.object_mass * body.inertia,
        TRANSFORMS: jaw_matrices(hand, grasps.poses(about.frame)),
        "grasps/settled_transforms": jaw_matrices(hand, grasps.recorded_poses(about.frame)),
        SUCCESSES: grasps.is_grasp.astype(np.int8),
        f"{MOTION}_linear": columns["motion_mm"] * 1e-3,
        f"{MOTION}_angular": np.radians(columns["motion_deg"]),
        CONFIDENCE: grasps.confidence,
        "grasps/joint_positions": postures.joints,
        STARTS: postures.pregrasp,
        "grasps/squeeze_joint_positions": postures.squeeze,
        SYNERGY: grasps.synergies,
        NUMBERS: columns["number"],
        **{f"qdgrasp/{name}": columns[name] for name in OWN_COLUMNS},
        "qdgrasp/outcome": columns["outcome"].tolist(),
        "qdgrasp/contact_links": contacts.links.astype(np.int16) - 1,
        "qdgrasp/contact_points": contacts.points.astype(np.float32),
        "qdgrasp/contact_normals": contacts.normals.astype(np.float32),
        "qdgrasp/contact_forces": contacts.forces.astype(np.float32),
        "gripper/type": hand.name,
        "gripper/link_names": list(hand.links) or np.zeros(0, "S1"),
        JOINTS: list(postures.names),
        SYNERGIES: [synergy.name for synergy in hand.synergies] or np.zeros(0, "S1"),
    }
    if hand.jaw:
        found["gripper/configuration"] = np.array([hand.jaw.opening / 2])
        found["grasps/contact_points"] = contact_pairs(grasps, about.frame)
    if grasps.approach is not None:
        found["grasps/approach_transforms"] = jaw_matrices(hand, grasps.approach_poses(about.frame))
        found["grasps/approach_directions"] = np.column_stack([columns[f"approach_{axis}"] for axis in "xyz"])
        found["grasps/approach_clear"] = columns["approach_clear"].astype(np.int8)
    if about.resting_poses:
        numbers = [pose.number for pose in about.resting_poses]
        found["grasps/resting_poses"] = np.array(
            [[n in each for n in numbers] for each in grasps.resting_poses]
        )
        found["qdgrasp/resting_pose_numbers"] = np.array(numbers, dtype=np.int64)
        found["qdgrasp/resting_probability"] = columns["resting_probability"]
    return found


def read_acronym(path: Path) -> GraspTable:
    """Read the grasps in an ACRONYM file, of ours or of others."""
    import h5py

    with h5py.File(path) as file:
        matrices = check_matrices(path, np.array(file[TRANSFORMS], dtype=np.float64))
        quality = CONFIDENCE if CONFIDENCE in file else SUCCESSES
        numbers = {name: float(file[f"object/{name}"][()]) for name in ("scale", "mass", "friction")
                   if f"object/{name}" in file}  # fmt: skip
        synergies = None
        if SYNERGY in file:
            names = np.array([*file[SYNERGIES].asstr()[()], ""], dtype=str)
            synergies = names[np.array(file[SYNERGY], dtype=np.int64)]
        table = GraspTable(
            names=np.array(file[NUMBERS] if NUMBERS in file else np.arange(len(matrices))).astype(str),
            poses=from_matrices(matrices),
            has_jaw_axes=True,
            gripper=file["gripper/type"].asstr()[()] if "gripper/type" in file else None,
            joint_names=tuple(file[JOINTS].asstr()[()]) if STARTS in file else (),
            pregrasp=np.array(file[STARTS], dtype=np.float64) if STARTS in file else None,
            synergies=synergies,
            confidence=np.array(file[quality], dtype=np.float64) if quality in file else None,
            scale=numbers.get("scale"),
            mass=numbers.get("mass"),
            friction=numbers.get("friction"),
        )
        about = file[ABOUT].asstr()[()] if ABOUT in file else None
    return table if about is None else table.with_metadata(msgspec.json.decode(about, type=GraspMetadata))


INDEX_FILE, SHARD_INDEX = "map_uuid_to_path.json", "uuid_index.json"
DATA, SPLITS, OBJECTS, SHARDS = "grasp_data", "splits", "object_data", "grasp_shards"
FOLDERS = {DATA, SPLITS, OBJECTS, SHARDS}
SHARD_OBJECTS = 32  # Objects in a shard, which its reader goes through from the beginning for each
BASE_OFFSET = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
"""Offset of GraspGen's axes from those of the transforms, xyz [m] and xyzw: zero."""


def write_graspgen(path: Path, grasps: Grasps, about: GraspMetadata) -> None:
    """Write grasps and failures as a GraspGen folder."""
    path.mkdir(parents=True)
    write_graspgen_object(path, about.object, grasps, about)
    write_graspgen_index(path, {about.object: ("train", "valid")})


def write_graspgen_object(path: Path, name: str, grasps: Grasps, about: GraspMetadata) -> None:
    """Write the JSON and the mesh of one object into a folder."""
    lists, ours = _lists(grasps, about)
    beside = {
        "transform_offset_from_asset_to_graspgen_convention": BASE_OFFSET,
        "joint_names": grasps.postures.names,
        "grasps": ours,
    }
    whole = {
        "object": {"file": f"{name}.obj", "scale": 1.0},
        "grasps": lists,
        "qdgrasp": jaw_metadata(grasps.scene.gripper, about).values | beside,
    }
    for folder in (DATA, OBJECTS):
        (path / folder).mkdir(exist_ok=True)
    (path / DATA / f"{name}.json").write_bytes(msgspec.json.encode(whole))
    (path / OBJECTS / f"{name}.obj").write_bytes(mesh_file(grasps.scene.object, about.frame))


def write_graspgen_index(path: Path, objects: Mapping[str, Iterable[str]]) -> None:
    """Write the lists and shards of a folder: objects with the splits that they are in."""
    for folder in (SPLITS, SHARDS):
        (path / folder).mkdir(exist_ok=True)
    for folder, end in ((DATA, "json"), (OBJECTS, "obj")):
        files = {_uuid(name): f"{name}.{end}" for name in objects}
        (path / folder / INDEX_FILE).write_bytes(msgspec.json.encode(files))
    for split in sorted({"train", "valid"}.union(*objects.values())):
        names = [f"{_uuid(name)}\n" for name, splits in objects.items() if split in splits]
        (path / SPLITS / f"{split}.txt").write_text("".join(names), encoding="utf-8")
    shards = {name: place // SHARD_OBJECTS for place, name in enumerate(objects)}
    index = {_uuid(name): shard for name, shard in shards.items()}
    (path / SHARDS / SHARD_INDEX).write_bytes(msgspec.json.encode(index))
    for shard, some in groupby(shards, shards.__getitem__):
        with tarfile.open(path / SHARDS / f"shard_{shard:03}.tar", "w") as tar:
            for name in some:
                add_member(tar, f"{_uuid(name)}.grasps.json", (path / DATA / f"{name}.json").read_bytes())


def _uuid(name: str) -> str:
    """Return an object's name without points."""
    return name.replace(".", "%2E")


def _lists(grasps: Grasps, about: GraspMetadata) -> tuple[dict[str, Any], dict[str, list[Any]]]:
    """Return the format's lists and ours, with an item for each grasp."""
    hand, postures = grasps.scene.gripper, grasps.postures
    columns = grasps.columns(about.frame)
    settled = jaw_matrices(hand, grasps.recorded_poses(about.frame)).tolist()
    ours: dict[str, list[Any]] = {
        **{name: columns[name].tolist() for name in ("number", *OWN_COLUMNS)},
        "joint_positions": postures.joints.tolist(),
        "pregrasp_joint_positions": postures.pregrasp.tolist(),
        "squeeze_joint_positions": postures.squeeze.tolist(),
        "synergy": grasps.synergy_words.tolist(),
        "settled_transforms": [
            pose if known else None for pose, known in zip(settled, grasps.is_settled, strict=True)
        ],
        "contacts": grasps.contact_lists(about.frame),
    }
    if grasps.approach is not None:
        ours["approach_transforms"] = jaw_matrices(hand, grasps.approach_poses(about.frame)).tolist()
        ours["approach_clear"] = (columns["approach_clear"] == 1).tolist()
    if about.resting_poses:
        ours["resting_poses"] = grasps.resting_poses
        ours["resting_probability"] = columns["resting_probability"].tolist()
    poses = jaw_matrices(hand, grasps.poses(about.frame)).tolist()
    lists = {"transforms": poses, "object_in_gripper": grasps.is_grasp.tolist()}
    if hand.jaw and grasps.scene.contact_slots:
        pairs = contact_pairs(grasps, about.frame).tolist()
        lists["contact_locations"] = msgspec.Raw(json.dumps(pairs).encode())  # NaN: its reader knows it
    return lists, ours


def contact_pairs(grasps: Grasps, frame: Frame) -> Floats:
    """Return the strongest contacts (n, 2, 3) of both fingers of a jaw [m].

    First is that at -x of the jaw's axes. NaN: a finger has none.
    """
    hand, (links, points, normals, forces) = grasps.scene.gripper, grasps.contacts_in(frame)
    across = jaw_matrices(hand, grasps.recorded_poses(frame))[:, None, :3, 0]
    fingers = [place for place, name in enumerate(hand.links, 1) if name in hand.finger_links]
    sides = np.where(np.isin(links, fingers), (normals * across).sum(axis=2), 0.0)
    pairs = np.full((len(links), 2, 3), np.nan)
    for finger, sense in enumerate((1.0, -1.0)):
        pressing = np.where(sense * sides > 0.0, forces, -1.0)
        for grasp in np.flatnonzero((pressing >= 0.0).any(axis=1)):
            pairs[grasp, finger] = points[grasp, pressing[grasp].argmax()]
    return pairs


def read_json(path: Path) -> GraspTable:
    """Read the grasps in a JSON file of GraspGen, or the flat one of ACRONYM."""
    file = json.loads(path.read_bytes())
    grasps, ours = file.get("grasps", file), file.get("qdgrasp")
    scale = file["object"].get("scale") if "grasps" in file else file.get("object_scale")
    quality = grasps.get("object_in_gripper", file.get("quality_flex_object_in_gripper"))
    transforms = np.array(grasps["transforms"] or np.zeros((0, 4, 4)), dtype=np.float64)
    matrices = check_matrices(path, transforms)
    table = GraspTable(
        names=np.arange(len(matrices)).astype(str),
        poses=from_matrices(matrices),
        has_jaw_axes=True,
        confidence=None if quality is None else np.array(quality, dtype=np.float64),
        scale=scale,
    )
    if ours is None:
        return table
    lists = ours["grasps"]
    return replace(
        table,
        names=np.array(lists["number"], dtype=np.int64).astype(str),
        joint_names=tuple(ours["joint_names"]),
        pregrasp=np.array(lists["pregrasp_joint_positions"], dtype=np.float64),
        synergies=np.array(lists["synergy"], dtype=str),
    ).with_metadata(msgspec.convert(ours, GraspMetadata))
