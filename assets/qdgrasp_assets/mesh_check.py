"""Checks of mesh files as objects, remembered by content.

What was found for the bytes of a file, at a scale, with the same changes, by the same version of the checking
code, is found again without reading triangles. Entries lie in the cache folder; any of them may be deleted,
and one that cannot be read is made again.
"""

import hashlib
import sys
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path

import msgspec
from msgspec import Struct

from qdgrasp_assets.asset_paths import cache_folder
from qdgrasp_assets.geometry.mesh_io import linked_files
from qdgrasp_assets.geometry.mesh_repair import gap_note
from qdgrasp_assets.object_model import ObjectDraft, check_header, read_draft
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.spec import MeshPreparation

CHECKING_MODULES = (
    *(
        "qdgrasp_assets.geometry.mesh",
        "qdgrasp_assets.geometry.mesh_io",
        "qdgrasp_assets.geometry.mesh_repair",
    ),
    *("qdgrasp_assets.geometry.primitives", "qdgrasp_assets.geometry.proximity"),
    *("qdgrasp_assets.geometry.remesh", "qdgrasp_assets.geometry.surface_points"),
    *("qdgrasp_assets.object_model", __name__),
)
CHECKING_PACKAGES = ("embreex", "fast-simplification", "numpy", "scipy", "trimesh")


class MeshCheck(Struct, frozen=True, kw_only=True):
    """Result of the check of a mesh file."""

    faults: tuple[str, ...]
    """Reasons why no object can be made of it, each followed by what to do about it; empty where one can."""
    volume: float = 0.0
    """[m3]."""
    triangles: int = 0
    repairs: tuple[str, ...] = ()


def check_mesh(
    path: Path, scale: float | None = None, preparation: MeshPreparation | None = None
) -> MeshCheck:
    """Check that an object can be made of a mesh file; the parameters are those of `read_draft`.

    Bodies with air between them are a fault unless they are said to be glued.
    """
    entry = None
    try:
        check_header(path, preparation)
        entry = cache_folder() / "checked" / f"{_content_key(path, repr((scale, preparation)))}.json"
        with suppress(OSError, msgspec.MsgspecError, RecursionError):
            return msgspec.json.decode(entry.read_bytes(), type=MeshCheck)
        found = _check(read_draft(path, scale, preparation), preparation)
    except AssetError as error:
        found = MeshCheck(faults=(str(error).replace(f"'{path}' ", "").rstrip("."),))
    except OSError as error:
        return MeshCheck(faults=(f"it cannot be read: {error.strerror or error}",))
    except Exception as error:  # noqa: BLE001  # one mesh of thousands ends no campaign
        return MeshCheck(faults=(f"its check failed: {type(error).__name__}: {error}; draw it again",))
    if entry is not None:
        _keep(entry, msgspec.json.encode(found))
    return found


def _check(draft: ObjectDraft, preparation: MeshPreparation | None) -> MeshCheck:
    faults, mesh = draft.faults, draft.mesh
    if not faults and not (preparation and preparation.glued) and (gap := gap_note(mesh)):
        faults = (gap,)
    volume = 0.0 if draft.faults else mesh.volume
    return MeshCheck(faults=faults, volume=volume, triangles=len(mesh.faces), repairs=draft.repairs)


def _content_key(path: Path, asked: str) -> str:
    """Return the sha256 of a mesh file's bytes, what is asked of it, and the checking code."""
    digests = [file_digest(file) for file in (path, *linked_files(path))]
    return hashlib.sha256(
        " ".join((*digests, path.suffix.lower(), asked, _code_version())).encode()
    ).hexdigest()


def file_digest(path: Path) -> str:
    """Return the sha256 of a file's bytes; of no bytes where there is no such file."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        return hashlib.sha256().hexdigest()


@cache
def _code_version() -> str:
    """Return the digests of the modules that check, and the versions of their packages."""
    sources: Iterable[str | None] = (sys.modules[name].__file__ for name in CHECKING_MODULES)
    digests = [file_digest(Path(source)) for source in sources if source]
    return " ".join((*digests, *(f"{name} {version(name)}" for name in CHECKING_PACKAGES)))


def _keep(entry: Path, content: bytes) -> None:
    """Write an entry whole or not at all; a cache that cannot be written is no error."""
    with suppress(OSError):
        entry.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=entry.parent, delete=False) as file:
            file.write(content)
        Path(file.name).replace(entry)
