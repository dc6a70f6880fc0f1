"""Reading grasps: the table of readers, each found by how its files begin."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import msgspec

from qdgrasp_coordinator.exchange import acronym, graspgen, isaac, parquet
from qdgrasp_coordinator.exchange.told import Told, Unusable, check, decoded

KNOWN = "ACRONYM (HDF5 or JSON), GraspGen JSON, Isaac Grasp YAML, and Parquet that `qdgrasp export` wrote"
LARGEST = 1 << 32
"""Bytes of a file that is read."""
HEAD = 4096


class Reader(NamedTuple):
    """One line of the table."""

    fits: Callable[[bytes], bool]
    """Whether a file that begins so is one."""
    read: Callable[[Path], Told]


def read(path: Path) -> Told:
    """The grasps in a file of any format that is known, checked.

    Raises
    ------
    Unusable
        It cannot be read, is of no known format, is damaged, or tells what cannot be.
    """
    try:
        with path.open("rb") as file:
            head = file.read(HEAD)
        size = path.stat().st_size
    except OSError as error:
        raise Unusable(path, (error.strerror or str(error)).lower()) from None
    if not head.strip():
        raise Unusable(path, "it is empty")
    if size > LARGEST:
        raise Unusable(path, f"it is larger than {LARGEST >> 30} GiB")
    for reader in READERS:
        if reader.fits(head):
            told = reader.read(path)
            check(path, told)
            return told
    raise Unusable(path, f"it is of none of the formats that are read: {KNOWN}")


class Kind(msgspec.Struct):
    """What tells JSON files from each other."""

    grasps: msgspec.Raw = msgspec.Raw(b"")


def _read_json(path: Path) -> Told:
    payload = path.read_bytes()
    is_nested = bool(bytes(decoded(path, payload, Kind).grasps))
    return graspgen.read(path, payload) if is_nested else acronym.read_json(path, payload)


READERS = (
    Reader(lambda head: head.startswith(b"\x89HDF\r\n\x1a\n"), acronym.read),
    Reader(lambda head: head.startswith(parquet.MAGIC), parquet.read),
    Reader(lambda head: head.lstrip().startswith(b"{"), _read_json),
    Reader(lambda head: b"\0" not in head, isaac.read),
)
