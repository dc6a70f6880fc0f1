"""Reading grasps: the table of readers, each found by how its files begin."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import msgspec

from qdgrasp_coordinator.exchange import acronym, graspgen, isaac, parquet
from qdgrasp_coordinator.exchange.checking import check
from qdgrasp_coordinator.exchange.told import Told, Unusable, decoded

KNOWN = "ACRONYM (HDF5 or JSON), GraspGen JSON, Isaac Grasp YAML, and Parquet that `qdgrasp export` wrote"
LARGEST = 1 << 32
"""Bytes of a file that is read."""
LARGEST_JSON = 1 << 29
"""The same of JSON, which takes more room in memory than on the disk."""
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
    head = _head(path)
    for reader in READERS:
        if reader.fits(head):
            try:
                told = reader.read(path)
                check(path, told)
            except MemoryError:
                raise Unusable(path, "there is not enough memory for it") from None
            return told
    raise Unusable(path, f"it is of none of the formats that are read: {KNOWN}")


def _head(path: Path) -> bytes:
    """How a file begins, if it is one that may be read."""
    try:
        if path.is_dir():
            raise Unusable(
                path, f"it is a folder; of one that is for GraspGen name the JSON in {graspgen.DATA}"
            )
        if path.exists() and not path.is_file():
            raise Unusable(path, "it is no ordinary file")
        with path.open("rb") as file:
            head = file.read(HEAD)
        size = path.stat().st_size
    except OSError as error:
        raise Unusable(path, (error.strerror or str(error)).lower()) from None
    if not head.strip():
        raise Unusable(path, "it is empty")
    if size > LARGEST:
        raise Unusable(path, f"it is larger than {LARGEST >> 30} GiB")
    return head


class Kind(msgspec.Struct):
    """What tells JSON files from each other."""

    grasps: msgspec.Raw = msgspec.Raw(b"")


def _read_json(path: Path) -> Told:
    if path.stat().st_size > LARGEST_JSON:
        raise Unusable(path, f"it is JSON, and larger than {LARGEST_JSON >> 20} MiB")
    payload = path.read_bytes()
    is_nested = bool(bytes(decoded(path, payload, Kind).grasps))
    return graspgen.read(path, payload) if is_nested else acronym.read_json(path, payload)


def _refuse(path: Path) -> Told:
    raise Unusable(path, "it is CSV of `qdgrasp export`, which is not read back; export parquet instead")


READERS = (
    Reader(lambda head: head.startswith(b"# qdgrasp: "), _refuse),
    Reader(lambda head: head.startswith(b"\x89HDF\r\n\x1a\n"), acronym.read),
    Reader(lambda head: head.startswith(parquet.MAGIC), parquet.read),
    Reader(lambda head: head.lstrip().startswith(b"{"), _read_json),
    Reader(lambda head: b"\0" not in head, isaac.read),
)
