"""Fetching scans from their official home, and accepting only what is known or measures what it must."""

import hashlib
import tempfile
from dataclasses import dataclass
from pathlib import Path

from qdgrasp_assets.archive import read_member
from qdgrasp_assets.download import PATIENCE, Progress, download
from qdgrasp_assets.files import data_folder
from qdgrasp_assets.lock import Pin, keep, pin, users_lock, write_whole
from qdgrasp_assets.mesh_file import read_mesh
from qdgrasp_assets.scans import SCANS, Scan, differences, fetched_mesh, put_right
from qdgrasp_assets.solidity import faults
from qdgrasp_protocol.errors import AssetError, UnknownName, WrongScan

HOME = "https://ycb-benchmarks.s3.amazonaws.com"
"""The public bucket of the YCB Object and Model Set."""
TERMS = (
    "The scans are of the YCB Object and Model Set (Calli, Singh, Walsman, Srinivasa, Abbeel and Dollar "
    '2015), licence CC BY 4.0: whoever passes them on names "YCB Benchmarks - Object and Model Set".'
)


@dataclass(frozen=True)
class Fetched:
    """A scan that was fetched and accepted."""

    name: str
    mesh: Path
    pin: Pin
    """What its archive was found to be."""
    lock: Path | None
    """The user's lock file, when the hash was not known before and was written there."""

    @property
    def sentence(self) -> str:
        """What happened, in words."""
        if self.lock is None:
            return f"{self.name}: fetched; its archive is the one that is known (sha256 {self.pin.sha256})."
        return (
            f"{self.name}: fetched; no hash of its archive was known, so it was accepted because the mesh "
            f"measures what it must; sha256 {self.pin.sha256} is now in {self.lock}."
        )


def fetch(name: str, home: str, progress: Progress, patience: float = PATIENCE) -> Fetched:
    """Fetch one scan into the data folder: whole, checked, or not at all.

    Parameters
    ----------
    name
        One of `SCANS`.
    home
        The address that the paths of the archives are below.
    progress
        Is told how far the download is.
    patience
        How long the server may send nothing [s].

    Raises
    ------
    UnknownName
        There is no such scan.
    WrongScan
        It was fetched and is not what it must be.
    AssetError
        It cannot be fetched or written.
    """
    if name not in SCANS:
        raise UnknownName("scan", name, SCANS, "Other objects are built in or mesh files of your own.")
    scan = SCANS[name]
    known = pin(scan.archive)
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


def _accept(name: str, scan: Scan, archive: Path, known: Pin) -> Fetched:
    """Check hash and geometry, then put the mesh where it is found; the hash of what is new is kept first."""
    found = Pin(size=archive.stat().st_size, sha256=_sha256(archive))
    _check_hash(known, found)
    content = read_member(archive, scan.member)
    found = Pin(found.size, found.sha256, hashlib.sha256(content).hexdigest())
    _check_hash(known, found)
    _check_geometry(scan, content)
    lock = keep(scan.archive, found) if known.sha256 is None else None
    mesh = fetched_mesh(name)
    mesh.parent.mkdir(parents=True, exist_ok=True)
    write_whole(mesh.with_name("ATTRIBUTION.txt"), f"{scan.archive}: {scan.member}\n{TERMS}\n".encode())
    write_whole(mesh, content)
    return Fetched(name, mesh, found, lock)


def _check_hash(known: Pin, found: Pin) -> None:
    if differs := known.difference(found):
        raise AssetError(
            f"it is not the archive that is known: {differs}; fetch it again, and if the set itself has "
            f"changed, remove its table from {users_lock()}."
        )


def _check_geometry(scan: Scan, content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / Path(scan.member).name
        file.write_bytes(content)
        mesh = put_right(read_mesh(file), scan)
    if wrong := differences(mesh, scan) or faults(mesh):
        raise AssetError(f"it is not that scan: {'; '.join(wrong)}.")


def _sha256(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
