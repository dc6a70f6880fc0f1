"""Files and folders that a command writes, and the names of those that make a run or a job.

One rule for all outputs (docs/decisions/0012-outputs-and-exports.md). Whether they can be written is checked
before the work for them is begun. Existing files stay, unless `--force` replaces them; files of a run always
stay. Parent folders are made when there is something to write. An output appears whole or not at all.
"""

import errno
import os
import secrets
import stat
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from qdgrasp_protocol.errors import DiskFull, FolderError, OutputError
from qdgrasp_protocol.text import first_few

JOB, ENDPOINT, LOCK, SUPERVISED = "job.json", "endpoint", "lock", "supervised"
CAMPAIGN, LOGS, RUNS = "campaign.toml", "logs", "runs"
SPEC, SCENE, JOURNAL = "spec.toml", "scene.bundle", "run.sqlite"
SOURCE, RANKING = "source.json", "ranking.csv"  # Of a run that scores the grasps of another one again
FINISHED = "finished.jsonl"  # Of a campaign: the sums of its finished runs
SKIPPED = "skipped.csv"  # Of a campaign that goes on without objects that cannot be used
MARKS = (JOB, CAMPAIGN, SCENE, JOURNAL)
"""Files that each mark the folder of a run or job, also where others are missing."""
PARTS = frozenset(
    [*MARKS, ENDPOINT, LOCK, SUPERVISED, LOGS, RUNS, SPEC, SOURCE, RANKING, SKIPPED, FINISHED]
    + [JOURNAL + suffix for suffix in ("-wal", "-shm")]
)
NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


def replace(file: Path, payload: bytes) -> None:
    """Replace a file at once; the new bytes are on the disk when this returns."""
    part = file.with_name(f".{secrets.token_hex(8)}.part")  # no link that a stranger laid there is followed
    with writing(file.parent):
        try:
            with part.open("xb") as made:
                made.write(payload)
            sync(part)
            part.replace(file)
            sync(file.parent)
        finally:
            part.unlink(missing_ok=True)


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


def check_folder(path: Path) -> None:
    """Raise `FolderError` unless there is a folder to read from."""
    with suppress(OSError):
        if path.is_dir():
            return
    if os.path.lexists(path):
        raise FolderError(f"{path} is no folder; name that of a run.")
    raise FolderError(f"There is no folder {path}; `qdgrasp run --out {path}` would begin a run there.")


def create_folder(path: Path, files: Mapping[str, bytes], folders: Iterable[str] = ()) -> None:
    """Make a folder with files and empty folders in it; it appears whole or not at all.

    Raises `DiskFull` or `OutputError` where it cannot be made, or holds other files.
    """
    with OutFolder(path).writing() as made:
        made.mkdir()
        for name, payload in files.items():
            (made / name).parent.mkdir(parents=True, exist_ok=True)
            (made / name).write_bytes(payload)
            sync(made / name)
        for name in folders:
            (made / name).mkdir()
        sync(made)


def _put_in_place(made: Path, path: Path, old: Path | None = None) -> None:
    """Move a finished file or folder to `path`, durably; what is replaced goes to `old`."""
    if made.is_file():
        sync(made)
    try:
        if old and path.is_dir():
            path.rename(old)
        made.rename(path)  # without `old` it replaces an empty folder, and no other
    except BaseException:  # a signal, too
        if old and old.exists() and not path.exists():
            old.rename(path)
        raise
    sync(path.absolute().parent)


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


STDOUT = Path("-")
FILE, FOLDER = "a file", "a folder"
SHOWN = 3  # Most file names listed where other files are in the way


@dataclass(frozen=True)
class Output(ABC):
    """A file or folder that a command writes at a path; it appears whole or not at all."""

    path: Path
    instead: str = "name another path with --out"
    """Advice for the case that it cannot be written."""
    force: bool | None = None
    """True: what is there is replaced; None: it is not, and there is no flag for it."""

    def check(self) -> None:
        """Check that it can be written, before the work for it is begun; else raise `OutputError`."""
        home = self.path.absolute().parent
        with writing(self.path, self.instead):
            if self.path == STDOUT:
                raise self._refused("would be standard output, where no output goes")
            if self.path.name in PARTS and any((home / mark).exists() for mark in MARKS):
                raise self._refused("is part of a run or of a campaign")
            self._check_place()
            there = next(each for each in (home, *home.parents) if _what(each))
            if not there.is_dir():
                raise self._refused(f"lies below {there}, which is {_what(there)}")
            if not os.access(there, os.W_OK | os.X_OK):
                raise self._refused(f"cannot be written: {there} is not to be written in")

    @contextmanager
    def writing(self) -> Iterator[Path]:
        """Give a with-block a path to write to; what it wrote becomes the output at once.

        Where the block fails nothing is left of it but parent folders, and what was there before is as it
        was. Raises `DiskFull` or `OutputError` where it cannot be written.
        """
        self.check()
        home = self.path.absolute().parent
        with writing(self.path, self.instead):
            home.mkdir(parents=True, exist_ok=True)
            with TemporaryDirectory(dir=home, prefix=".", suffix=".part", ignore_cleanup_errors=True) as part:
                made = Path(part) / self.path.name
                yield made
                _put_in_place(made, self.path, Path(part) / f"{made.name}.old" if self.force else None)

    @abstractmethod
    def _check_place(self) -> None:
        """Check that what is at the path may be replaced."""

    def _check_new(self) -> None:
        """Refuse to replace what is there, unless forced."""
        if not self.force:
            raise OutputError(self.path, "is there already", self.instead, forces=self.force is not None)

    def _refused(self, why: str) -> OutputError:
        return OutputError(self.path, why, self.instead)


@dataclass(frozen=True)
class OutFile(Output):
    """A file."""

    suffixes: tuple[str, ...] = ()
    """Allowed endings of its name; empty: any."""
    inputs: tuple[Path, ...] = ()
    """Files that the command reads and never replaces; missing ones are passed over."""
    is_kind: Callable[[Path], bool] = lambda _: True
    """Returns True for a file that force may replace."""

    def write(self, payload: bytes) -> None:
        """Write it; raises as `writing`."""
        with self.writing() as made:
            made.write_bytes(payload)

    def _check_place(self) -> None:
        if self.suffixes and self.path.suffix.lower() not in self.suffixes:
            raise self._refused(f"must end with {' or '.join(self.suffixes)}")
        if not (what := _what(self.path)):
            return
        if what != FILE:
            raise self._refused(f"is {what}, where {FILE} is to be written")
        if any(is_file(each) and self.path.samefile(each) for each in self.inputs):
            raise self._refused("is a file that is read here")
        self._check_new()
        if not self.is_kind(self.path):
            raise self._refused("is there already, and was not made by qdgrasp")


@dataclass(frozen=True)
class OutFolder(Output):
    """A folder of its own; an empty one that is there becomes it."""

    is_kind: Callable[[Path], bool] = lambda _: False
    """Returns True for a folder of the kind that may be replaced."""

    def _check_place(self) -> None:
        what = _what(self.path)
        if what not in ("", FOLDER):
            raise self._refused(f"is {what}, where {FOLDER} is to be written")
        if names := _names(self.path):
            if not self.is_kind(self.path):
                raise self._refused(f"holds other files ({first_few(names, SHOWN)})")
            self._check_new()


def _names(folder: Path) -> list[str]:
    """Return the names in a folder, without what a killed command was writing."""
    there = folder.iterdir() if folder.is_dir() else ()
    return sorted(each.name for each in there if not (each.name[0] == "." and each.suffix == ".part"))


def _what(path: Path) -> str:
    """Describe the kind of entry at a path; empty: nothing is there."""
    try:
        mode = path.lstat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return ""
    if stat.S_ISLNK(mode):
        return "a link" if path.exists() else "a link to nothing"
    return FILE if stat.S_ISREG(mode) else FOLDER if stat.S_ISDIR(mode) else "a device or pipe"
