"""Where a command draws pictures, if it is told to."""

from collections.abc import Iterable
from pathlib import Path

from qdgrasp_coordinator.analysis.signature import is_signed
from qdgrasp_coordinator.folders.outputs import OutFile, SharedFolder


def picture_folder(path: Path | None, flag: str, names: Iterable[str]) -> SharedFolder | None:
    """The folder that a flag names for the pictures of what has these names; None: none are asked for.

    Raises
    ------
    OutputError
        They cannot be written there.
    """
    if path is None:
        return None
    folder = SharedFolder(path, f"name another path with {flag}")
    folder.check()
    for name in names:
        picture(folder, name).check()
    return folder


def picture(folder: SharedFolder, name: str) -> OutFile:
    """The picture of what has a name, in the place of an earlier one that was drawn here."""
    return folder.file(f"{Path(name).stem}.png", is_kind=is_signed)
