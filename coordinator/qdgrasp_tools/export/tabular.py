"""CSV, Parquet and WebDataset tar: one table with a line for each grasp.

Lines of CSV that begin with # are metadata. Parquet keeps every bit, and is read again.
"""

import io
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

SAMPLE_ROWS = 8192  # Grasps in a sample of a tar file
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
    """Write grasps as samples in a tar file, KEY.json and KEY.npz, as WebDataset reads them.

    A sample is some thousand grasps. The arrays of KEY.npz are the columns of the table, each (n,),
    `base_to_object` (n, 7), and contacts in k slots each: `contact_links` (n, k) with places in `links` of
    KEY.json, -1 for none, `contact_points`, `contact_normals` (n, k, 3), `contact_forces` (n, k).
    """
    arrays: dict[str, NDArray[np.generic]] = {POSE_COLUMN: table.base_to_object}
    arrays |= {column.name: column.values for column in table.columns.values()}
    arrays["contact_links"] = table.contacts.links.astype(np.int16) - 1
    for name in ("points", "normals", "forces"):
        arrays[f"contact_{name}"] = getattr(table.contacts, name).astype(np.float32)
    words = msgspec.json.encode(table.about.values | table.same | {"links": table.scene.gripper.links})
    with tarfile.open(path, "w", format=tarfile.PAX_FORMAT) as tar:
        for first in range(0, len(table), SAMPLE_ROWS):
            packed, part = io.BytesIO(), slice(first, first + SAMPLE_ROWS)
            np.savez_compressed(packed, allow_pickle=False, **{k: v[part] for k, v in arrays.items()})
            for suffix, payload in (("json", words), ("npz", packed.getvalue())):
                member = tarfile.TarInfo(f"{table['run'][0]}-{first // SAMPLE_ROWS:06}.{suffix}")
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
