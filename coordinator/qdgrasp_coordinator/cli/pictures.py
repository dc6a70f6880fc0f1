"""Where a command draws pictures, if it is told to."""

from pathlib import Path

from qdgrasp_coordinator.folders.outputs import SharedFolder


def picture_folder(path: Path | None, flag: str) -> SharedFolder | None:
    """The folder that a flag names for pictures; None: none are asked for.

    Raises
    ------
    OutputError
        They cannot be written there.
    """
    if path is None:
        return None
    folder = SharedFolder(path, f"name another path with {flag}")
    folder.check()
    return folder
