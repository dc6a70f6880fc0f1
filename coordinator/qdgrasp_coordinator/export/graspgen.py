"""GraspGen JSON: a folder to train from, with failures beside the grasps.

Public description: "GraspGen Grasp Dataset Format" and "GraspGen Gripper Description", v1.0.0. The folder
has

* `grasp_data/NAME.json`             transforms and bits, and what the file says of itself
* `grasp_data/map_uuid_to_path.json` which object is in which file
* `splits/train.txt`, `valid.txt`    the object, in both: there is one
* `object_data/NAME.obj`             its mesh, in metres, in the frame of the transforms
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Struct

from qdgrasp_assets.geometry.mesh import parts_to_obj
from qdgrasp_coordinator.export.frames import Frame, from_matrices, object_solid
from qdgrasp_coordinator.export.grasp_set import CONTACT_FIELDS, Grasps
from qdgrasp_coordinator.export.imported_grasps import (
    ImportedGrasps,
    UnreadableGrasps,
    check_matrices,
    decode_json,
    to_array,
    to_words,
)
from qdgrasp_coordinator.export.metadata import (
    GraspMetadata,
    jaw_metadata,
    jaw_transforms,
    settled_jaw_transforms,
)

INDEX_FILE = "map_uuid_to_path.json"
DATA, SPLITS, OBJECTS = "grasp_data", "splits", "object_data"
BASE_OFFSET = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
"""Offset of GraspGen's axes from those of the transforms, xyz [m] and xyzw: zero."""


def write(path: Path, grasps: Grasps, metadata: GraspMetadata) -> None:
    """Write grasps and failures as a GraspGen folder."""
    for folder in (DATA, SPLITS, OBJECTS):
        (path / folder).mkdir(parents=True)
    name = f"{metadata.object}.obj"
    data = f"{metadata.object}.json"
    (path / OBJECTS / name).write_bytes(
        parts_to_obj([object_solid(grasps.scene.object, metadata.frame).mesh])
    )
    (path / DATA / data).write_bytes(msgspec.json.encode(_values(name, grasps, metadata)))
    (path / DATA / INDEX_FILE).write_bytes(msgspec.json.encode({name: data}))
    for split in ("train", "valid"):
        (path / SPLITS / f"{split}.txt").write_text(f"{name}\n", encoding="utf-8")


def is_ours(path: Path) -> bool:
    """Return whether `write` made a folder."""
    return path.is_dir() and (path / DATA / INDEX_FILE).is_file() and {p.name for p in path.iterdir()} == {
        DATA, SPLITS, OBJECTS,
    }  # fmt: skip


def _values(name: str, grasps: Grasps, metadata: GraspMetadata) -> dict[str, Any]:
    names, hand = (*grasps.synergy_names, ""), grasps.scene.gripper
    settled = settled_jaw_transforms(grasps, metadata.frame).tolist()
    return {
        "object": {"file": name, "scale": 1.0},
        "grasps": {
            "transforms": jaw_transforms(grasps.poses(metadata.frame), hand).tolist(),
            "object_in_gripper": grasps.is_grasp.tolist(),
        },
        "qdgrasp": jaw_metadata(metadata, hand).values
        | {
            "transform_offset_from_asset_to_graspgen_convention": BASE_OFFSET,
            "joint_names": grasps.joint_names,
            "grasps": {
                "number": grasps.numbers.tolist(),
                "fitness": grasps.fitness.tolist(),
                "eta": grasps.eta.tolist(),
                "joint_positions": grasps.joints.tolist(),
                "pregrasp_joint_positions": grasps.pregrasp.tolist(),
                "synergy": [names[label] for label in grasps.synergies.tolist()],
                "penetration": grasps.rows["penetration"].tolist(),
                "margin": grasps.margin.tolist(),
                "settled_transforms": _where_settled(grasps, settled),
                "contacts": _where_settled(grasps, _contacts(grasps, metadata.frame)),
            },
        },
    }


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

    number: list[Annotated[int, msgspec.Meta(ge=0)]]
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
