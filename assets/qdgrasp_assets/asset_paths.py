"""Places of assets: the folders of the asset path, downloaded data, and the cache."""

import errno
import math
import os
import stat
import tempfile
import tomllib
from pathlib import Path
from typing import TypeVar

import msgspec

from qdgrasp_protocol.errors import AssetError, UnreadableHere

T = TypeVar("T")

ASSET_PATH = "QDGRASP_ASSET_PATH"
CACHE = "QDGRASP_CACHE"
DATA = "QDGRASP_DATA"
UNFINISHED = ".unfinished-"  # Beginning of the names of files that are being written
NOT_THERE, A_FOLDER, SPECIAL = "does not exist", "is a folder", "is no ordinary file"
"""Reasons why a path has no ordinary file, as the end of a sentence."""


def named_path(name: str | Path) -> Path:
    """Return the path that a user names, with `~` expanded where there is a home."""
    try:
        return Path(name).expanduser()
    except RuntimeError:  # the home of an unknown user
        return Path(name)


def path_problem(path: Path) -> str:
    """Return why a path is no ordinary file to read, as the end of a sentence; empty: it is.

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
        return "" if os.access(path, os.R_OK) else "may not be read"
    return A_FOLDER if stat.S_ISDIR(mode) else SPECIAL


def read_table(path: Path, kind: type[T], name: str, page: str) -> T:
    """Read a TOML file of some kind, which has this name and is described on a page.

    `AssetError` if it is absent, or has other keys or kinds, or numbers that are not finite.
    """
    if why := path_problem(path):
        raise AssetError(f"No {name} can be read at '{path}': it {why}; name a {name}'s TOML file.")
    try:
        return msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8-sig"), parse_float=_finite), kind)
    except OSError as error:
        raise AssetError(f"No {name} can be read at '{path}': {error.strerror or error}.") from None
    except (ValueError, RecursionError) as error:
        raise AssetError(f"'{path}' is no {name}'s file: {error}; {page} says what each key holds.") from None


def _finite(text: str) -> float:
    """Return the number of a text; `ValueError` for nan and inf, which TOML knows."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"numbers are finite, got {text}")
    return value


def on_asset_path(relative: str) -> Path | None:
    """Return the first match of a relative name on the asset path; None if not found."""
    folders = map(named_path, filter(None, os.environ.get(ASSET_PATH, "").split(os.pathsep)))
    return next((found for folder in folders if (found := folder / relative).exists()), None)


def searched() -> str:
    """Describe the asset path that was searched, for an error."""
    value = os.environ.get(ASSET_PATH)
    return f"{ASSET_PATH} is '{value}'" if value else f"{ASSET_PATH} is not set"


def cache_folder() -> Path:
    """Return the folder of derived data, deletable at any time: `QDGRASP_CACHE`, else XDG's."""
    return _own_folder(CACHE, "XDG_CACHE_HOME", "~/.cache")


def write_whole(file: Path, content: bytes) -> None:
    """Write a file and its folder, whole or not at all; else `OSError`."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=file.parent, prefix=UNFINISHED) as folder:
        written = Path(folder) / file.name
        written.write_bytes(content)
        written.replace(file)


def data_folder() -> Path:
    """Return the folder of fetched data: `QDGRASP_DATA`, else XDG's."""
    return _own_folder(DATA, "XDG_DATA_HOME", "~/.local/share")


def _own_folder(variable: str, xdg: str, default: str) -> Path:
    own = os.environ.get(variable)
    folder = named_path(own) if own else named_path(os.environ.get(xdg) or default) / "qdgrasp"
    if str(folder).startswith("~"):
        raise UnreadableHere(f"There is no home folder for '{folder}': set {variable} to a folder.")
    return folder
