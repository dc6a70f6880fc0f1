"""Where assets lie: the folders of the asset path, what was fetched, and the cache."""

import errno
import os
import stat
from pathlib import Path

ASSET_PATH = "QDGRASP_ASSET_PATH"
CACHE = "QDGRASP_CACHE"
DATA = "QDGRASP_DATA"
NOT_THERE, A_FOLDER, SPECIAL = "does not exist", "is a folder", "is no ordinary file"
"""What can be amiss with the place of a file, as the end of a sentence."""


def named_path(name: str | Path) -> Path:
    """The file that a user names: `~` is their home; where it can mean no home, it is what it is."""
    try:
        return Path(name).expanduser()
    except RuntimeError:  # the home of somebody who is not there
        return Path(name)


def amiss(path: Path) -> str:
    """Why there is no ordinary file at a path, as the end of a sentence; empty where there is one.

    A pipe is never waited for, and a device never read.
    """
    try:
        mode = path.stat().st_mode
    except OSError as error:
        is_absent = error.errno in (errno.ENOENT, errno.ENOTDIR)
        return NOT_THERE if is_absent else f"cannot be looked at ({error.strerror})"
    except ValueError:  # a name that no file can have
        return NOT_THERE
    if stat.S_ISREG(mode):
        return ""
    return A_FOLDER if stat.S_ISDIR(mode) else SPECIAL


def asset_folders() -> tuple[Path, ...]:
    """The folders that `QDGRASP_ASSET_PATH` names, separated by colons, in order."""
    return tuple(Path(part).expanduser() for part in os.environ.get(ASSET_PATH, "").split(os.pathsep) if part)


def on_asset_path(relative: str) -> Path | None:
    """The first file or folder of this relative name on the asset path; None when there is none."""
    return next((found for folder in asset_folders() if (found := folder / relative).exists()), None)


def searched() -> str:
    """Where a search on the asset path looked, in words for an error."""
    value = os.environ.get(ASSET_PATH)
    return f"{ASSET_PATH} is '{value}'" if value else f"{ASSET_PATH} is not set"


def cache_folder() -> Path:
    """The folder of derived data, which may be deleted at any time: `QDGRASP_CACHE`, else XDG's."""
    return _own_folder(CACHE, "XDG_CACHE_HOME", "~/.cache")


def data_folder() -> Path:
    """The folder of what was fetched: `QDGRASP_DATA`, else XDG's."""
    return _own_folder(DATA, "XDG_DATA_HOME", "~/.local/share")


def _own_folder(variable: str, xdg: str, default: str) -> Path:
    own = os.environ.get(variable)
    if own:
        return Path(own).expanduser()
    return Path(os.environ.get(xdg) or default).expanduser() / "qdgrasp"
