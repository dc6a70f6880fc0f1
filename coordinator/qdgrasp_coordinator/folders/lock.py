"""One process writes in a folder: a lock that the kernel frees when its holder dies."""

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from qdgrasp_coordinator.folders import disk
from qdgrasp_coordinator.folders.names import LOCK
from qdgrasp_protocol.errors import FolderError

FILE = LOCK
PATIENCE = 1.0  # seconds; whoever only looks whether a folder is in use holds its lock for an instant
INTERVAL = 0.05  # seconds between two tries


@contextmanager
def exclusive(folder: Path, name: str = FILE) -> Iterator[None]:
    """Hold the lock `name` of the folder.

    Raises
    ------
    FolderError
        Another process holds it, or the folder cannot be written.
    """
    with _opened(folder, name) as file:
        deadline = time.monotonic() + PATIENCE
        while not _taken(file):
            if time.monotonic() > deadline:
                raise _in_use(folder, file)
            time.sleep(INTERVAL)  # the kernel wakes nobody who only tries
        with suppress(OSError):  # on a full disk the lock holds all the same; it only has no name
            file.truncate(0)
            file.write(str(os.getpid()))
            file.flush()
        yield


def check_free(folder: Path, name: str = FILE) -> None:
    """Check that nobody holds the lock `name` of the folder.

    Raises
    ------
    FolderError
        Somebody does.
    """
    with _opened(folder, name) as file:
        if not _taken(file):
            raise _in_use(folder, file)


@contextmanager
def _opened(folder: Path, name: str) -> Iterator[IO[str]]:
    with disk.writing(folder):
        file = (folder / name).open("a+")
    with file:
        yield file


def _taken(file: IO[str]) -> bool:
    """Take the lock if it is free."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _in_use(folder: Path, file: IO[str]) -> FolderError:
    file.seek(0)
    pid = file.read().strip()
    return FolderError(f"{folder} is in use{f' by process {pid}' if pid else ''}; wait for it or stop it.")
