"""Special files in the place of a mesh, which would be waited for or read for ever."""

import os
from pathlib import Path

PLACES = {
    "pipe.stl": "is no ordinary file",
    "device.stl": "is no ordinary file",
    "folder.stl": "is a folder",
    "circle.stl": "cannot be looked at (Too many levels of symbolic links)",
    "none.stl": "does not exist",
}
"""Names, and what is told of each."""


def make_places(folder: Path) -> None:
    """Put them into a folder."""
    os.mkfifo(folder / "pipe.stl")
    (folder / "device.stl").symlink_to("/dev/zero")
    (folder / "folder.stl").mkdir()
    (folder / "circle.stl").symlink_to("circle.stl")
