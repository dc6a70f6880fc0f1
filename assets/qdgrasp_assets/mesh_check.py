"""Checks of mesh files as objects, remembered by content.

Findings for the bytes of a file, at a scale, with the same changes, by the same version of the checking
code, are read again without reading triangles. Entries lie in the cache folder; any of them may be deleted,
and one that cannot be read is made again. A file that could not be read is tried again each time.
"""

import hashlib
from contextlib import suppress
from pathlib import Path

import msgspec
from msgspec import Struct

from qdgrasp_assets.asset_paths import cache_folder, write_whole
from qdgrasp_assets.code_version import checking_code, file_digest
from qdgrasp_assets.geometry.mesh_io import check_file, linked_files
from qdgrasp_assets.object_model import ObjectDraft, read_draft
from qdgrasp_protocol.build_messages import MeshPreparation
from qdgrasp_protocol.errors import AssetError


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

    Bodies with air between them are a fault unless they are said to be glued. Raises AssetError where there
    is no place for a cache, and no other error.
    """
    cache = cache_folder() / "checked"
    try:
        check_file(path)
        entry = cache / f"{_content_key(path, repr((scale, preparation)))}.json"
        with suppress(OSError, msgspec.MsgspecError, RecursionError):
            return msgspec.json.decode(entry.read_bytes(), type=MeshCheck)
        found = _check(read_draft(path, scale, preparation), preparation)
    except AssetError as error:
        return MeshCheck(faults=(str(error).replace(f"'{path}' ", "").rstrip("."),))
    except OSError as error:
        return MeshCheck(faults=(f"it cannot be read: {error.strerror or error}",))
    except Exception as error:  # noqa: BLE001  # one mesh of thousands ends no campaign
        return MeshCheck(faults=(f"its check failed: {type(error).__name__}: {error}; draw it again",))
    with suppress(OSError):  # a cache that cannot be written is no error
        write_whole(entry, msgspec.json.encode(found))
    return found


def _check(draft: ObjectDraft, preparation: MeshPreparation | None) -> MeshCheck:
    mesh, faults = draft.mesh, draft.object_faults(glued=bool(preparation and preparation.glued))
    volume = 0.0 if draft.faults else mesh.volume
    return MeshCheck(faults=faults, volume=volume, triangles=len(mesh.faces), repairs=draft.repairs)


def _content_key(path: Path, asked: str) -> str:
    """Return the sha256 of a mesh file's bytes, what is asked of it, and the checking code."""
    digests = [file_digest(file) for file in (path, *linked_files(path))]
    return hashlib.sha256(
        " ".join((*digests, path.suffix.lower(), asked, checking_code())).encode()
    ).hexdigest()
