"""Files that hold their old bytes or their new ones, never a part of either; and disks that are full."""

import errno
import fcntl
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
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


def read(file: Path) -> bytes:
    """What a file holds.

    Raises
    ------
    FolderError
        It cannot be read.
    """
    try:
        return file.read_bytes()
    except OSError as error:
        raise FolderError(f"{file} cannot be read: {reason(error)}.") from None


def create(
    path: Path,
    files: Mapping[str, bytes],
    folders: Iterable[str] = (),
    fill: Callable[[Path], None] = lambda _folder: None,
) -> None:
    """Make a folder with files and empty folders in it; it appears whole or not at all.

    Parameters
    ----------
    fill
        Writes more files into the folder while it is being made.

    Raises
    ------
    DiskFull, FolderError
        It cannot be made.
    """
    with writing(path), workshop(path) as part:
        for name, payload in files.items():
            write(part / name, payload)
        for name in folders:
            (part / name).mkdir()
        fill(part)
        part.rename(path)  # replaces an empty folder, and nothing else
        sync(path.absolute().parent)


@contextmanager
def workshop(path: Path) -> Iterator[Path]:
    """A folder beside `path` in which what shall be there is made; gone in the end, unless it was renamed.

    What processes that were killed had begun to make is removed.
    """
    whole = path.absolute()
    part = whole.with_name(f".{whole.name}.{os.getpid()}.part")
    try:
        with ExitStack() as stack:
            _sweep(whole)
            part.mkdir(parents=True)
            stack.enter_context(_held(part))
            yield part
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _sweep(whole: Path) -> None:
    """Remove what processes that were killed had made of a folder."""
    parent = whole.parent
    for part in parent.iterdir() if parent.is_dir() else ():
        if part.is_dir() and part.name.startswith(f".{whole.name}.") and part.suffix == ".part":
            with suppress(BlockingIOError), _held(part):
                shutil.rmtree(part, ignore_errors=True)


@contextmanager
def _held(folder: Path) -> Iterator[None]:
    """Hold a folder that is being made; the kernel frees it when this process dies.

    Raises
    ------
    BlockingIOError
        Another process does.
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)


def check_free(path: Path) -> None:
    """Check that nothing is at `path`, or an empty folder.

    Raises
    ------
    FolderError
        Something is there.
    """
    if path.exists() and not path.is_dir():
        raise FolderError(f"{path} is a file; name a folder with --out.")
    names = sorted(entry.name for entry in path.iterdir()) if path.exists() else []
    if names:
        some = ", ".join(names[:3]) + (" ..." if len(names) > 3 else "")
        raise FolderError(f"{path} holds other files ({some}); name a new or empty folder with --out.")


def check_file(path: Path, *, force: bool = False) -> None:
    """Check that a file can be written at `path`: nothing is there, or an ordinary file that may be replaced.

    Raises
    ------
    FolderError
        Something else is there: a folder, a device, a link, or a file that is to be kept.
    """
    if path.is_symlink() or (path.exists() and not path.is_file()):
        what = "a link" if path.is_symlink() else "a folder" if path.is_dir() else "a device or pipe"
        raise FolderError(f"{path} is {what}, which is not replaced; name a file.")
    if path.exists() and not force:
        raise FolderError(f"{path} is there already; name another file, or replace it with --force.")


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
