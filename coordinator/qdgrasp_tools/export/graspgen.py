"""GraspGen JSON: a folder to train from, with failures beside the grasps.

Public description: "GraspGen Grasp Dataset Format" and "GraspGen Gripper Description", v1.0.0. The folder has

* `grasp_data/NAME.json`             transforms, bits and metadata
* `grasp_data/map_uuid_to_path.json` which object is in which file
* `splits/train.txt`, `valid.txt`    the object, in both: there is one
* `object_data/NAME.obj`             its mesh, in metres, in the frame of the transforms
"""

import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Annotated, Any

import msgspec
import numpy as np
from msgspec import Struct

from qdgrasp_assets.geometry.mesh import parts_to_obj
from qdgrasp_tools.export.frames import Frame, from_matrices, object_solid
from qdgrasp_tools.export.grasp_reader import ChosenGrasps
from qdgrasp_tools.export.grasp_set import CONTACT_FIELDS, Grasps
from qdgrasp_tools.export.imported_grasps import (
    ImportedGrasps,
    UnreadableGrasps,
    check_matrices,
    decode_json,
    to_array,
    to_words,
)
from qdgrasp_tools.export.metadata import (
    GraspMetadata,
    jaw_metadata,
    jaw_transforms,
    settled_jaw_transforms,
)

INDEX_FILE = "map_uuid_to_path.json"
DATA, SPLITS, OBJECTS = "grasp_data", "splits", "object_data"
BASE_OFFSET = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
"""Offset of GraspGen's axes from those of the transforms, xyz [m] and xyzw: zero."""


def write(path: Path, chosen: ChosenGrasps, metadata: GraspMetadata) -> None:
    """Write grasps and failures as a GraspGen folder."""
    path.mkdir(parents=True)
    write_object(path, metadata.object, chosen, metadata)
    write_index(path, {metadata.object: ("train", "valid")})


def write_object(path: Path, name: str, chosen: ChosenGrasps, metadata: GraspMetadata) -> None:
    """Write the JSON and the mesh of one object into a folder, part by part."""
    for folder in (DATA, OBJECTS):
        (path / folder).mkdir(exist_ok=True)
    mesh = object_solid(chosen.scene.object, metadata.frame).mesh
    (path / OBJECTS / f"{name}.obj").write_bytes(parts_to_obj([mesh]))
    with ExitStack() as stack, (path / DATA / f"{name}.json").open("wb") as file:
        lists: dict[str, IO[bytes]] = {}
        for part in chosen:
            for key, values in _lists(part, metadata.frame).items():
                is_first = key not in lists
                if is_first:
                    lists[key] = stack.enter_context(TemporaryFile(dir=path))
                lists[key].write((b"" if is_first else b",") + msgspec.json.encode(values)[1:-1])
        _write_json(file, _values(f"{name}.obj", chosen, metadata), lists)


def write_index(path: Path, objects: Mapping[str, Iterable[str]]) -> None:
    """Write the lists of a folder: objects with the splits that they are in."""
    (path / SPLITS).mkdir(exist_ok=True)
    files = {f"{name}.obj": f"{name}.json" for name in objects}
    (path / DATA / INDEX_FILE).write_bytes(msgspec.json.encode(files))
    for split in sorted({"train", "valid"}.union(*objects.values())):
        names = [f"{name}.obj\n" for name, splits in objects.items() if split in splits]
        (path / SPLITS / f"{split}.txt").write_text("".join(names), encoding="utf-8")


def is_ours(path: Path) -> bool:
    """Return whether `write` made a folder."""
    return path.is_dir() and (path / DATA / INDEX_FILE).is_file() and {p.name for p in path.iterdir()} == {
        DATA, SPLITS, OBJECTS,
    }  # fmt: skip


LIST = "list of the grasps"
"""Stands in `_values` for a list with an item for each grasp."""


def _values(name: str, chosen: ChosenGrasps, metadata: GraspMetadata) -> dict[str, Any]:
    hand = chosen.scene.gripper
    return {
        "object": {"file": name, "scale": 1.0},
        "grasps": dict.fromkeys(("transforms", "object_in_gripper"), LIST),
        "qdgrasp": jaw_metadata(metadata, hand).values
        | {
            "transform_offset_from_asset_to_graspgen_convention": BASE_OFFSET,
            "joint_names": [joint.name for joint in hand.joints],
            "grasps": dict.fromkeys((*EXTRA_LISTS, *(APPROACH_LISTS if chosen.approach else ())), LIST),
        },
    }


EXTRA_LISTS = (
    *("number", "fitness", "eta", "joint_positions", "pregrasp_joint_positions"),
    *("synergy", "penetration", "margin", "settled_transforms", "contacts"),
)
APPROACH_LISTS = ("approach_transforms", "approach_clear", "resting_poses", "resting_probability")
"""Lists that are there where hands are to come to grasps."""


def _lists(grasps: Grasps, frame: Frame) -> dict[str, list[Any]]:
    """Return the lists with an item for each grasp."""
    approaches: dict[str, list[Any]] = {}
    if grasps.approach is not None:
        approaches = {
            "approach_transforms": jaw_transforms(
                grasps.approach_poses(frame), grasps.scene.gripper
            ).tolist(),
            "approach_clear": grasps.reach.is_clear.tolist(),
            "resting_poses": grasps.resting_poses,
            "resting_probability": grasps.reach.probability.tolist(),
        }
    names, hand = (*grasps.synergy_names, ""), grasps.scene.gripper
    settled = settled_jaw_transforms(grasps, frame).tolist()
    return {
        "transforms": jaw_transforms(grasps.poses(frame), hand).tolist(),
        "object_in_gripper": grasps.is_grasp.tolist(),
        "number": grasps.numbers.tolist(),
        "fitness": grasps.fitness.tolist(),
        "eta": grasps.eta.tolist(),
        "joint_positions": grasps.joints.tolist(),
        "pregrasp_joint_positions": grasps.pregrasp.tolist(),
        "synergy": [names[label] for label in grasps.synergies.tolist()],
        "penetration": grasps.rows["penetration"].tolist(),
        "margin": grasps.margin.tolist(),
        "settled_transforms": _where_settled(grasps, settled),
        "contacts": _where_settled(grasps, _contacts(grasps, frame)),
        **approaches,
    }


def _write_json(file: IO[bytes], values: dict[str, Any], lists: Mapping[str, IO[bytes]]) -> None:
    """Write a mapping as JSON, with the items of lists from files."""
    file.write(b"{")
    for place, (key, value) in enumerate(values.items()):
        file.write(b"," * (place > 0) + msgspec.json.encode(key) + b":")
        if value is LIST:
            lists[key].seek(0)
            file.write(b"[")
            shutil.copyfileobj(lists[key], file)
            file.write(b"]")
        elif isinstance(value, dict):
            _write_json(file, value, lists)
        else:
            file.write(msgspec.json.encode(value))
    file.write(b"}")


def _where_settled(grasps: Grasps, values: Iterable[object]) -> list[object]:
    """Return values in the order of the grasps, None where nothing was recorded after closing."""
    return [value if known else None for value, known in zip(values, grasps.is_settled, strict=True)]


def _contacts(grasps: Grasps, frame: Frame) -> Iterator[list[dict[str, Any]]]:
    """Yield the contacts of each grasp."""
    names = ("", *grasps.scene.gripper.links)
    for links, points, normals, forces in zip(*grasps.contacts_in(frame), strict=True):
        found = [
            (names[link], *point, *normal, force)
            for link, point, normal, force in zip(
                links.tolist(), points.tolist(), normals.tolist(), forces.tolist(), strict=True
            )
            if link
        ]
        yield [dict(zip(CONTACT_FIELDS, values, strict=True)) for values in found]


class GraspGenObject(Struct):
    """The object."""

    scale: float | None = None


class GraspGenTransforms(Struct):
    """Grasps and failures."""

    transforms: list[list[list[float]]]
    object_in_gripper: list[bool | float] | None = None


class GraspGenExtras(Struct):
    """Values without a place in the format, in the order of the transforms."""

    number: list[Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]]
    pregrasp_joint_positions: list[list[float]]
    synergy: list[str]


class GraspGenMetadata(GraspMetadata, frozen=True, kw_only=True):
    """The block `qdgrasp`."""

    joint_names: list[str]
    grasps: GraspGenExtras


class GraspGenFile(Struct):
    """A JSON file of grasps."""

    grasps: GraspGenTransforms
    object: GraspGenObject
    qdgrasp: GraspGenMetadata | None = None


def read(path: Path, payload: bytes) -> ImportedGrasps:
    """Read the grasps and failures in a JSON file of such a folder, of ours or of others."""
    file = decode_json(path, payload, GraspGenFile)
    matrices = to_array(path, "transforms", file.grasps.transforms, (4, 4))
    check_matrices(path, matrices)
    count, bits = len(matrices), file.grasps.object_in_gripper
    imported = ImportedGrasps(
        names=np.arange(count).astype(str),
        poses=from_matrices(matrices),
        has_jaw_axes=True,
        confidence=None if bits is None else to_array(path, "object_in_gripper", bits, (), count),
        scale=file.object.scale,
    )
    return imported if file.qdgrasp is None else _with_joints(path, imported, file.qdgrasp)


def _with_joints(path: Path, imported: ImportedGrasps, ours: GraspGenMetadata) -> ImportedGrasps:
    beside, count = ours.grasps, len(imported)
    starts = to_array(
        path, "pregrasp_joint_positions", beside.pregrasp_joint_positions, (len(ours.joint_names),), count
    )
    if not len(beside.number) == len(beside.synergy) == count:
        raise UnreadableGrasps(path, f"the lists in its block 'qdgrasp' must have {count} items")
    return replace(
        imported,
        names=np.array(beside.number, dtype=np.int64).astype(str),
        start_positions=dict(zip(ours.joint_names, starts.T, strict=True)),
        synergies=to_words(path, "synergies", beside.synergy),
        frame=ours.frame,
        gripper=ours.gripper,
        link=ours.gripper_frame,
        scale=ours.object_scale,
        metadata=ours,
    )
