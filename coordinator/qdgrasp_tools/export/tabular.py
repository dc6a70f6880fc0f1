"""CSV, Parquet and WebDataset tar: one table with a line for each grasp.

Lines of CSV that begin with # are metadata. Parquet keeps every bit, and is read again.
"""

import io
import json
import tarfile
from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.storage.tables import write_csv as write_rows
from qdgrasp_protocol.errors import InputError
from qdgrasp_tools.export.grasp_table import (
    COM,
    CONTACT_FIELDS,
    GraspMetadata,
    GraspTable,
    RunTable,
    UnreadableGrasps,
    exact_decimals,
)

SAMPLE_ROWS = 8192  # Grasps that are made into a table of Arrow at once
PREGRASP = "pregrasp."  # Prefix of columns of joints before closing; the joint's name follows
CONTACTS, POSE_COLUMN, METADATA_KEY = "contact_points", "base_to_object", "qdgrasp"
SAME_MEANINGS = {
    "object": "the object",
    "gripper": "the hand",
    "category": "of the object; none: not known",
    "method": "the search",
    "seed": "of the search",
    "protocol": "the evaluation protocol",
    "engine": "the physics engine",
}
"""Columns that have one value for all grasps of a run."""


def write_csv(path: Path, table: RunTable) -> None:
    """Write grasps as CSV in UTF-8, behind lines with the metadata."""
    names = list(table.columns)
    columns = [_plain(table[name]) for name in names]
    with path.open("w", encoding="utf-8", newline="") as file:
        for name, value in table.about.values.items():
            if name != "runs":
                words = " ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
                file.writelines(f"# {line}\n" for line in f"{name}: {words}".splitlines())
        for run in table.about.runs:
            file.write(f"# run: {run.run}\n#   digest: {run.digest}\n")
            file.writelines(f"#   {line}\n" for line in run.spec.splitlines())
        write_rows(file, (dict(zip(names, line, strict=True)) for line in zip(*columns, strict=True)), names)


def _plain(values: NDArray[np.generic]) -> list[Any]:
    """Return values (n,) of a column as plain ones; None for NaN."""
    if values.dtype.kind != "f":
        return list(values.tolist())
    numbers: NDArray[np.floating] = values  # type: ignore[assignment]  # the kind says so
    return [None if value != value else value for value in exact_decimals(numbers).tolist()]


def write_parquet(path: Path, table: RunTable) -> None:
    """Write grasps as a Parquet file compressed with zstd."""
    import pyarrow.parquet as pq

    pq.write_table(arrow_table(table, {METADATA_KEY: table.about.json}), path, compression="zstd")


def load_pandas() -> Any:
    """Return the package pandas; InputError with how to get it where it is not installed."""
    try:
        return import_module("pandas")
    except ImportError:
        raise InputError(
            "to_pandas() needs pandas, which is not installed: `pip install pandas` brings it."
        ) from None


def arrow_table(table: RunTable, metadata: Mapping[str, str] = MappingProxyType({})) -> Any:
    """Return grasps as a table of Arrow, with this metadata in its schema."""
    import pyarrow as pa

    arrays = {name: _arrow_array(np.full(len(table), value)) for name, value in table.same.items()}
    meanings = dict(SAME_MEANINGS)
    arrays[POSE_COLUMN] = pa.FixedSizeListArray.from_arrays(pa.array(table.base_to_object.ravel()), 7)
    meanings[POSE_COLUMN] = "the pose as simulated: x y z [m] qx qy qz qw, centre-of-mass frame"
    for column in table.columns.values():
        arrays[column.name] = _arrow_array(column.values)
        meanings[column.name] = column.meaning
    arrays[CONTACTS] = _contact_lists(table)
    meanings[CONTACTS] = "contacts after closing: the hand's link, point on the object [m], normal, force [N]"
    fields = [
        pa.field(name, array.type, metadata={"meaning": meanings[name]}) for name, array in arrays.items()
    ]
    return pa.table(list(arrays.values()), schema=pa.schema(fields, metadata=dict(metadata)))


def _arrow_array(values: NDArray[np.generic]) -> Any:
    """Convert values (n,) of a column to Arrow; NaN and empty words are null."""
    import pyarrow as pa

    if values.dtype.kind == "U":
        return pa.array(values.tolist(), pa.string(), mask=values == "")
    return pa.array(np.ascontiguousarray(values), mask=np.isnan(values))


def _contact_lists(table: RunTable) -> Any:
    """Return the contacts of each grasp as a list in Arrow; null where they were not recorded."""
    import pyarrow as pa

    contacts = table.contacts
    here = contacts.links > 0
    names = np.array(["", *table.scene.gripper.links])
    numbers = np.column_stack([contacts.points[here], contacts.normals[here], contacts.forces[here]])
    columns = [pa.array(names[contacts.links[here]], pa.string())]
    columns += [pa.array(np.ascontiguousarray(values)) for values in numbers.astype(np.float32).T]
    ends = pa.array(np.concatenate([[0], here.sum(axis=1).cumsum()]).astype(np.int32))
    values = pa.StructArray.from_arrays(columns, CONTACT_FIELDS)
    return pa.ListArray.from_arrays(ends, values, mask=pa.array(~table.is_settled))


def write_tar(path: Path, table: RunTable) -> None:
    """Write each grasp as a sample in a tar file, as WebDataset reads them.

    KEY.json has the columns of the table, and what all grasps have in common; missing numbers are NaN.
    Beside it are arrays of numpy, float32: poses KEY.commanded.npy and KEY.settled.npy (7,), joints
    KEY.pregrasp.npy, KEY.joints.npy and KEY.squeeze.npy (j,), and contacts in k slots KEY.contacts.npy
    (k, 8): the place of the link in `links` of the metadata, -1 for none, point, normal and force. The
    metadata are a header of the tar file.
    """
    contacts, names = table.contacts, list(table.columns)
    slots = (contacts.links[..., None] - 1.0, contacts.points, contacts.normals, contacts.forces[..., None])
    arrays = {
        "commanded": table.poses,
        "settled": table.settled,
        "pregrasp": table.pregrasp,
        "joints": table.joints,
        "squeeze": table.squeeze,
        "contacts": np.concatenate(slots, axis=2),
    }
    columns = zip(*(table[name].tolist() for name in names), strict=True)
    words = msgspec.json.encode(table.about.values | {"links": table.scene.gripper.links}).decode()
    run = str(table["run"][0]).replace(".", "%2E")  # a key ends at the first point
    with tarfile.open(path, "w", format=tarfile.PAX_FORMAT, pax_headers={METADATA_KEY: words}) as tar:
        for place, values in enumerate(columns):
            key = f"{run}-{table.names[place]}"
            grasp = table.same | dict(zip(names, values, strict=True))
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
