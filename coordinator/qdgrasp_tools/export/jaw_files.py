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
from qdgrasp_assets.scene import SceneObject
from qdgrasp_tools.export.grasp_table import (
    CONTACT_FIELDS,
    Frame,
    GraspMetadata,
    GraspTable,
    RunTable,
    check_matrices,
    from_matrices,
    object_mesh,
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


def write_acronym(path: Path, table: RunTable) -> None:
    """Write grasps as an ACRONYM file."""
    import h5py

    about = table.jaw_metadata
    with h5py.File(path, "w") as file:
        for name, value in _datasets(table).items():
            file[name] = value
        file["object/file"] = mesh_beside(path).name
        file[ABOUT] = about.json
        for name, value in about.values.items():
            if name not in ("runs", "resting_poses"):  # HDF5 has no nested attributes
                file["qdgrasp"].attrs[name] = json.dumps(value) if isinstance(value, dict) else value


def _datasets(table: RunTable) -> dict[str, Any]:
    contacts, about = table.contacts, table.about
    hand, body = table.scene.gripper, object_mesh(table.scene.object, table.frame)
    found = {
        "object/scale": 1.0,
        "object/mass": about.object_mass,
        "object/density": about.object_mass / body.volume,
        "object/friction": about.object_friction,
        "object/volume": body.volume,
        "object/com": np.array(about.object_com),
        "object/inertia": about.object_mass * body.inertia,
        TRANSFORMS: table.jaw_matrices(table.poses),
        "grasps/settled_transforms": table.jaw_matrices(table.settled),
        SUCCESSES: table.is_grasp.astype(np.int8),
        f"{MOTION}_linear": table["motion_mm"] * 1e-3,
        f"{MOTION}_angular": np.radians(table["motion_deg"]),
        CONFIDENCE: table.confidence,
        "grasps/joint_positions": table.joints,
        STARTS: table.pregrasp,
        "grasps/squeeze_joint_positions": table.squeeze,
        SYNERGY: table.synergy_labels,
        NUMBERS: table["number"],
        **{f"qdgrasp/{name}": table[name] for name in OWN_COLUMNS},
        "qdgrasp/outcome": table["outcome"].tolist(),
        "qdgrasp/contact_links": contacts.links.astype(np.int16) - 1,
        "qdgrasp/contact_points": contacts.points.astype(np.float32),
        "qdgrasp/contact_normals": contacts.normals.astype(np.float32),
        "qdgrasp/contact_forces": contacts.forces.astype(np.float32),
        "gripper/type": hand.name,
        "gripper/link_names": list(hand.links) or np.zeros(0, "S1"),
        JOINTS: list(table.joint_names),
        SYNERGIES: [synergy.name for synergy in hand.synergies] or np.zeros(0, "S1"),
    }
    if hand.jaw:
        found["gripper/configuration"] = np.array([hand.jaw.opening / 2])
        found["grasps/contact_points"] = contact_pairs(table)
    if table.approach is not None:
        found["grasps/approach_transforms"] = table.jaw_matrices(table.approach)
        found["grasps/approach_directions"] = np.column_stack([table[f"approach_{axis}"] for axis in "xyz"])
        found["grasps/approach_clear"] = table["approach_clear"].astype(np.int8)
    if table.resting_poses is not None:
        numbers = [pose.number for pose in about.resting_poses or ()]
        found["grasps/resting_poses"] = np.array(
            [[n in each for n in numbers] for each in table.resting_poses]
        )
        found["qdgrasp/resting_pose_numbers"] = np.array(numbers, dtype=np.int64)
        found["qdgrasp/resting_probability"] = table["resting_probability"]
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


def write_graspgen(path: Path, table: RunTable) -> None:
    """Write grasps and failures as a GraspGen folder."""
    path.mkdir(parents=True)
    write_graspgen_object(path, table.about.object, table)
    write_graspgen_index(path, {table.about.object: ("train", "valid")})


def write_graspgen_object(path: Path, name: str, table: RunTable) -> None:
    """Write the JSON and the mesh of one object into a folder."""
    grasps, ours = _lists(table)
    beside = {
        "transform_offset_from_asset_to_graspgen_convention": BASE_OFFSET,
        "joint_names": table.joint_names,
        "grasps": ours,
    }
    whole = {
        "object": {"file": f"{name}.obj", "scale": 1.0},
        "grasps": grasps,
        "qdgrasp": table.jaw_metadata.values | beside,
    }
    for folder in (DATA, OBJECTS):
        (path / folder).mkdir(exist_ok=True)
    (path / DATA / f"{name}.json").write_bytes(msgspec.json.encode(whole))
    (path / OBJECTS / f"{name}.obj").write_bytes(mesh_file(table.scene.object, table.frame))


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


def _lists(table: RunTable) -> tuple[dict[str, Any], dict[str, list[Any]]]:
    """Return the format's lists and ours, with an item for each grasp."""
    ours: dict[str, list[Any]] = {
        **{name: table[name].tolist() for name in ("number", *OWN_COLUMNS)},
        "joint_positions": table.joints.tolist(),
        "pregrasp_joint_positions": table.pregrasp.tolist(),
        "squeeze_joint_positions": table.squeeze.tolist(),
        "synergy": table.synergies.tolist(),
        "settled_transforms": _where_settled(table, table.jaw_matrices(table.settled).tolist()),
        "contacts": _where_settled(table, _contacts(table)),
    }
    if table.approach is not None:
        ours["approach_transforms"] = table.jaw_matrices(table.approach).tolist()
        ours["approach_clear"] = (table["approach_clear"] == 1).tolist()
    if table.resting_poses is not None:
        ours["resting_poses"] = table.resting_poses
        ours["resting_probability"] = table["resting_probability"].tolist()
    poses = table.jaw_matrices(table.poses).tolist()
    grasps = {"transforms": poses, "object_in_gripper": table.is_grasp.tolist()}
    if table.scene.gripper.jaw and table.scene.contact_slots:
        pairs = json.dumps(contact_pairs(table).tolist())  # with NaN, as its reader knows what is missing
        grasps["contact_locations"] = msgspec.Raw(pairs.encode())
    return grasps, ours


def contact_pairs(table: RunTable) -> Floats:
    """Return the strongest contacts (n, 2, 3) of both fingers of a jaw [m].

    First is that at -x of the jaw's axes. NaN: a finger has none.
    """
    links, points, normals, forces = table.contacts
    across = table.jaw_matrices(table.settled)[:, None, :3, 0]
    fingers = [place for place, name in enumerate(table.scene.gripper.links, 1)
               if name in table.scene.gripper.finger_links]  # fmt: skip
    sides = np.where(np.isin(links, fingers), (normals * across).sum(axis=2), 0.0)
    pairs = np.full((len(links), 2, 3), np.nan)
    for finger, sense in enumerate((1.0, -1.0)):
        pressing = np.where(sense * sides > 0.0, forces, -1.0)
        for grasp in np.flatnonzero((pressing >= 0.0).any(axis=1)):
            pairs[grasp, finger] = points[grasp, pressing[grasp].argmax()]
    return pairs


def _where_settled(table: RunTable, values: list[Any]) -> list[Any]:
    """Return values in the order of the grasps, None where nothing was recorded after closing."""
    return [value if known else None for value, known in zip(values, table.is_settled, strict=True)]


def _contacts(table: RunTable) -> list[list[dict[str, Any]]]:
    """Return the contacts of each grasp."""
    names = ("", *table.scene.gripper.links)
    return [
        [
            dict(zip(CONTACT_FIELDS, (names[link], *point, *normal, force), strict=True))
            for link, point, normal, force in zip(*(each.tolist() for each in slots), strict=True)
            if link
        ]
        for slots in zip(*table.contacts, strict=True)
    ]


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
