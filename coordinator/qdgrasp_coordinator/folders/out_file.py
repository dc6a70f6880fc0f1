"""Files that a command writes because it was told to: what is there already is kept unless it says so."""

from dataclasses import dataclass
from pathlib import Path

from qdgrasp_coordinator.folders import disk
from qdgrasp_protocol.errors import FolderError


@dataclass(frozen=True)
class OutFile:
    """A file to be written."""

    path: Path
    suffixes: tuple[str, ...]
    """What its name may end with."""
    force: bool = False
    """Whether a file that is there already may be replaced."""

    def check(self) -> None:
        """Check that the file may be written, before the work for it is begun.

        Raises
        ------
        FolderError
            Its name ends otherwise, its folder is not there, or something else is in its place.
        """
        if self.path.suffix.lower() not in self.suffixes:
            raise FolderError(f"'{self.path}' must end with {' or '.join(self.suffixes)}; name another file.")
        if not self.path.absolute().parent.is_dir():
            raise FolderError(f"'{self.path}' is in no folder that there is; make it, or name another file.")
        disk.check_file(self.path, force=self.force)

    def write(self, payload: bytes) -> None:
        """Write the file, whole or not at all.

        Raises
        ------
        DiskFull, FolderError
            It cannot be written.
        """
        self.check()
        with disk.writing(self.path.absolute().parent):
            disk.write(self.path, payload)


def picture_folder(path: Path) -> Path:
    """A folder for pictures, which is made where it is not there.

    Raises
    ------
    DiskFull, FolderError
        It is a file, or cannot be made.
    """
    if path.exists() and not path.is_dir():
        raise FolderError(f"'{path}' is a file, and pictures go into a folder; name another one.")
    with disk.writing(path):
        path.mkdir(parents=True, exist_ok=True)
    return path
