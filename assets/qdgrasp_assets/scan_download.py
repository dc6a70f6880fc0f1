"""Download of YCB scans, accepted only with a known hash or the expected dimensions.

One file is taken out of a gzipped tar archive: nothing else is unpacked, and no name in it becomes a path
here.
"""

import hashlib
import tarfile
import tempfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from qdgrasp_assets.asset_paths import data_folder, write_whole
from qdgrasp_assets.geometry.mesh_io import read_mesh
from qdgrasp_assets.geometry.mesh_repair import surface_faults
from qdgrasp_assets.ycb import (
    SCANS,
    ArchivePin,
    Scan,
    correct_mesh,
    fetched_mesh,
    read_pin,
    scan_differences,
    users_lock,
    write_pin,
)
from qdgrasp_protocol.errors import AssetError, UnknownName

LARGEST_MEMBER = 1 << 28  # bytes; the mesh of a scan has one or two megabytes
LARGEST_WHOLE = 1 << 31
TAR_HEADER = 512  # bytes of a header


def read_member(archive: Path, member: str) -> bytes:
    """Return the file `member` of a `.tgz`; `AssetError` if missing, too large or broken."""
    unpacked = 0
    try:
        with tarfile.open(archive, mode="r|gz") as tar:
            for entry in tar:
                unpacked += TAR_HEADER + entry.size
                if unpacked > LARGEST_WHOLE:
                    raise AssetError(f"'{archive.name}' unpacks to more than {LARGEST_WHOLE} bytes.")
                if PurePosixPath(entry.name) == PurePosixPath(member):
                    break
            else:
                raise AssetError(f"There is no '{member}' in '{archive.name}'.")
            file = tar.extractfile(entry) if entry.isreg() else None
            if file is None:
                raise AssetError(f"'{entry.name}' in '{archive.name}' is not a file.")
            if entry.size > LARGEST_MEMBER:
                size = f"{entry.size} bytes, too many for a scan"
                raise AssetError(f"'{entry.name}' in '{archive.name}' has {size}.")
            return file.read()
    except (tarfile.TarError, zlib.error, EOFError, OSError) as error:
        raise AssetError(f"'{archive.name}' is not a whole tar archive: {error}.") from None


SILENCE_LIMIT = 30.0  # s without a byte
LARGEST_DOWNLOAD = 1 << 29  # bytes; the archives of scans have tens of megabytes

Progress = Callable[[int, int | None], None]
"""Called with the bytes received and the bytes expected, None if the server does not say."""


class _ProgressBar:
    """A progress bar as pooch calls it, with a limit on the bytes of a download."""

    def __init__(self, progress: Progress) -> None:
        self._progress, self._here = progress, 0
        self.total = 0  # Bytes expected, which pooch sets

    def update(self, count: int) -> None:
        """Count bytes that came; AssetError for too many."""
        self._here += count
        if max(self._here, self.total) > LARGEST_DOWNLOAD:
            raise AssetError(f"it has more than the {LARGEST_DOWNLOAD} bytes that a scan may have.")
        self._progress(self._here, self.total or None)

    def reset(self) -> None:
        """Begin anew."""
        self._here = 0

    def close(self) -> None:
        """Leave the bar as it is."""


def download(url: str, file: Path, progress: Progress = lambda _here, _all: None) -> None:
    """Download `url`, http or https, into `file`, whole or not at all.

    Raises `AssetError` if there is no such file or the server cannot be reached, and `OSError` if the file
    cannot be written.
    """
    if not url.startswith(("http://", "https://")):
        raise AssetError(f"Scans are fetched from an http or https address, got '{url}'.")
    import pooch
    import requests

    pooch.get_logger().setLevel("WARNING")
    loader = pooch.HTTPDownloader(progressbar=_ProgressBar(progress), timeout=SILENCE_LIMIT)
    try:
        pooch.retrieve(url, known_hash=None, fname=file.name, path=file.parent, downloader=loader)
    except requests.RequestException as error:
        answer = error.response
        why = f"the server answers {answer.status_code} {answer.reason}" if answer is not None else str(error)
        raise AssetError(
            f"'{url}' cannot be fetched: {why}; is there a network, and a way to that address?"
        ) from None


YCB_HOME = "https://ycb-benchmarks.s3.amazonaws.com"  # The public bucket of the YCB Object and Model Set
YCB_TERMS = (
    "The scans are of the YCB Object and Model Set (Calli, Singh, Walsman, Srinivasa, Abbeel and Dollar "
    '2015), licence CC BY 4.0: whoever passes them on names "YCB Benchmarks - Object and Model Set".'
)


@dataclass(frozen=True)
class FetchedScan:
    """A scan that was fetched and accepted."""

    name: str
    mesh: Path
    pin: ArchivePin
    lock: Path | None
    """User's lock file, if the hash was not known before and was written there."""

    @property
    def sentence(self) -> str:
        """Description of the result for a person."""
        if self.lock is None:
            return f"{self.name}: fetched; its archive is the one that is known (sha256 {self.pin.sha256})."
        return (
            f"{self.name}: fetched; no hash of its archive was known, so it was accepted because the mesh "
            f"measures what it must; sha256 {self.pin.sha256} is now in {self.lock}."
        )


class WrongScan(AssetError):
    """Fetched data that is not the expected scan; it was deleted."""


def fetch_scan(name: str, home: str, progress: Progress) -> FetchedScan:
    """Fetch one of `SCAN_NAMES` into the data folder; it is checked first, and written whole.

    `home` is the address that the paths of the archives are below. Raises `UnknownName` if there is no such
    scan, `WrongScan` if it is not what it must be, and `AssetError` if it cannot be fetched or written.
    """
    if name not in SCANS:
        raise UnknownName("scan", name, SCANS, "Other objects are built in or mesh files of your own.")
    scan = SCANS[name]
    known = read_pin(scan.archive)
    archive = data_folder() / "downloads" / Path(scan.archive).name
    try:
        download(f"{home.rstrip('/')}/{scan.archive}", archive, progress)
        try:
            return _accept(name, scan, archive, known)
        except AssetError as error:
            raise WrongScan(f"The data fetched for '{name}' was thrown away: {error}") from None
        finally:
            archive.unlink(missing_ok=True)
    except OSError as error:
        raise AssetError(
            f"'{name}' cannot be kept in '{data_folder()}': {error.strerror or error}; name another folder "
            "with QDGRASP_DATA."
        ) from None


def _accept(name: str, scan: Scan, archive: Path, known: ArchivePin) -> FetchedScan:
    """Check hash and geometry, keep a new hash in the lock file, then put the mesh in place."""
    with archive.open("rb") as stream:
        sha256 = hashlib.file_digest(stream, "sha256").hexdigest()
    found = ArchivePin(size=archive.stat().st_size, sha256=sha256)
    _check_hash(known, found)
    content = read_member(archive, scan.member)
    found = ArchivePin(found.size, found.sha256, hashlib.sha256(content).hexdigest())
    _check_hash(known, found)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / Path(scan.member).name
        file.write_bytes(content)
        read = correct_mesh(read_mesh(file), scan)
    if wrong := scan_differences(read, scan) or surface_faults(read):
        raise AssetError(f"it is not that scan: {'; '.join(wrong)}.")
    lock = write_pin(scan.archive, found) if known.sha256 is None else None
    mesh = fetched_mesh(name)
    attribution = f"{scan.archive}: {scan.member}\n{YCB_TERMS}\n"
    write_whole(mesh.with_name("ATTRIBUTION.txt"), attribution.encode(), is_synced=True)
    write_whole(mesh, content, is_synced=True)
    return FetchedScan(name, mesh, found, lock)


def _check_hash(known: ArchivePin, found: ArchivePin) -> None:
    if differs := known.difference(found):
        raise AssetError(
            f"it is not the archive that is known: {differs}; fetch it again, and if the set itself has "
            f"changed, remove its table from {users_lock()}."
        )
