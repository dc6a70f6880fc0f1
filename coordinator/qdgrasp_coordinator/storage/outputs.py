"""Files and folders that a command writes, and the names of those that make a run or a job.

One rule for all outputs (docs/decisions/0012-outputs-and-exports.md). Whether they can be written is checked
before the work for them is begun. Existing files stay, unless `--force` replaces them; files of a run always
stay. Parent folders are made when there is something to write. An output appears whole or not at all.
"""

import os
import stat
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from qdgrasp_coordinator.storage import atomic_files
from qdgrasp_protocol.errors import OutputError
from qdgrasp_protocol.text import first_few

PNG_SIGNATURE = {"Software": "qdgrasp"}  # Metadata that `savefig` writes into a PNG file
PNG_HEAD = 4096  # Bytes of a file that are looked at

JOB, ENDPOINT, LOCK, SUPERVISED = "job.json", "endpoint", "lock", "supervised"
CAMPAIGN, LOGS, RUNS = "campaign.toml", "logs", "runs"
SPEC, SCENE, JOURNAL = "spec.toml", "scene.bundle", "run.sqlite"
SOURCE, RANKING = "source.json", "ranking.csv"  # Of a run that scores the grasps of another one again
FINISHED = "finished.jsonl"  # Of a campaign: the sums of its finished runs
SKIPPED = "skipped.csv"  # Of a campaign that goes on without objects that cannot be used
ORIGIN = "warm_start.json"  # Of a run that begins with weights that others learned
MARKS = (JOB, CAMPAIGN, SCENE, JOURNAL)
"""Files that each mark the folder of a run or job, also where others are missing."""
PARTS = frozenset(
    [*MARKS, ENDPOINT, LOCK, SUPERVISED, LOGS, RUNS, SPEC, SOURCE, RANKING, ORIGIN, SKIPPED, FINISHED]
    + [JOURNAL + suffix for suffix in ("-wal", "-shm")]
)


def is_part_of_run(path: Path) -> bool:
    """Return whether a path is, or would be, one of the files that make a run or a job."""
    return path.name in PARTS and any((path.absolute().parent / mark).exists() for mark in MARKS)


STDOUT = Path("-")
FILE, FOLDER = "a file", "a folder"
SHOWN = 3  # Most file names listed where other files are in the way


@dataclass(frozen=True)
class Output(ABC):
    """A file or folder that a command writes at a path."""

    path: Path
    instead: str = "name another path with --out"
    """Advice for the case that it cannot be written."""

    def check(self) -> None:
        """Check that it can be written, before the work for it is begun; else raise `OutputError`."""
        with atomic_files.writing(self.path, self.instead):
            if self.path == STDOUT:
                raise self._refused("would be standard output, where no output goes")
            if is_part_of_run(self.path):
                raise self._refused("is part of a run or of a campaign")
            self._check_place()
            self._check_way()

    @property
    def _home(self) -> Path:
        return self.path.absolute().parent

    @abstractmethod
    def _check_place(self) -> None:
        """Check that what is at the path may be replaced, or added to."""

    def _check_way(self) -> None:
        """Check that its folder can be written in, or made."""
        there = next(each for each in (self._home, *self._home.parents) if _what(each))
        if not there.is_dir():
            raise self._refused(f"lies below {there}, which is {_what(there)}")
        if not os.access(there, os.W_OK | os.X_OK):
            raise self._refused(f"cannot be written: {there} is not to be written in")

    def _refused(self, why: str) -> OutputError:
        return OutputError(self.path, why, self.instead)


@dataclass(frozen=True)
class WholeOutput(Output):
    """An output that appears whole or not at all."""

    @contextmanager
    def writing(self) -> Iterator[Path]:
        """Give a with-block a path to write to; what it wrote becomes the output at once.

        Where the block fails nothing is left of it, and what was there before is as it was. Raises `DiskFull`
        or `OutputError` where it cannot be written.
        """
        self.check()
        with atomic_files.writing(self.path, self.instead), atomic_files.staging_folder(self.path) as part:
            self.check()  # what a killed process had moved away is back
            made = part / "new" / self.path.name
            made.parent.mkdir()
            yield made
            atomic_files.put_in_place(made, self.path, part / atomic_files.OLD)


@dataclass(frozen=True)
class OutFile(WholeOutput):
    """A file."""

    suffixes: tuple[str, ...] = ()
    """Allowed endings of its name; empty: any."""
    force: bool | None = False
    """True: a file that is there is replaced; None: it is not, and there is no flag for it."""
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
        what = _what(self.path)
        if what not in ("", FILE):
            raise self._refused(f"is {what}, where {FILE} is to be written")
        if what and any(atomic_files.is_file(each) and self.path.samefile(each) for each in self.inputs):
            raise self._refused("is a file that is read here")
        if what and not self.force:
            raise OutputError(self.path, "is there already", self.instead, forces=self.force is not None)
        if what and not self.is_kind(self.path):
            raise self._refused("is there already, and was not made by qdgrasp")


@dataclass(frozen=True)
class OutFolder(WholeOutput):
    """A folder of its own; an empty one that is there becomes it."""

    force: bool | None = None
    """True: a folder of the kind is replaced; None: it is not, and there is no flag for it."""
    is_kind: Callable[[Path], bool] = lambda _: False
    """Returns True for a folder of the kind that may be replaced."""

    def _check_place(self) -> None:
        what = _what(self.path)
        if what not in ("", FOLDER):
            raise self._refused(f"is {what}, where {FOLDER} is to be written")
        names = _names(self.path)
        if names and not self.is_kind(self.path):
            raise self._refused(_others(names))
        if names and not self.force:
            raise OutputError(self.path, "is there already", self.instead, forces=self.force is not None)


@dataclass(frozen=True)
class SharedFolder(Output):
    """A folder that files are put into, beside those that are there."""

    is_kind: Callable[[Path], bool] = lambda _: True
    """Returns True for a folder, not empty, that files may be put into."""
    mark: str = ""
    """The file by which `is_kind` knows such a folder; it takes its place before the others."""

    def file(self, name: str, is_kind: Callable[[Path], bool] = lambda _: True) -> OutFile:
        """A file in it, in the place of an earlier one of the name and the kind."""
        return OutFile(self.path / name, self.instead, force=True, is_kind=is_kind)

    @contextmanager
    def filling(self) -> Iterator[Path]:
        """Give a with-block a new folder to write files to; each then takes its place at once.

        Where the block fails none of them does. Raises as `writing`.
        """
        self.check()
        with atomic_files.writing(self.path, self.instead), atomic_files.staging_folder(self._staged) as part:
            yield part
            files = sorted(part.iterdir(), key=lambda made: (made.name != self.mark, made.name))
            for made in files:
                self.file(made.name).check()
            for made in files:
                atomic_files.put_in_place(made, self.path / made.name, part)

    @property
    def _home(self) -> Path:
        return self.path.absolute()

    def _check_place(self) -> None:
        what = _what(self.path)
        if what and not self.path.is_dir():
            raise self._refused(f"is {what}, where {FOLDER} is to be written")
        names = _names(self.path, self._staged)
        if names and not self.is_kind(self.path):
            raise self._refused(_others(names))

    @property
    def _staged(self) -> Path:
        """Path after which its temporary folders are named."""
        return self.path / "new"


def _names(folder: Path, staged: Path | None = None) -> list[str]:
    """Return the names in a folder, without those of temporary folders of `staged`."""
    there = folder.iterdir() if folder.is_dir() else ()
    return sorted(each.name for each in there if not (staged and atomic_files.is_staging(each, staged)))


def _others(names: list[str]) -> str:
    return f"holds other files ({first_few(names, SHOWN)})"


def _what(path: Path) -> str:
    """Describe the kind of entry at a path; empty: nothing is there."""
    try:
        mode = path.lstat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return ""
    if stat.S_ISLNK(mode):
        return "a link" if path.exists() else "a link to nothing"
    return FILE if stat.S_ISREG(mode) else FOLDER if stat.S_ISDIR(mode) else "a device or pipe"


def is_drawn_here(path: Path) -> bool:
    """Return whether a file is a PNG that was drawn here."""
    with path.open("rb") as file:
        head = file.read(PNG_HEAD)
    return head.startswith(b"\x89PNG") and b"tEXtSoftware\0qdgrasp" in head
