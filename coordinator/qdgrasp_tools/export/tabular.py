"""CSV, Parquet and WebDataset tar: one table with a line for each grasp.

Lines of CSV that begin with # are metadata. Parquet keeps every bit, and is read again; Parquet and tar are
written some thousand grasps at a time.
"""

import io
import tarfile
from collections.abc import Iterable, Mapping
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.storage.tables import write_csv as write_rows
from qdgrasp_protocol.errors import InputError
from qdgrasp_tools.export.frames import COM
from qdgrasp_tools.export.grasp_table import (
    CONTACT_FIELDS,
    GraspMetadata,
    GraspTable,
    RunTable,
    UnreadableGrasps,
    exact_decimals,
)

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
"""Columns of a data set that have one value for all grasps of a run."""
NO_COLUMNS: Mapping[str, str | int] = MappingProxyType({})
ROW_GROUP = 65_536  # Rows of a row group


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


class ParquetShard:
    """A Parquet file that grows by tables, compressed with zstd; for a with-block."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._writer: Any = None
        self._waiting: list[Any] = []

    def add(self, table: Any) -> None:
        """Add the rows of a table of Arrow; all have the columns of the first."""
        import pyarrow.parquet as pq

        if self._writer is None:
            self._writer = pq.ParquetWriter(self._path, table.schema, compression="zstd")
        self._waiting.append(table.cast(self._writer.schema))
        if sum(map(len, self._waiting)) >= ROW_GROUP:
            self._write()

    def fits(self, table: Any) -> bool:
        """Return whether a table has the columns of the first one."""
        return self._writer is None or self._writer.schema.names == table.schema.names

    @property
    def size(self) -> int:
        """Bytes that are in the file by now, up to a row group less than there will be."""
        return self._path.stat().st_size if self._path.exists() else 0

    def _write(self) -> None:
        import pyarrow as pa

        if self._waiting:
            self._writer.write_table(pa.concat_tables(self._waiting), row_group_size=ROW_GROUP)
            self._waiting.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._write()
        if self._writer is not None:
            self._writer.close()


def write_parquet(path: Path, parts: Iterable[RunTable]) -> None:
    """Write grasps as a Parquet file; memory does not grow with the grasps."""
    with ParquetShard(path) as shard:
        for table in parts:
            shard.add(arrow_table(table, {METADATA_KEY: table.about.json}))


def load_pandas() -> Any:
    """Return the package pandas; InputError with how to get it where it is not installed."""
    try:
        return import_module("pandas")
    except ImportError:
        raise InputError(
            "to_pandas() needs pandas, which is not installed: `pip install pandas` brings it."
        ) from None


def arrow_table(
    table: RunTable,
    metadata: Mapping[str, str] = MappingProxyType({}),
    same: Mapping[str, str | int] = NO_COLUMNS,
) -> Any:
    """Return grasps as a table of Arrow.

    `same` are columns in front that have one value each; `metadata` is that of the schema.
    """
    import pyarrow as pa

    count = len(table)
    arrays = {name: _arrow_array(np.full(count, value)) for name, value in same.items()}
    meanings = {name: SAME_MEANINGS[name] for name in same}
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


class TarShard:
    """A tar file of samples, KEY.json and KEY.npz, as WebDataset reads them; for a with-block.

    A sample is some thousand grasps of one run. The arrays of KEY.npz are the columns of the table, each
    (n,), `base_to_object` (n, 7), and contacts in k slots each: `contact_links` (n, k) with places in
    `links` of KEY.json, -1 for none, `contact_points`, `contact_normals` (n, k, 3), `contact_forces` (n, k).
    """

    def __init__(self, path: Path) -> None:
        self._tar = tarfile.open(path, "w", format=tarfile.PAX_FORMAT)  # noqa: SIM115  # closed by __exit__

    @property
    def size(self) -> int:
        """Bytes that are in the file by now."""
        return self._tar.offset

    def add(self, key: str, table: RunTable, about: Mapping[str, Any]) -> None:
        """Add a sample; its key has no point in it."""
        arrays: dict[str, NDArray[np.generic]] = {POSE_COLUMN: table.base_to_object}
        arrays |= {column.name: column.values for column in table.columns.values()}
        arrays["contact_links"] = table.contacts.links.astype(np.int16) - 1
        for name in ("points", "normals", "forces"):
            arrays[f"contact_{name}"] = getattr(table.contacts, name).astype(np.float32)
        packed = io.BytesIO()
        np.savez_compressed(packed, allow_pickle=False, **arrays)
        words = dict(about) | {"links": table.scene.gripper.links}
        for suffix, payload in (("json", msgspec.json.encode(words)), ("npz", packed.getvalue())):
            member = tarfile.TarInfo(f"{key}.{suffix}")
            member.size = len(payload)
            self._tar.addfile(member, io.BytesIO(payload))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._tar.close()


def write_tar(path: Path, parts: Iterable[RunTable]) -> None:
    """Write grasps as samples in a tar file; memory does not grow with the grasps."""
    with TarShard(path) as shard:
        for number, table in enumerate(parts):
            shard.add(f"{number:06}", table, table.about.values)


def read_parquet(path: Path) -> GraspTable:
    """Read the grasps in a Parquet file that `write_parquet` wrote."""
    import pyarrow.parquet as pq

    entries = pq.read_schema(path).metadata or {}
    if METADATA_KEY.encode() not in entries:
        raise UnreadableGrasps(path, "it is a Parquet file, but not one that `qdgrasp export` wrote")
    metadata = msgspec.json.decode(entries[METADATA_KEY.encode()], type=GraspMetadata)
    return _table_of(pq.read_table(path, use_threads=False), metadata)


def read_shards(files: Iterable[Path], gripper: str, object_: str, metadata: GraspMetadata) -> GraspTable:
    """Read the grasps of a hand on an object from a data set's Parquet, named RUN/NUMBER."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    ours = [("object", "==", object_), ("gripper", "==", gripper)]
    table = pa.concat_tables([pq.read_table(file, filters=ours, use_threads=False) for file in files])
    return _table_of(table, metadata, [f"{run}/" for run in table["run"].to_pylist()])


def _table_of(table: Any, metadata: GraspMetadata, begins: Iterable[str] = ()) -> GraspTable:
    """Convert a table of Arrow; its poses are those in `base_to_object`, CoM frame."""
    simulated = table[POSE_COLUMN].combine_chunks().flatten()
    joints = [name for name in table.column_names if name.startswith(PREGRASP)]
    starts = [np.asarray(table[name], dtype=np.float64) for name in joints]
    numbers = np.asarray(table["number"]).astype(str)
    return GraspTable(
        names=np.array(list(map("".join, zip(begins, numbers, strict=True)))) if begins else numbers,
        poses=np.asarray(simulated, dtype=np.float64).reshape(-1, 7),
        joint_names=tuple(name.removeprefix(PREGRASP) for name in joints),
        pregrasp=np.stack(starts, axis=1) if starts else None,
        synergies=np.array([name or "" for name in table["synergy"].to_pylist()], dtype=str),
        confidence=np.asarray(table["confidence"], dtype=np.float64),
        scale=metadata.object_scale,
        frame=COM,
        gripper=metadata.gripper,
        link=metadata.gripper_frame,
        metadata=metadata,
    )
