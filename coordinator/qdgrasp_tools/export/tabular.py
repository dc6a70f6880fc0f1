"""CSV, Parquet and WebDataset tar: one table with a line for each grasp.

Lines of CSV that begin with # are metadata. Parquet keeps every bit, and is read again.
"""

import io
import json
import tarfile
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.storage.tables import write_csv as write_rows
from qdgrasp_tools.export.grasp_set import Grasps
from qdgrasp_tools.export.grasp_table import (
    COM,
    POSE_COLUMN,
    PREGRASP,
    GraspMetadata,
    GraspTable,
    UnreadableGrasps,
    arrow_table,
    common_values,
    plain_values,
)

METADATA_KEY = "qdgrasp"


def write_csv(path: Path, grasps: Grasps, about: GraspMetadata) -> None:
    """Write grasps as CSV in UTF-8, behind lines with the metadata."""
    found = grasps.columns(about.frame)
    names, columns = list(found), list(map(plain_values, found.values()))
    with path.open("w", encoding="utf-8", newline="") as file:
        for name, value in about.values.items():
            if name != "runs":
                words = " ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
                file.writelines(f"# {line}\n" for line in f"{name}: {words}".splitlines())
        for run in about.runs:
            file.write(f"# run: {run.run}\n#   digest: {run.digest}\n")
            file.writelines(f"#   {line}\n" for line in run.spec.splitlines())
        write_rows(file, (dict(zip(names, line, strict=True)) for line in zip(*columns, strict=True)), names)


def write_parquet(path: Path, grasps: Grasps, about: GraspMetadata) -> None:
    """Write grasps as a Parquet file compressed with zstd."""
    import pyarrow.parquet as pq

    table = arrow_table(grasps.all_columns(about.frame), {METADATA_KEY: about.json})
    pq.write_table(table, path, compression="zstd")


def write_tar(path: Path, grasps: Grasps, about: GraspMetadata) -> None:
    """Write each grasp as a sample in a tar file, as WebDataset reads them.

    KEY.json has the columns of the table, and what all grasps have in common; missing numbers are NaN.
    Beside it are arrays of numpy, float32: poses KEY.commanded.npy and KEY.settled.npy (7,), joints
    KEY.pregrasp.npy, KEY.joints.npy and KEY.squeeze.npy (j,), and contacts in k slots KEY.contacts.npy
    (k, 8): the place of the link in `links` of the metadata, -1 for none, point, normal and force. The
    metadata are a header of the tar file.
    """
    contacts, found = grasps.contacts_in(about.frame), grasps.columns(about.frame)
    slots = (contacts.links[..., None] - 1.0, contacts.points, contacts.normals, contacts.forces[..., None])
    arrays: dict[str, NDArray[np.floating]] = {
        "commanded": grasps.poses(about.frame),
        "settled": grasps.recorded_poses(about.frame),
        "pregrasp": grasps.postures.pregrasp,
        "joints": grasps.postures.joints,
        "squeeze": grasps.postures.squeeze,
        "contacts": np.concatenate(slots, axis=2),
    }
    columns = zip(*(values.tolist() for values in found.values()), strict=True)
    words = msgspec.json.encode(about.values | {"links": grasps.scene.gripper.links}).decode()
    run, same = grasps.run.replace(".", "%2E"), common_values(grasps.spec)  # a key ends at the first point
    with tarfile.open(path, "w", format=tarfile.PAX_FORMAT, pax_headers={METADATA_KEY: words}) as tar:
        for place, values in enumerate(columns):
            key = f"{run}-{grasps.numbers[place]}"
            grasp = same | dict(zip(found, values, strict=True))
            add_member(tar, f"{key}.json", json.dumps(grasp, ensure_ascii=False).encode())
            for name, array in arrays.items():
                packed = io.BytesIO()
                np.save(packed, array[place].astype(np.float32), allow_pickle=False)
                add_member(tar, f"{key}.{name}.npy", packed.getvalue())


def add_member(tar: tarfile.TarFile, name: str, payload: bytes) -> None:
    """Add a file without a date to a tar file."""
    member = tarfile.TarInfo(name)
    member.size = len(payload)
    tar.addfile(member, io.BytesIO(payload))


def read_parquet(path: Path) -> GraspTable:
    """Read the grasps in a Parquet file of ours."""
    import pyarrow.parquet as pq

    table = pq.read_table(path, use_threads=False)
    told = (table.schema.metadata or {}).get(METADATA_KEY.encode())
    if told is None:
        raise UnreadableGrasps(path, "it is a Parquet file, but not one that `qdgrasp export` wrote")
    joints = [name for name in table.column_names if name.startswith(PREGRASP)]
    starts = [np.asarray(table[name], dtype=np.float64) for name in joints]
    simulated = table[POSE_COLUMN].combine_chunks().flatten()
    found = GraspTable(
        names=np.asarray(table["number"]).astype(str),
        poses=np.asarray(simulated, dtype=np.float64).reshape(-1, 7),
        joint_names=tuple(name.removeprefix(PREGRASP) for name in joints),
        pregrasp=np.stack(starts, axis=1) if starts else None,
        synergies=np.array([name or "" for name in table["synergy"].to_pylist()], dtype=str),
        confidence=np.asarray(table["confidence"], dtype=np.float64),
    ).with_metadata(msgspec.json.decode(told, type=GraspMetadata))
    return replace(found, frame=COM)  # poses are those in `base_to_object`
