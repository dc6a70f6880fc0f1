"""Convex parts kept on disk: an OBJ file that ends with the digest of what stands before, or counts as none.

The last line is a remark, which readers of OBJ files leave aside
(docs/decisions/0008-collision-decomposition.md).
"""

import hashlib
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

from qdgrasp_assets.files import amiss
from qdgrasp_assets.mesh import Mesh, parts_to_obj, read_parts
from qdgrasp_protocol.errors import AssetError


def read_kept(file: Path) -> tuple[Mesh, ...] | None:
    """The parts in a file of `keep`; None where there is none, or not as it was written."""
    return read_parts(file) if not amiss(file) and _is_whole(file) else None


def keep(parts: Iterable[Mesh], target: Path, name: str) -> tuple[Mesh, ...]:
    """Write parts to `target`, whole or not at all; given back are those that `read_kept` reads.

    Raises
    ------
    AssetError
        They cannot be written; `name` is what they are parts of.
    """
    content = parts_to_obj(parts)
    try:
        with tempfile.TemporaryDirectory(dir=target.parent) as folder:
            file = Path(folder) / target.name
            with file.open("wb") as stream:
                stream.write(content + _seal(content))
                stream.flush()
                os.fsync(stream.fileno())
            file.replace(target)
        return read_parts(target)
    except OSError as error:
        raise _not_kept(target.parent, name, error) from None


def make_folder(folder: Path, name: str) -> None:
    """Make the folder of the parts of `name`.

    Raises
    ------
    AssetError
        It cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _not_kept(folder, name, error) from None


def _is_whole(file: Path) -> bool:
    try:
        content = file.read_bytes()
    except OSError:
        return False
    start = content.rfind(b"#")
    return start > 0 and content[start:] == _seal(content[:start])


def _seal(content: bytes) -> bytes:
    """The last line of a file."""
    return f"# sha256 {hashlib.sha256(content).hexdigest()}\n".encode()


def _not_kept(folder: Path, name: str, error: OSError) -> AssetError:
    return AssetError(
        f"The convex parts of '{name}' cannot be kept in '{folder}': {error.strerror or error}; "
        "name another folder with QDGRASP_CACHE."
    )
