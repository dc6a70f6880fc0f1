"""Where a command draws pictures, if it is told to."""

from collections.abc import Iterable
from pathlib import Path

from qdgrasp_coordinator.analysis.signature import is_signed
from qdgrasp_coordinator.folders.outputs import OutFile, SharedFolder
from qdgrasp_protocol.errors import InputError


def picture_folder(path: Path | None, flag: str, names: Iterable[str]) -> SharedFolder | None:
    """The folder that a flag names for the pictures of what has these names; None: none are asked for.

    Raises
    ------
    OutputError
        They cannot be written there.
    InputError
        Two of them would be one file.
    """
    if path is None:
        return None
    folder = SharedFolder(path, f"name another path with {flag}")
    folder.check()
    drawn: dict[Path, str] = {}
    for name in dict.fromkeys(names):
        file = picture(folder, name)
        file.check()
        if (other := drawn.setdefault(file.path, name)) != name:
            raise InputError(
                f"'{other}' and '{name}' would both be drawn to '{file.path}'; name them in two commands, "
                f"with another {flag} for each."
            )
    return folder


def picture(folder: SharedFolder, name: str) -> OutFile:
    """The picture of what has a name, in the place of an earlier one that was drawn here."""
    return folder.file(f"{Path(name).stem}.png", is_kind=is_signed)
