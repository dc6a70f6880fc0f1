"""Finds: successes of a run as they travel to those who draw them."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Finds
from qdgrasp_protocol.rows import FLOAT, Column, Rows

COLUMNS = (
    Column("number", "<u4", "1", "the row's number in the journal"),
    Column("outcome", "<u1", "1", "`Outcome`"),
    Column("fitness", "<f4", "1", "shakes survived: 0, 1 or 2; the sum over the trials is not in it"),
    Column("descriptor", "<f4", "3", "the hand's commanded position [m], CoM frame: what cells are made of"),
    Column(
        "base_to_object", "<f4", "7", "the hand's root link in the object's CoM frame: x y z [m], qx qy qz qw"
    ),
    Column("joints", "<f4", "joints", "finger joint positions at the grasp [rad or m]"),
    Column("synergy", "<i2", "1", "the synergy that closed the hand, by its place in the gripper; -1: none"),
    Column("eta", "<f4", "1", "estimated probability of transfer; -1 where not all trials are recorded"),
)
MOST = 4096
"""The most finds in one answer."""
MOST_BYTES = 1 << 20
"""The most bytes of all columns of one answer."""

Found = NDArray[np.void]
"""A structured array with the dtype of `layout`."""


@cache
def layout(joints: int) -> np.dtype[np.void]:
    """The dtype of finds of a hand with so many joints."""
    return np.dtype([(column.name, column.item, _width(column, joints)) for column in COLUMNS])


def limit(joints: int) -> int:
    """The most finds in one answer about a hand with so many joints."""
    return min(MOST, MOST_BYTES // layout(joints).itemsize)


def found(rows: Rows, joints: int, **told: NDArray[np.number]) -> Found:
    """Successes (n,) as finds (n,); `told` are the columns that no row has: number, synergy, eta."""
    finds = np.zeros(len(rows), dtype=layout(joints))
    for column in COLUMNS:
        values = told[column.name] if column.name in told else rows[column.name]
        finds[column.name] = values[..., :3] if column.name == "descriptor" else values
    return finds


def to_message(
    finds: Found, upto: int, *, run: str, scene: str, began: float, rows: int, joints: int
) -> Finds:
    """Finds as they travel: those up to row `upto` of the journal that the others describe."""
    columns = {column.name: np.ascontiguousarray(finds[column.name]).tobytes() for column in COLUMNS}
    return Finds(
        run=run,
        scene=scene,
        began=began,
        next=upto,
        rows=rows,
        n=len(finds),
        joints=joints,
        columns=columns,
    )


def from_message(message: Finds) -> Found:
    """The finds (n,) in a message.

    Raises
    ------
    MessageError
        A column is missing, of the wrong length, or holds a number that is not finite.
    """
    dtype = layout(message.joints)
    finds = np.zeros(message.n, dtype=dtype)
    for column in COLUMNS:
        blob, expected = message.columns.get(column.name, b""), message.n * dtype[column.name].itemsize
        if len(blob) != expected:
            raise MessageError(f"column '{column.name}' has {len(blob)} bytes, expected {expected}")
        values = np.frombuffer(blob, dtype=column.item)
        if column.item == FLOAT and not np.isfinite(values).all():
            raise MessageError(f"column '{column.name}' holds a number that is not finite")
        finds[column.name] = values.reshape(finds[column.name].shape)
    return finds


def _width(column: Column, joints: int) -> tuple[int, ...]:
    if column.width == "1":
        return ()
    return (int(column.width) if column.width.isdigit() else joints,)
