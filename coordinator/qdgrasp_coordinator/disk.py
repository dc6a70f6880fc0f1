"""Files that hold their old bytes or their new ones, never a part of either; and disks that are full."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from qdgrasp_protocol.errors import DiskFull, FolderError

NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


def write(file: Path, payload: bytes) -> None:
    """Replace a file at once; the new bytes are on the disk when this returns."""
    part = file.with_name(f"{file.name}.part")
    with part.open("wb") as stream:
        stream.write(payload)
        stream.flush()
        os.fsync(stream.fileno())
    part.replace(file)
    sync(file.parent)


def sync(folder: Path) -> None:
    """Bring the names of a folder's files to the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Say in a sentence why nothing can be written in a folder.

    Raises
    ------
    DiskFull
        There is no room.
    FolderError
        Anything else.
    """
    try:
        yield
    except OSError as error:
        if error.errno in NO_ROOM:
            raise DiskFull(f"There is no room to write in {folder}: {reason(error)}.") from None
        raise FolderError(f"{folder} cannot be written: {reason(error)}.") from None


def damaged(file: Path, how: str) -> FolderError:
    """What is said of a file that does not hold what it should."""
    return FolderError(f"{file} is damaged: {how}; restore it from a copy.")


def reason(error: OSError) -> str:
    """Why a file operation failed, in words."""
    return (error.strerror or str(error)).lower()
