"""Parquet: a table with a line for each grasp; its own format, that keeps every bit.

The schema's metadata hold, as JSON under the key `qdgrasp`, what the file says of itself (`About`). Beside
the columns of every table stands `base_to_object`: the pose as simulated, float32, centre-of-mass frame.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.exchange.about import About
from qdgrasp_coordinator.exchange.columns import PREGRASP, columns
from qdgrasp_coordinator.exchange.frames import COM
from qdgrasp_coordinator.exchange.grasps import Grasps
from qdgrasp_coordinator.exchange.told import MOST, Told, Unusable, read_about, to_words

KEY = "qdgrasp"
SIMULATED = "base_to_object"
MAGIC = b"PAR1"
READ = ("number", "synergy", "confidence", SIMULATED)
"""The columns that are read, beside those of joints."""
MOST_NUMBERS = 100_000_000
"""In all columns that are read, at most: few bytes can stand for very many equal ones."""


def write(path: Path, grasps: Grasps, about: About) -> None:
    """Write grasps as a Parquet file, compressed with zstd."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    poses = pa.FixedSizeListArray.from_arrays(pa.array(grasps.rows[SIMULATED].ravel()), 7)
    arrays = {SIMULATED: poses}
    meanings = {SIMULATED: "the pose as simulated: x y z [m] qx qy qz qw, centre-of-mass frame"}
    for column in columns(grasps, about.frame):
        arrays[column.name] = _array(column.values)
        meanings[column.name] = column.meaning
    fields = [
        pa.field(name, array.type, metadata={"meaning": meanings[name]}) for name, array in arrays.items()
    ]
    schema = pa.schema(fields, metadata={KEY: about.json})
    pq.write_table(pa.table(list(arrays.values()), schema=schema), path, compression="zstd")


def _array(values: NDArray[np.generic]) -> Any:
    """Values (n,) of a column as Arrow has them; NaN and empty words are null."""
    import pyarrow as pa

    if values.dtype.kind == "U":
        return pa.array(values.tolist(), pa.string(), mask=values == "").dictionary_encode()
    return pa.array(np.ascontiguousarray(values), mask=np.isnan(values))


def read(path: Path) -> Told:
    """The grasps in a Parquet file that `write` wrote.

    Raises
    ------
    Unusable
        It is damaged, or is another Parquet file.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        metadata = pq.read_schema(path).metadata or {}
        if KEY.encode() not in metadata:
            raise Unusable(path, "it is a Parquet file, but not one that `qdgrasp export` wrote")
        with pq.ParquetFile(path, read_dictionary=["synergy"]) as file:
            if file.metadata.num_rows > MOST:
                raise Unusable(path, f"it has {file.metadata.num_rows} rows; at most {MOST} are read")
            names = _columns(file.schema_arrow)
            if file.metadata.num_rows * len(names) > MOST_NUMBERS:
                raise Unusable(path, f"it has more than {MOST_NUMBERS} numbers")
            table = file.read(columns=names)
        about = read_about(path, metadata[KEY.encode()])
        return _told(path, table, about)
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError) as error:
        raise Unusable(path, f"it is a damaged Parquet file ({error})") from None


def _columns(schema: Any) -> list[str]:
    """The names of the columns that are read, each of which is of numbers but for the synergies."""
    import pyarrow.types as kinds

    fields = [field for field in schema if field.name in READ or field.name.startswith(PREGRASP)]
    for field in fields:
        kind = field.type.value_type if field.name in (SIMULATED, "synergy") else field.type
        if not (kinds.is_string if field.name == "synergy" else _is_number)(kind):
            raise TypeError(f"its column '{field.name}' is of type {field.type}")
    return [field.name for field in fields]


def _is_number(kind: Any) -> bool:
    import pyarrow.types as kinds

    return bool(kinds.is_integer(kind) or kinds.is_floating(kind))


def _told(path: Path, table: Any, about: About) -> Told:
    """What a table says; the poses are those in `base_to_object`, always at the centre of mass."""
    simulated = table[SIMULATED].combine_chunks()
    poses = np.asarray(simulated.flatten(), dtype=np.float64).reshape(len(table), 7)
    joints = [name for name in table.column_names if name.startswith(PREGRASP)]
    return Told(
        names=np.asarray(table["number"]).astype(str),
        poses=poses,
        starts={name.removeprefix(PREGRASP): np.asarray(table[name], dtype=np.float64) for name in joints},
        synergies=_synergies(path, table["synergy"].unify_dictionaries().combine_chunks()),
        confidence=np.asarray(table["confidence"], dtype=np.float64),
        scale=about.object_scale,
        frame=COM,
        gripper=about.gripper,
        link=about.gripper_frame,
        about=about,
    )


def _synergies(path: Path, column: Any) -> NDArray[np.str_]:
    """The words (n,) of a column of words by their numbers; null is none."""
    names = to_words(path, "synergies", [*(name or "" for name in column.dictionary.to_pylist()), ""])
    return names[np.asarray(column.indices.fill_null(len(names) - 1), dtype=np.int64)]
