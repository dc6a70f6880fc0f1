"""Where assets lie: the folders of the asset path, and the cache."""

import os
from pathlib import Path

ASSET_PATH = "QDGRASP_ASSET_PATH"
CACHE = "QDGRASP_CACHE"


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
    own = os.environ.get(CACHE)
    if own:
        return Path(own).expanduser()
    return Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "qdgrasp"
