"""Rows: the unit of evaluation and of the journal, as numpy structured arrays.

A row is (generation, index, trial) with the genome and everything its evaluation found. The same
array of rows is what a worker fills, what the search is told, and what the journal stores; on the
bus each column travels as one little-endian blob (`pack`, `unpack`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from qdgrasp_protocol.errors import MessageError

Rows: TypeAlias = NDArray[np.void]
"""A structured array with the dtype of `Shape.dtype`."""


@dataclass(frozen=True)
class Column:
    """One column of a row."""

    name: str
    item: str
    """The numpy item type, little-endian."""
    width: str
    """How many items: "1", "7", or the letter of a `Shape` field."""
    meaning: str


KEY = (
    Column("generation", "<u4", "1", "the generation of the search"),
    Column("index", "<u4", "1", "the genome's place in its generation"),
    Column("trial", "<u2", "1", "0 is the nominal evaluation, 1 and up are domain-randomised"),
)
GENOME = (Column("genome", "<f4", "genes", "the genome, in [-1, 1]"),)
RESULT = (
    Column("outcome", "<u1", "1", "`Outcome`"),
    Column("fitness", "<f4", "1", "shakes survived: 0, 1 or 2"),
    Column("proposals", "<u2", "1", "poses that decoding screened for this row; 1 where it draws none"),
    Column(
        "descriptor",
        "<f4",
        "descriptors",
        "behaviour descriptor: the hand's commanded position [m], CoM frame; then the prior's features of it",
    ),
    Column(
        "base_to_object", "<f4", "7", "the hand's root link in the object's CoM frame: x y z [m], qx qy qz qw"
    ),
    Column(
        "joints", "<f4", "joints", "finger joint positions at the grasp [rad or m], the gripper's joint order"
    ),
    Column(
        "surface_point", "<f4", "3", "the surface point aimed at [m], CoM frame; zeros where there is none"
    ),
    Column("nu", "<f4", "1", "angle between its normal and the direction to the hand [rad]"),
    Column("contacts", "<u1", "1", "finger links that touch the object after closing"),
    Column("penetration", "<f4", "1", "deepest penetration after closing [m], 0 or positive"),
)
COLUMNS = KEY + GENOME + RESULT
FLOAT = "<f4"
"""The item type of all columns that do not hold integers."""


@dataclass(frozen=True)
class Shape:
    """How wide the columns of one run's rows are."""

    genes: int
    joints: int
    descriptors: int = 3

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """The packed structured dtype; its bytes, row after row, are what the digest hashes."""
        return np.dtype([self._field(column) for column in COLUMNS])

    def width(self, column: Column) -> int:
        """How many items `column` has in each row."""
        return int(column.width) if column.width.isdigit() else int(getattr(self, column.width))

    def _field(self, column: Column) -> tuple[str, str] | tuple[str, str, tuple[int]]:
        if column.width == "1":
            return (column.name, column.item)
        return (column.name, column.item, (self.width(column),))

    def empty(self, n: int) -> Rows:
        """`n` rows of zeros."""
        return np.zeros(n, dtype=self.dtype)


def pack(rows: Rows, columns: Sequence[Column]) -> dict[str, bytes]:
    """Each of `columns` as one little-endian blob, by name."""
    return {column.name: np.ascontiguousarray(rows[column.name]).tobytes() for column in columns}


def unpack(rows: Rows, columns: Sequence[Column], blobs: Mapping[str, bytes], shape: Shape) -> Rows:
    """Fill `columns` of `rows` from blobs; their lengths and that floats are finite are checked.

    Raises
    ------
    MessageError
        A blob is missing, of the wrong length, or holds a number that is not finite.
    """
    for column in columns:
        blob, expected = blobs.get(column.name), len(rows) * shape.dtype[column.name].itemsize
        if blob is None:
            raise MessageError(f"column '{column.name}' is missing")
        if len(blob) != expected:
            raise MessageError(f"column '{column.name}' has {len(blob)} bytes, expected {expected}")
        target = rows[column.name]
        target[...] = np.frombuffer(blob, dtype=column.item).reshape(target.shape)
    _check_finite({column.name: blobs[column.name] for column in columns if column.item == FLOAT})
    return rows


def _check_finite(blobs: Mapping[str, bytes]) -> None:
    """Check that blobs of floats hold numbers; all of them at once, as nearly all of them do."""
    if np.isfinite(np.frombuffer(b"".join(blobs.values()), dtype=FLOAT)).all():
        return
    name = next(name for name, blob in blobs.items() if not np.isfinite(np.frombuffer(blob, FLOAT)).all())
    raise MessageError(f"column '{name}' holds a number that is not finite")
