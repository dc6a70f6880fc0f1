"""Parquet: a table with a line for each grasp; its own format, that keeps every bit.

The schema's metadata hold, as JSON under the key `qdgrasp`, what the file says of itself (`About`). Beside
the columns of every table stands `base_to_object`: the pose as simulated, float32, centre-of-mass frame.
"""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.exchange.about import About
from qdgrasp_coordinator.exchange.columns import PREGRASP, columns
from qdgrasp_coordinator.exchange.frames import COM
from qdgrasp_coordinator.exchange.grasps import Grasps
from qdgrasp_coordinator.exchange.told import MOST, Told, Unusable, read_about

KEY = "qdgrasp"
SIMULATED = "base_to_object"
MAGIC = b"PAR1"


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
        with pq.ParquetFile(path) as file:
            metadata = file.schema_arrow.metadata or {}
            if KEY.encode() not in metadata:
                raise Unusable(path, "it is a Parquet file, but not one that `qdgrasp export` wrote")
            if file.metadata.num_rows > MOST:
                raise Unusable(path, f"it has {file.metadata.num_rows} rows; at most {MOST} are read")
            table = file.read()
        about = read_about(path, metadata[KEY.encode()])
        return _told(table, about)
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError) as error:
        raise Unusable(path, f"it is a damaged Parquet file ({error})") from None


def _told(table: Any, about: About) -> Told:
    """What a table says; the poses are those in `base_to_object`."""
    simulated = table[SIMULATED].combine_chunks()
    poses = np.asarray(simulated.flatten(), dtype=np.float64).reshape(len(table), 7)
    joints = [name for name in table.column_names if name.startswith(PREGRASP)]
    return Told(
        names=np.asarray(table["number"]).astype(str),
        poses=poses,
        starts={name.removeprefix(PREGRASP): np.asarray(table[name], dtype=np.float64) for name in joints},
        synergies=np.array([name or "" for name in table["synergy"].to_pylist()], dtype=str),
        confidence=np.asarray(table["confidence"], dtype=np.float64),
        scale=about.object_scale,
        about=msgspec.structs.replace(about, frame=COM),
    )
