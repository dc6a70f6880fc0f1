"""Outputs: files and folders that a command writes because it was told where.

One rule for all of them (docs/decisions/0012-outputs-and-exports.md). Whether they can be written is looked
at before the work for them is begun. What is there stays, unless it is to be replaced by `--force`; what is
part of a run always stays. Folders on the way are made when there is something to write. An output appears
whole or not at all.
"""

import os
import stat
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from qdgrasp_coordinator.folders import disk
from qdgrasp_coordinator.folders.names import is_part
from qdgrasp_protocol.errors import OutputError
from qdgrasp_protocol.phrases import few

STDOUT = Path("-")
FILE, FOLDER = "a file", "a folder"
SHOWN = 3
"""Names of files that are told where others are in the way."""


@dataclass(frozen=True)
class Output(ABC):
    """What a command writes at a path."""

    path: Path
    instead: str = "name another path with --out"
    """What to do where it cannot be written."""

    def check(self) -> None:
        """Check that it can be written, before the work for it is begun.

        Raises
        ------
        OutputError
            Something else is in its place, or on the way to it.
        """
        with disk.writing(self.path, self.instead):
            if self.path == STDOUT:
                raise self._refused("would be standard output, where no output goes")
            if is_part(self.path):
                raise self._refused("is part of a run or of a campaign")
            self._check_place()
            self._check_way()

    @property
    def _home(self) -> Path:
        """The folder that it is written in."""
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
class Whole(Output):
    """What appears at once."""

    @contextmanager
    def writing(self) -> Iterator[Path]:
        """A path of the same name for a with-block to write to; what it wrote becomes the output at once.

        Where the block fails nothing is left of it, and what was there before is as it was.

        Raises
        ------
        DiskFull, OutputError
            It cannot be written.
        """
        self.check()
        with disk.writing(self.path, self.instead), disk.workshop(self.path) as part:
            made = part / "new" / self.path.name
            made.parent.mkdir()
            yield made
            disk.put(made, self.path, part / "old")


@dataclass(frozen=True)
class OutFile(Whole):
    """A file."""

    suffixes: tuple[str, ...] = ()
    """What its name may end with; none: with anything."""
    force: bool | None = False
    """Whether a file that is there is replaced; None: it is not, and the command has no flag for it."""
    inputs: tuple[Path, ...] = ()
    """Files that the command reads, which it never replaces; those that are not there are passed over."""
    is_kind: Callable[[Path], bool] = lambda _: True
    """Whether a file that is there may be replaced by force."""

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
        if what and any(disk.is_file(each) and self.path.samefile(each) for each in self.inputs):
            raise self._refused("is a file that is read here")
        if what and not self.force:
            raise OutputError(self.path, "is there already", self.instead, forces=self.force is not None)
        if what and not self.is_kind(self.path):
            raise self._refused("is there already, and was not made by qdgrasp")


@dataclass(frozen=True)
class OutFolder(Whole):
    """A folder of its own; an empty one that is there becomes it."""

    force: bool | None = None
    """Whether a folder of the kind that is there is replaced; None: it is not, there is no flag for it."""
    is_kind: Callable[[Path], bool] = lambda _: False
    """Whether a folder is of the kind that may be replaced."""

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
    """Whether files may be put into a folder that is there and not empty."""

    def file(self, name: str, is_kind: Callable[[Path], bool] = lambda _: True) -> OutFile:
        """A file in it, in the place of an earlier one of the name and the kind."""
        return OutFile(self.path / name, self.instead, force=True, is_kind=is_kind)

    @contextmanager
    def filling(self) -> Iterator[Path]:
        """A new folder for a with-block to write files to, each of which then takes its place at once.

        Where the block fails none of them does. Raises as `writing`.
        """
        self.check()
        with disk.writing(self.path, self.instead), disk.workshop(self.path / "new") as part:
            yield part
            files = sorted(part.iterdir())
            for made in files:
                self.file(made.name).check()
            for made in files:
                disk.put(made, self.path / made.name, part)

    @property
    def _home(self) -> Path:
        return self.path.absolute()

    def _check_place(self) -> None:
        what = _what(self.path)
        if what and not self.path.is_dir():
            raise self._refused(f"is {what}, where {FOLDER} is to be written")
        names = _names(self.path)
        if names and not self.is_kind(self.path):
            raise self._refused(_others(names))


def _names(folder: Path) -> list[str]:
    """What is in a folder; nothing, where none is."""
    return sorted(each.name for each in folder.iterdir()) if folder.is_dir() else []


def _others(names: list[str]) -> str:
    return f"holds other files ({few(names, SHOWN)})"


def _what(path: Path) -> str:
    """What is at a path; empty: nothing."""
    try:
        mode = path.lstat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return ""
    if stat.S_ISLNK(mode):
        return "a link" if path.exists() else "a link to nothing"
    return FILE if stat.S_ISREG(mode) else FOLDER if stat.S_ISDIR(mode) else "a device or pipe"
