"""CSV, Parquet and WebDataset tar: one table with a line for each grasp.

Lines of CSV that begin with # are metadata.

Parquet keeps every bit, and is read again. Parquet and tar are written some thousand grasps at a time.
"""

import io
import tarfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import LIFT, Outcome
from qdgrasp_tools.export.frames import COM, Frame
from qdgrasp_tools.export.grasp_reader import ChosenGrasps
from qdgrasp_tools.export.grasp_set import CONTACT_FIELDS, Grasps
from qdgrasp_tools.export.imported_grasps import (
    MOST_GRASPS,
    ImportedGrasps,
    UnreadableGrasps,
    decode_metadata,
    to_words,
)
from qdgrasp_tools.export.metadata import LIFT_MEANING, GraspMetadata
from qdgrasp_tools.export.text_format import shortest_decimals

JOINT, PREGRASP = "joint.", "pregrasp."  # Prefixes of columns of joints; the joint's name follows
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
SETTLED = "settled_"  # Prefix of columns of the settled pose
CONTACTS = "contact_points"
RESTING_POSES = "resting_poses"
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
OUTCOMES = np.array([outcome.name.lower() for outcome in Outcome])


class GraspColumn(NamedTuple):
    """One column of the table."""

    name: str
    values: NDArray[np.generic]
    """(n,): numbers, NaN where one is missing, or words, empty where one is missing."""
    meaning: str


def grasp_columns(grasps: Grasps, frame: Frame) -> Iterator[GraspColumn]:
    """Yield the columns of a table of grasps whose poses are in a frame of the object."""
    rows, poses = grasps.rows, grasps.poses(frame)
    yield GraspColumn("number", grasps.numbers, "the row's number in the journal, from 0")
    runs = _label_words([source.run for source in grasps.sources], grasps.origins)
    yield GraspColumn("run", runs, "name of the run that found it")
    yield GraspColumn("generation", rows["generation"], "of the search")
    yield GraspColumn("index", rows["index"], "in the generation")
    yield GraspColumn("outcome", OUTCOMES[rows["outcome"]], "how the evaluation ended")
    survived = "disturbances survived: 0 to 2 shakes, in `physical` 0 to 6 pushes"
    yield GraspColumn("fitness", grasps.fitness, LIFT_MEANING if grasps.scene.protocol == LIFT else survived)
    for name, verdicts in grasps.elsewhere.items():
        words = np.append(OUTCOMES, "")[verdicts["outcome"]]  # -1, not known, is the last
        yield GraspColumn(f"{name}_outcome", words, f"how it ended in {name}; none: not evaluated there")
        yield GraspColumn(f"{name}_fitness", verdicts["fitness"], f"disturbances survived in {name}")
    yield GraspColumn("eta", grasps.eta, "estimated probability of transfer; none where it is not known")
    error = "standard error of eta, for the number of trials alone; none where eta is not known"
    yield GraspColumn("eta_error", grasps.eta_error, error)
    yield GraspColumn("trials", grasps.trials, "disturbed trials that eta is of")
    yield GraspColumn("confidence", grasps.confidence, "0 to 1, higher is better")
    settled = np.where(grasps.is_settled[:, None], grasps.settled_poses(frame), np.nan)
    for begin, kind, of in (("", "commanded", poses), (SETTLED, "settled", settled)):
        for name, values in zip(POSE, of.T, strict=True):
            length = f"hand's root link in the object's frame, {kind} pose [m]"
            yield GraspColumn(begin + name, values, length if len(name) == 1 else "its quaternion")
    for name, joint, start in zip(grasps.joint_names, grasps.joints.T, grasps.pregrasp.T, strict=True):
        yield GraspColumn(JOINT + name, joint, "joint after closing, at the settled pose [rad or m]")
        yield GraspColumn(PREGRASP + name, start, "joint before closing, at the commanded pose [rad or m]")
    way, angle = grasps.motion.T
    yield GraspColumn("motion_mm", 1e3 * way, "way of the object in the hand while it closed [mm]")
    yield GraspColumn("motion_deg", np.degrees(angle), "its turn meanwhile [deg]")
    synergies = _label_words(grasps.synergy_names, grasps.synergies)
    yield GraspColumn("synergy", synergies, "synergy that closes the hand; none: all driven joints")
    aims = rows["surface_point"].astype(np.float64)
    offset = np.zeros(3) if frame == COM else np.array(grasps.scene.object.com_in_mesh)
    aims = np.where(aims.any(axis=1, keepdims=True), aims + offset, np.nan)
    for name, values in zip("xyz", aims.T, strict=True):
        yield GraspColumn(f"aim_{name}", values, "surface point that was aimed at, object's frame [m]")
    yield GraspColumn("nu", rows["nu"], "angle of its normal to the direction to the hand [rad]")
    yield GraspColumn("contacts", rows["contacts"], "finger links that touch after closing")
    yield GraspColumn("penetration", rows["penetration"], "deepest after closing [m]")
    yield GraspColumn("margin", grasps.margin, "Ferrari-Canny margin of the contacts; none: not known")
    if grasps.approach is not None:
        yield from _approach_columns(grasps, frame, has_table=bool(grasps.approach.poses))


def _approach_columns(grasps: Grasps, frame: Frame, *, has_table: bool) -> Iterator[GraspColumn]:
    """Yield how hands come to the commanded poses."""
    for name, values in zip("xyz", grasps.approach_directions.T, strict=True):
        yield GraspColumn(f"approach_{name}", values, "direction in which the hand comes, object's frame")
    for name, values in zip("xyz", grasps.approach_poses(frame).T[:3], strict=True):
        start = "where it comes from, turned as at the commanded pose, object's frame [m]"
        yield GraspColumn(f"approach_from_{name}", values, start)
    is_clear = grasps.reach.is_clear.astype(np.uint8)
    yield GraspColumn("approach_clear", is_clear, "1: it touches nothing on its way")
    if has_table:
        words = np.array([" ".join(map(str, numbers)) for numbers in grasps.resting_poses], dtype=str)
        yield GraspColumn(
            RESTING_POSES, words, "the object's resting poses in which it comes above the table"
        )
        share = "probability of these resting poses"
        yield GraspColumn("resting_probability", grasps.reach.probability, share)


def _label_words(words: list[str] | tuple[str, ...], labels: NDArray[np.int64]) -> NDArray[np.str_]:
    """Return words by their labels; -1 stands for an empty one."""
    return np.array([*words, ""])[labels]


QUOTED_LETTERS = frozenset('",#\r\n')
"""Words with one of these are quoted: readers take what is behind a bare # for a remark."""


def write_csv(path: Path, grasps: Grasps, metadata: GraspMetadata) -> None:
    """Write grasps as CSV in UTF-8, lines ended by a newline."""
    table = list(grasp_columns(grasps, metadata.frame))
    with path.open("w", encoding="utf-8", newline="") as file:
        file.writelines(f"# {line}\n" for text in _comment_lines(metadata) for line in text.splitlines())
        file.write(_csv_line(_csv_field(column.name) for column in table))
        file.writelines(map(_csv_line, zip(*(_csv_fields(column.values) for column in table), strict=True)))


def _comment_lines(metadata: GraspMetadata) -> Iterator[str]:
    """Yield the metadata as texts, the lines of each spec on lines of their own."""
    for name, value in metadata.values.items():
        if name != "runs":
            words = " ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
            yield f"{name}: {words}"
    for run in metadata.runs:
        yield f"run: {run.run}"
        yield f"  digest: {run.digest}"
        yield from (f"  {line}" for line in run.spec.splitlines())


def _csv_line(fields: Iterable[str]) -> str:
    return ",".join(fields) + "\n"


def _csv_fields(values: NDArray[np.generic]) -> list[str]:
    """Write values (n,) as fields of CSV; NaN is empty."""
    if values.dtype.kind == "f":
        numbers = shortest_decimals(values)  # type: ignore[arg-type]  # the kind says that they are floats
        return [word if word != "nan" else "" for word in numbers]
    return [_csv_field(str(value)) for value in values.tolist()]


def _csv_field(word: str) -> str:
    if QUOTED_LETTERS.isdisjoint(word):
        return word
    return '"' + word.replace('"', '""') + '"'


METADATA_KEY = "qdgrasp"
POSE_COLUMN = "base_to_object"
MAGIC = b"PAR1"
COLUMNS_READ = ("number", "synergy", "confidence", POSE_COLUMN)
"""Columns that are read, beside those of joints."""
MOST_NUMBERS = 100_000_000
"""Numbers in all columns that are read: few bytes can stand for very many equal ones."""
ROW_GROUP = 65_536  # Rows of a row group


class ParquetShard:
    """A Parquet file that grows by tables, compressed with zstd; for a with-block."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._writer: Any = None
        self._waiting: list[Any] = []
        self._stack = ExitStack()

    def add(self, table: Any) -> None:
        """Add the rows of a table; all tables have the columns of the first."""
        import pyarrow.parquet as pq

        if self._writer is None:
            writer = pq.ParquetWriter(self._path, table.schema, compression="zstd")
            self._writer = self._stack.enter_context(writer)
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

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with self._stack:
            if kind is None:
                self._write()


def write_parquet(path: Path, chosen: ChosenGrasps, metadata: GraspMetadata) -> None:
    """Write grasps as a Parquet file; memory does not grow with the grasps."""
    with ParquetShard(path) as shard:
        for part in chosen:
            shard.add(grasp_table(part, metadata.frame, {METADATA_KEY: metadata.json}))


def load_pandas() -> Any:
    """Return the package pandas; InputError with how to get it where it is not installed."""
    try:
        return import_module("pandas")
    except ImportError:
        raise InputError(
            "to_pandas() needs pandas, which is not installed: `pip install pandas` brings it."
        ) from None


def data_frame(table: Any) -> Any:
    """Return a table of Arrow as a `pandas.DataFrame`; InputError where there is no pandas."""
    load_pandas()
    return table.to_pandas()


def grasp_table(
    grasps: Grasps, frame: Frame, metadata: Mapping[str, str], same: Mapping[str, str | int] = NO_COLUMNS
) -> Any:
    """Return grasps as a table of Arrow, with poses in a frame of the object.

    `same` are columns that stand in front and have one value each; `metadata` is that of the schema.
    """
    import pyarrow as pa

    count = len(grasps)
    arrays = {name: _arrow_array(np.full(count, value)) for name, value in same.items()}
    meanings = {name: SAME_MEANINGS[name] for name in same}
    arrays[POSE_COLUMN] = pa.FixedSizeListArray.from_arrays(pa.array(grasps.rows[POSE_COLUMN].ravel()), 7)
    meanings[POSE_COLUMN] = "the pose as simulated: x y z [m] qx qy qz qw, centre-of-mass frame"
    for column in grasp_columns(grasps, frame):
        arrays[column.name] = _arrow_array(column.values)
        meanings[column.name] = column.meaning
    arrays[CONTACTS] = _contact_lists(grasps, frame)
    meanings[CONTACTS] = "contacts after closing: the hand's link, point on the object [m], normal, force [N]"
    fields = [
        pa.field(name, array.type, metadata={"meaning": meanings[name]}) for name, array in arrays.items()
    ]
    return pa.table(list(arrays.values()), schema=pa.schema(fields, metadata=dict(metadata)))


class TarShard:
    """A tar file of samples, KEY.json and KEY.npz, as WebDataset reads them; for a with-block.

    A sample is some thousand grasps of one run. The arrays of KEY.npz are the columns of the table, each
    (n,), `base_to_object` (n, 7), and contacts in k slots each: `contact_links` (n, k) with places in
    `links` of KEY.json, -1 for none, `contact_points`, `contact_normals` (n, k, 3), `contact_forces` (n, k).
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._tar = tarfile.open(path, "w", format=tarfile.PAX_FORMAT)  # noqa: SIM115  # closed by __exit__

    @property
    def size(self) -> int:
        """Bytes that are in the file by now."""
        return self._tar.offset

    def add(self, key: str, grasps: Grasps, frame: Frame, about: Mapping[str, Any]) -> None:
        """Add a sample; its key has no point in it."""
        contacts = grasps.contacts_in(frame)
        arrays: dict[str, NDArray[np.generic]] = {POSE_COLUMN: grasps.rows[POSE_COLUMN]}
        arrays |= {column.name: column.values for column in grasp_columns(grasps, frame)}
        arrays["contact_links"] = contacts.links.astype(np.int16) - 1
        for name in ("points", "normals", "forces"):
            arrays[f"contact_{name}"] = getattr(contacts, name).astype(np.float32)
        packed = io.BytesIO()
        np.savez_compressed(packed, allow_pickle=False, **arrays)
        words = dict(about) | {"links": grasps.scene.gripper.links}
        for suffix, payload in (("json", msgspec.json.encode(words)), ("npz", packed.getvalue())):
            member = tarfile.TarInfo(f"{key}.{suffix}")
            member.size = len(payload)
            self._tar.addfile(member, io.BytesIO(payload))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._tar.close()


def write_tar(path: Path, chosen: ChosenGrasps, metadata: GraspMetadata) -> None:
    """Write grasps as samples in a tar file; memory does not grow with the grasps."""
    with TarShard(path) as shard:
        for number, part in enumerate(chosen):
            shard.add(f"{number:06}", part, metadata.frame, metadata.values)


def _arrow_array(values: NDArray[np.generic]) -> Any:
    """Convert values (n,) of a column to Arrow; NaN and empty words are null."""
    import pyarrow as pa

    if values.dtype.kind == "U":
        return pa.array(values.tolist(), pa.string(), mask=values == "")
    return pa.array(np.ascontiguousarray(values), mask=np.isnan(values))


def _contact_lists(grasps: Grasps, frame: Frame) -> Any:
    """Return the contacts of each grasp as a list in Arrow; null where they were not recorded."""
    import pyarrow as pa

    contacts = grasps.contacts_in(frame)
    here = contacts.links > 0
    names = np.array(["", *grasps.scene.gripper.links])
    numbers = np.column_stack([contacts.points[here], contacts.normals[here], contacts.forces[here]])
    columns = [pa.array(names[contacts.links[here]], pa.string())]
    columns += [pa.array(np.ascontiguousarray(values)) for values in numbers.astype(np.float32).T]
    ends = pa.array(np.concatenate([[0], here.sum(axis=1).cumsum()]).astype(np.int32))
    values = pa.StructArray.from_arrays(columns, CONTACT_FIELDS)
    return pa.ListArray.from_arrays(ends, values, mask=pa.array(~grasps.is_settled))


def read_parquet(path: Path) -> ImportedGrasps:
    """Read the grasps in a Parquet file that `write_parquet` wrote."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        entries = pq.read_schema(path).metadata or {}
        if METADATA_KEY.encode() not in entries:
            raise UnreadableGrasps(path, "it is a Parquet file, but not one that `qdgrasp export` wrote")
        with pq.ParquetFile(path, read_dictionary=["synergy"]) as file:
            if file.metadata.num_rows > MOST_GRASPS:
                raise UnreadableGrasps(
                    path, f"it has {file.metadata.num_rows} rows; at most {MOST_GRASPS} are read"
                )
            names = _columns_to_read(file.schema_arrow)
            if file.metadata.num_rows * len(names) > MOST_NUMBERS:
                raise UnreadableGrasps(path, f"it has more than {MOST_NUMBERS} numbers")
            table = file.read(columns=names, use_threads=False)
        return _imported_grasps(path, table, decode_metadata(path, entries[METADATA_KEY.encode()]))
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError) as error:
        raise UnreadableGrasps(path, f"it is a damaged Parquet file ({error})") from None


def read_shards(
    folder: Path, names: Iterable[str], gripper: str, object_: str, metadata: GraspMetadata
) -> ImportedGrasps:
    """Read the grasps of a hand on an object from the Parquet files of a data set.

    They are named RUN/NUMBER. Raises UnreadableGrasps, and errors of Arrow.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    tables, ours = [], [("object", "==", object_), ("gripper", "==", gripper)]
    for name in names:
        path = folder / name
        if not path.resolve().is_relative_to(folder.resolve()):
            raise UnreadableGrasps(folder, f"its index names a file elsewhere, '{name}'")
        columns = ["run", *_columns_to_read(pq.ParquetFile(path, read_dictionary=["synergy"]).schema_arrow)]
        tables.append(
            pq.read_table(path, columns=columns, filters=ours, read_dictionary=["synergy"], use_threads=False)
        )
        if sum(map(len, tables)) > MOST_GRASPS:
            raise UnreadableGrasps(
                folder, f"it has too many rows of '{object_}'; at most {MOST_GRASPS} are read"
            )
    table = pa.concat_tables(tables)
    runs = to_words(folder, "runs", [run or "" for run in table["run"].to_pylist()])
    imported = _imported_grasps(folder, table, metadata)
    return replace(imported, names=np.char.add(np.char.add(runs, "/"), imported.names))


def _columns_to_read(schema: Any) -> list[str]:
    """Return the columns that are read; each is of numbers but for the synergies."""
    import pyarrow.types as kinds

    fields = [field for field in schema if field.name in COLUMNS_READ or field.name.startswith(PREGRASP)]
    for field in fields:
        is_nested = field.name in (POSE_COLUMN, "synergy")
        kind = getattr(field.type, "value_type", None) if is_nested else field.type
        if kind is None:
            raise TypeError(f"its column '{field.name}' is of type {field.type}")
        is_number = kinds.is_integer(kind) or kinds.is_floating(kind)
        if not (kinds.is_string(kind) if field.name == "synergy" else is_number):
            raise TypeError(f"its column '{field.name}' is of type {field.type}")
    return [field.name for field in fields]


def _imported_grasps(path: Path, table: Any, metadata: GraspMetadata) -> ImportedGrasps:
    """Convert a table; its poses are those in `base_to_object`, always at the centre of mass."""
    simulated = table[POSE_COLUMN].combine_chunks()
    poses = np.asarray(simulated.flatten(), dtype=np.float64).reshape(len(table), 7)
    words = table["synergy"].unify_dictionaries().combine_chunks()
    names = to_words(path, "synergies", [*(name or "" for name in words.dictionary.to_pylist()), ""])
    joints = [name for name in table.column_names if name.startswith(PREGRASP)]
    return ImportedGrasps(
        names=np.asarray(table["number"]).astype(str),
        poses=poses,
        start_positions={
            name.removeprefix(PREGRASP): np.asarray(table[name], dtype=np.float64) for name in joints
        },
        synergies=names[np.asarray(words.indices.fill_null(len(names) - 1), dtype=np.int64)],
        confidence=np.asarray(table["confidence"], dtype=np.float64),
        scale=metadata.object_scale,
        frame=COM,
        gripper=metadata.gripper,
        link=metadata.gripper_frame,
        metadata=metadata,
    )
