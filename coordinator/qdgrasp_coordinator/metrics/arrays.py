"""Arrays that come from outside, checked, and whole rows moved as bytes.

Files of plain numpy arrays are read without trust: nothing in them is unpickled. Arrays that others give
are of the expected kind and shape, or refused in words. Structured rows are moved as bytes, in a tenth of
the time that numpy takes to move them field by field.
"""

import math
import os
import resource
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_protocol.errors import ImpossibleValue, InputError
from qdgrasp_protocol.rows import COLUMNS, Rows, RowShape


def read_arrays(path: Path, what: str) -> dict[str, NDArray[np.generic]]:
    """Return the arrays in an npz file, by name; nothing in it is unpickled.

    `what` the file is to hold is named in errors ("poses", "reference set"): `InputError` where it cannot be
    read, or is no npz file of plain arrays.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if (size := sum(member.file_size for member in members)) > LARGEST_ARRAYS:
                raise InputError(
                    f"'{path}' holds {size} bytes of arrays, and at most {LARGEST_ARRAYS >> 20} MiB are "
                    f"read, so no {what} can be."
                )
            return {member.filename.removesuffix(".npy"): _read_array(archive, member) for member in members}
    except OSError as error:
        raise InputError(f"No {what} can be read at '{path}': {error.strerror or error}.") from None
    except (*DAMAGED, zipfile.BadZipFile, zlib.error):
        raise InputError(f"'{path}' is not an npz file of plain arrays, so no {what} can be read.") from None


@contextmanager
def bounded_memory(path: Path) -> Iterator[None]:
    """Have a reader of a file get `MemoryError` beyond the room that files of its size need.

    A small file can state, or unfold to, any number of bytes, and libraries make room for them unasked.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[DATA_PAGES])
    size = sum(file.stat().st_size for file in (path.rglob("*") if path.is_dir() else [path]))
    stacks = (IO_THREADS + (os.cpu_count() or 1)) * threads_stack()
    most = pages * resource.getpagesize() + LEAST_ROOM + MOST_UNFOLDING * size + stacks
    if soft != resource.RLIM_INFINITY:
        most = min(most, soft)
    resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def threads_stack() -> int:
    """The bytes that a new thread has for its stack."""
    stack, _ = resource.getrlimit(resource.RLIMIT_STACK)
    return DEFAULT_STACK if stack == resource.RLIM_INFINITY else stack


def _read_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[np.generic]:
    """Return the array in a member of an npz file, whose header may claim no more than it holds."""
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        shape, _, dtype = HEADERS[version](file, max_header_size=LARGEST_HEADER)
        size = math.prod(shape) * dtype.itemsize
        if min(shape, default=0) < 0 or not dtype.itemsize or size != member.file_size - file.tell():
            raise ValueError("the header states another size")
    with archive.open(member) as file:
        return np.asarray(np.lib.format.read_array(file, allow_pickle=False, max_header_size=LARGEST_HEADER))


DATA_PAGES = 5  # The place in `statm` of the pages that RLIMIT_DATA limits
LEAST_ROOM, MOST_UNFOLDING = 1 << 27, 20  # Bytes for any file, and for each of its own
IO_THREADS = 8  # Threads that Arrow reads with, besides one for each core
DEFAULT_STACK = 1 << 23  # Bytes of a thread's stack where no limit is set, and more than that
LARGEST_ARRAYS = 1 << 28  # Bytes of all arrays in a file that is read
LARGEST_HEADER = 10_000  # Characters of an array's header
HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
DAMAGED = (
    ValueError, EOFError, TypeError, AttributeError, KeyError, NotImplementedError, RuntimeError,
    SyntaxError, tokenize.TokenError,
)  # fmt: skip
REAL = "fiu"  # Kinds of arrays that hold real numbers


def real_numbers(name: str, values: ArrayLike, shape: tuple[int | str, ...]) -> NDArray[np.float64]:
    """Return real numbers of a shape as float64; NaN and infinity are allowed.

    The shape is a length for each axis, or a letter where any will do: ("n", 3). Other values raise
    `InputError`, which calls them `name`.
    """
    expected = "numbers of shape ({}{})".format(", ".join(map(str, shape)), "," * (len(shape) == 1))
    try:
        array = np.asarray(values)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} must be {expected}; {error}.") from None
    if array.dtype.kind not in REAL:
        raise InputError(f"{name} must be {expected}, and its type is {array.dtype}.")
    pairs = zip(array.shape, shape, strict=False)
    if array.ndim != len(shape) or not all(isinstance(length, str) or length == n for n, length in pairs):
        raise ImpossibleValue(name, array.shape, expected)
    return array.astype(np.float64)


def finite_numbers(name: str, values: ArrayLike, shape: tuple[int | str, ...]) -> NDArray[np.float64]:
    """Return real numbers of a shape as `real_numbers` does; NaN and infinity are refused."""
    array = real_numbers(name, values, shape)
    if not np.isfinite(array).all():
        raise InputError(f"{name} holds a number that is not finite.")
    return array


def row_bytes(rows: Rows) -> NDArray[np.void]:
    """The same rows, of any number of axes, as items without fields."""
    return rows.view(_bytes_dtype(rows.dtype.itemsize))


def take_rows(rows: Rows, places: Any) -> Rows:
    """A copy of the rows at some places, given by any index of an array."""
    chosen: Rows = row_bytes(rows)[places].copy().view(rows.dtype)
    return chosen


def join_rows(parts: Sequence[Rows]) -> Rows:
    """Rows one behind the other, of one part at least; a single part is given back as it is."""
    if len(parts) == 1:
        return parts[0]
    return np.concatenate([row_bytes(part) for part in parts]).view(parts[0].dtype)


def reshape_rows(rows: Rows, shape: RowShape) -> Rows:
    """Return the rows in a shape that is wider, zeros behind genes and descriptors, or narrower."""
    if rows.dtype == shape.dtype:
        return rows
    made = shape.empty(len(rows))
    for column in COLUMNS:
        source, target = rows[column.name], made[column.name]
        common = tuple(map(slice, np.minimum(source.shape, target.shape)))
        target[common] = source[common]
    return made


@cache
def _bytes_dtype(n: int) -> "np.dtype[np.void]":
    return np.dtype((np.void, n))
