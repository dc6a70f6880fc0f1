"""One file out of a gzipped tar archive: nothing else is unpacked, and no name in it is ever a path here."""

import tarfile
import zlib
from pathlib import Path, PurePosixPath

from qdgrasp_protocol.errors import AssetError

LARGEST_MEMBER = 1 << 28  # bytes; the mesh of a scan has one or two megabytes
LARGEST_WHOLE = 1 << 31
BLOCK = 512  # bytes of a header


def read_member(archive: Path, member: str) -> bytes:
    """The content of the file `member` of a `.tgz`.

    Raises
    ------
    AssetError
        There is no such file in it, it is no file or too large, or the archive is none or broken.
    """
    try:
        with tarfile.open(archive, mode="r|gz") as tar:
            return _search(tar, archive, member)
    except (tarfile.TarError, zlib.error, EOFError, OSError) as error:
        raise AssetError(f"'{archive.name}' is not a whole tar archive: {error}.") from None


def _search(tar: tarfile.TarFile, archive: Path, member: str) -> bytes:
    unpacked = 0
    for entry in tar:
        unpacked += BLOCK + entry.size
        if unpacked > LARGEST_WHOLE:
            raise AssetError(f"'{archive.name}' unpacks to more than {LARGEST_WHOLE} bytes.")
        if PurePosixPath(entry.name) == PurePosixPath(member):
            return _content(tar, entry, archive)
    raise AssetError(f"There is no '{member}' in '{archive.name}'.")


def _content(tar: tarfile.TarFile, entry: tarfile.TarInfo, archive: Path) -> bytes:
    file = tar.extractfile(entry) if entry.isreg() else None
    if file is None:
        raise AssetError(f"'{entry.name}' in '{archive.name}' is not a file.")
    if entry.size > LARGEST_MEMBER:
        raise AssetError(f"'{entry.name}' in '{archive.name}' has {entry.size} bytes, too many for a scan.")
    return file.read()
