"""Files that hold their old bytes or their new ones, never a part; errors of full disks."""

import errno
import fcntl
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import takewhile
from pathlib import Path
from typing import IO, Any

from qdgrasp_protocol.errors import DiskFull, FolderError, OutputError

LONGEST = 200  # Longest part of a name that a temporary folder's name repeats [bytes]
OLD = "old"  # In a temporary folder, the folder that is being replaced
NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


def write(file: Path, payload: bytes) -> None:
    """Replace a file at once; the new bytes are on the disk when this returns."""
    part = file.with_name(f"{file.name}.part")
    write_through(part, payload)
    part.replace(file)
    sync(file.parent)


def write_through(file: Path, payload: bytes) -> None:
    """Write a file whose bytes, but not its name, are on the disk when this returns."""
    with file.open("wb") as stream:
        stream.write(payload)
        stream.flush()
        os.fsync(stream.fileno())


def replace(file: Path, payload: bytes) -> None:
    """Replace a file at once (`write`), or say in a sentence why that cannot be (`writing`)."""
    with writing(file.parent):
        write(file, payload)


def read(file: Path) -> bytes:
    """Return the bytes of a file, or raise `FolderError`."""
    try:
        return file.read_bytes()
    except OSError as error:
        raise FolderError(f"{file} cannot be read: {error_reason(error)}.") from None


def is_file(path: Path) -> bool:
    """Return whether there is a file; False where the path cannot be looked at."""
    with suppress(OSError):
        return path.is_file()
    return False


def is_still_at(path: Path, file: IO[Any]) -> bool:
    """Return whether an open file is the one at a path, not deleted or replaced."""
    try:
        return os.path.samestat(path.stat(), os.fstat(file.fileno()))
    except OSError:
        return False


def is_staging(path: Path, of: Path) -> bool:
    """Return whether a path is a temporary folder (`staging_folder`) of another one."""
    begin, end = _begin(of), ".part"
    is_named = path.parent == of.parent and path.name.startswith(begin) and path.name.endswith(end)
    return is_named and path.name[len(begin) : -len(end)].isdecimal()


def check_folder(path: Path) -> None:
    """Raise `FolderError` unless there is a folder to read from."""
    with suppress(OSError):
        if path.is_dir():
            return
    if os.path.lexists(path):
        raise FolderError(f"{path} is no folder; name that of a run.")
    raise FolderError(f"There is no folder {path}; `qdgrasp run --out {path}` would begin a run there.")


def create_folder(
    path: Path,
    files: Mapping[str, bytes],
    folders: Iterable[str] = (),
    fill: Callable[[Path], None] = lambda _folder: None,
) -> None:
    """Make a folder with files and empty folders in it; it appears whole or not at all.

    `fill` writes more files into the folder while it is being made. Raises `DiskFull` or `FolderError`.
    """
    with writing(path), staging_folder(path) as part:
        for name, payload in files.items():
            write_through(part / name, payload)
        for name in folders:
            (part / name).mkdir()
        fill(part)
        sync(part)
        part.rename(path)  # replaces an empty folder, and nothing else
        sync(path.absolute().parent)


@contextmanager
def staging_folder(path: Path) -> Iterator[Path]:
    """Make a temporary folder beside `path` to build it in; removed at the end unless renamed.

    Missing parent folders are made (`making_parents`). Leftovers of processes that were killed are removed.
    """
    whole = path.absolute()
    part = whole.with_name(f"{_begin(whole)}{os.getpid()}.part")
    with making_parents(whole.parent):
        _sweep(whole)
        part.mkdir()
        try:
            with _held(part):
                yield part
        finally:
            shutil.rmtree(part, ignore_errors=True)


@contextmanager
def making_parents(path: Path) -> Iterator[None]:
    """Make a folder and its parents; where the with-block fails, remove the empty new ones."""
    missing = [*takewhile(lambda each: not each.exists(), (path, *path.parents))]
    try:
        path.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for each in missing:
            with suppress(OSError):  # one that holds something stays, and those above it
                each.rmdir()
        raise


def put_in_place(made: Path, path: Path, old: Path) -> None:
    """Move a finished file or folder to `path`, durably; a folder there before goes to `old`."""
    if made.is_file():
        sync(made)
    is_replacing = path.is_dir()
    try:
        if is_replacing:
            path.rename(old)
        made.rename(path)
    except BaseException:  # a signal, too
        if is_replacing and not path.exists():
            old.rename(path)
        raise
    sync(path.absolute().parent)


def _begin(whole: Path) -> str:
    """Return the prefix of the temporary folders' names for a path, cut to the allowed length."""
    return f".{os.fsdecode(os.fsencode(whole.name)[:LONGEST])}."


def _sweep(whole: Path) -> None:
    """Remove what killed processes left of a folder; a folder that they moved goes back."""
    for part in whole.parent.iterdir():
        if is_staging(part, whole) and part.is_dir():
            with suppress(BlockingIOError, FileNotFoundError), _held(part):  # else in use, or removed since
                if (part / OLD).exists() and not os.path.lexists(whole):
                    (part / OLD).rename(whole)
                shutil.rmtree(part, ignore_errors=True)


@contextmanager
def _held(folder: Path) -> Iterator[None]:
    """Lock a temporary folder, or raise `BlockingIOError`; freed when this process dies."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)


def sync(path: Path) -> None:
    """Flush a file's content, or a folder's list of names, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def writing(path: Path, instead: str = "") -> Iterator[None]:
    """Turn a failure to write at `path` into an error that says what to do instead.

    The error is `DiskFull` for want of room, else `OutputError`.
    """
    try:
        yield
    except OSError as error:
        if error.errno in NO_ROOM:
            raise DiskFull(f"There is no room to write in {path}: {error_reason(error)}.") from None
        raise OutputError(path, f"cannot be written: {error_reason(error)}", instead) from None


def damaged_file(file: Path, how: str) -> FolderError:
    """Return the error for a file that does not hold what it should."""
    return FolderError(f"{file} is damaged: {how}; restore it from a copy.")


def error_reason(error: OSError) -> str:
    """Return the reason of a failed file operation, in words."""
    return (error.strerror or str(error)).lower()
