"""Arrays that come from outside, checked, and whole rows moved as bytes.

Of files of plain numpy arrays nothing is unpickled. Arrays that others give
are of the expected kind and shape, or refused in words. Structured rows are moved as bytes, in a tenth of
the time that numpy takes to move them field by field.
"""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_protocol.errors import ImpossibleValue, InputError
from qdgrasp_protocol.rows import Rows


def read_arrays(path: Path, what: str) -> dict[str, NDArray[np.generic]]:
    """Return the arrays in an npz file, by name; nothing in it is unpickled.

    `what` the file is to hold is named in errors ("poses", "reference set"): `InputError` where it cannot be
    read, or is no npz file of plain arrays.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            return dict(archive)
    except OSError as error:
        raise InputError(f"No {what} can be read at '{path}': {error.strerror or error}.") from None
    except Exception:  # noqa: BLE001  # numpy and zipfile raise what they like for a damaged file
        raise InputError(f"'{path}' is not an npz file of plain arrays, so no {what} can be read.") from None


REAL = "fiu"  # Kinds of arrays that hold real numbers


def real_numbers(name: str, values: ArrayLike | None, shape: tuple[int | str, ...]) -> NDArray[np.float64]:
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


@cache
def _bytes_dtype(n: int) -> "np.dtype[np.void]":
    return np.dtype((np.void, n))
