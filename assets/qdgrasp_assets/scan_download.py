"""Download of YCB scans, accepted only with a known hash or the expected dimensions.

A download goes on where it broke off (HTTP ranges), with a limit on bytes and on silence. One file is taken
out of a gzipped tar archive: nothing else is unpacked, and no name in it becomes a path here.
"""

import hashlib
import http.client
import re
import ssl
import tarfile
import tempfile
import urllib.error
import urllib.request
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

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
from qdgrasp_protocol.errors import AssetError, UnknownName, WrongScan

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


ATTEMPTS = 5  # Consecutive connections without new bytes before a download is given up
SILENCE_LIMIT = 30.0  # s without a byte
LARGEST_DOWNLOAD = 1 << 29  # bytes; the archives of scans have tens of megabytes
CHUNK = 1 << 16
CONTENT_RANGE = re.compile(r"bytes (?:(\d+)-\d+|\*)/(\d+)")

Progress = Callable[[int, int | None], None]
"""Called with the bytes received and the bytes expected, None if the server does not say."""


class ConnectionBroken(Exception):
    """Error of a connection that ended before the file did; another attempt may succeed."""


NETWORK_ERRORS = (
    ConnectionBroken,
    urllib.error.URLError,
    http.client.HTTPException,
    ssl.SSLError,
    TimeoutError,
    ConnectionError,
)
"""Errors of the network or server; any other error is one of the local disk."""


def download(
    url: str, file: Path, progress: Progress = lambda _here, _all: None, patience: float = SILENCE_LIMIT
) -> None:
    """Download `url`, http or https, into `file`, resuming an earlier partial download.

    The bytes that came are kept in `file` with `.part` at its end until all of them are there. A server may
    send nothing for `patience` [s]. Raises `AssetError` if there is no such file, the server cannot be
    reached, or it breaks off or stalls again and again, and `OSError` if the file cannot be written.
    """
    if not url.startswith(("http://", "https://")):
        raise AssetError(f"Scans are fetched from an http or https address, got '{url}'.")
    part = file.with_name(file.name + ".part")
    part.parent.mkdir(parents=True, exist_ok=True)
    fruitless = 0
    while True:
        before = _size(part)
        try:
            _continue_download(url, part, progress, patience)
            break
        except NETWORK_ERRORS as error:
            fruitless = 0 if _size(part) > before else fruitless + 1
            if fruitless == ATTEMPTS or not _is_transient(error):
                raise _given_up(url, part, error) from None
    _etag_file(part).unlink(missing_ok=True)
    part.replace(file)


def _continue_download(url: str, part: Path, progress: Progress, patience: float) -> None:
    """Make one connection and append the bytes that `part` lacks."""
    with _open_request(url, part, patience) as response:
        start, total = _extent(response, _size(part))
        if total is not None and total > LARGEST_DOWNLOAD:
            raise AssetError(
                f"'{url}' has {total} bytes, more than the {LARGEST_DOWNLOAD} that a scan may have."
            )
        if start and start == total:
            return
        _etag_file(part).unlink(missing_ok=True)
        if (etag := response.headers.get("ETag", "")) and not etag.startswith("W/"):
            _etag_file(part).write_text(etag, encoding="utf-8")
        with part.open("r+b" if start else "wb") as file:
            file.seek(start)
            here = start
            while chunk := _read_chunk(response):
                file.write(chunk)
                here += len(chunk)
                if here > (LARGEST_DOWNLOAD if total is None else total):
                    file.truncate(start)
                    raise AssetError(
                        f"'{url}' sends more bytes than the {total or LARGEST_DOWNLOAD} expected."
                    )
                progress(here, total)
    if total is not None and here < total:
        raise ConnectionBroken(f"the server ended after {here} of {total} bytes")


@contextmanager
def _open_request(url: str, part: Path, patience: float) -> Iterator[Any]:
    """Open a request for the bytes that `part` lacks; yields a 416 response too if it is whole."""
    headers = {"User-Agent": "qdgrasp", "Accept-Encoding": "identity"}
    if _size(part):
        headers["Range"] = f"bytes={_size(part)}-"
        if _etag_file(part).is_file():
            headers["If-Range"] = _etag_file(part).read_text(encoding="utf-8")
    request = urllib.request.Request(url, headers=headers)  # noqa: S310  # `download` takes http and https
    try:
        with urllib.request.urlopen(request, timeout=patience) as response:  # noqa: S310  # as above
            yield response
    except urllib.error.HTTPError as error:
        if error.code != http.HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
            raise
        with error:  # no more bytes than `part` has: of the same file, or of another one
            found = CONTENT_RANGE.fullmatch(error.headers.get("Content-Range", ""))
            if found is None or int(found[2]) != _size(part):
                for file in (part, _etag_file(part)):
                    file.unlink(missing_ok=True)
                raise ConnectionBroken("the server has another file than before") from None
            yield error


def _extent(response: Any, here: int) -> tuple[int, int | None]:
    """Return the byte at which a response begins, and the size of the whole file."""
    found = CONTENT_RANGE.fullmatch(response.headers.get("Content-Range", ""))
    if response.status == http.HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
        return here, here
    if response.status == http.HTTPStatus.PARTIAL_CONTENT:
        if found is None or found[1] is None or int(found[1]) != here:
            raise ConnectionBroken("the server sent another range than it was asked for")
        return here, int(found[2])
    length = response.headers.get("Content-Length", "")
    return 0, int(length) if length.isdigit() else None


def _read_chunk(response: Any) -> bytes:
    try:
        return bytes(response.read1(CHUNK))
    except http.client.IncompleteRead as short:
        return bytes(short.partial)


def _is_transient(error: Exception) -> bool:
    if isinstance(error, urllib.error.HTTPError):
        return error.code >= http.HTTPStatus.INTERNAL_SERVER_ERROR
    if isinstance(error, urllib.error.URLError):
        return isinstance(error.reason, TimeoutError | ConnectionResetError)
    return True


def _given_up(url: str, part: Path, error: Exception) -> AssetError:
    if isinstance(error, urllib.error.HTTPError):
        return AssetError(f"'{url}' cannot be fetched: the server answers {error.code} {error.reason}.")
    reason = error.reason if isinstance(error, urllib.error.URLError) else error
    kept = f" {_size(part)} bytes are kept; the same command goes on from there." if _size(part) else ""
    return AssetError(
        f"'{url}' cannot be fetched: {reason or type(error).__name__}; is there a network, and a way to that "
        f"address?{kept}"
    )


def _size(part: Path) -> int:
    return part.stat().st_size if part.is_file() else 0


def _etag_file(part: Path) -> Path:
    """Return the path of the file with the ETag of the version that `part` is of."""
    return part.with_name(part.name + ".etag")


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


def fetch_scan(name: str, home: str, progress: Progress, patience: float = SILENCE_LIMIT) -> FetchedScan:
    """Fetch one of `SCAN_NAMES` into the data folder; it is checked first, and written whole.

    `home` is the address that the paths of the archives are below; the server may send nothing for `patience`
    [s]. Raises `UnknownName` if there is no such scan, `WrongScan` if it is not what it must be, and
    `AssetError` if it cannot be fetched or written.
    """
    if name not in SCANS:
        raise UnknownName("scan", name, SCANS, "Other objects are built in or mesh files of your own.")
    scan = SCANS[name]
    known = read_pin(scan.archive)
    archive = data_folder() / "downloads" / Path(scan.archive).name
    try:
        download(f"{home.rstrip('/')}/{scan.archive}", archive, progress, patience)
        try:
            return _accept(name, scan, archive, known)
        except AssetError as error:
            raise WrongScan(name, error) from None
        finally:
            archive.unlink()
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
