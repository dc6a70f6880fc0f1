"""The scanned YCB objects: those on the asset path, or downloaded ones.

`scans.toml` has the dimensions of each mesh, by which a download is accepted. One file is taken out of its
gzipped tar archive: nothing else is unpacked, and no name in it becomes a path here.
"""

import tarfile
import tempfile
import tomllib
import zlib
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct

from qdgrasp_assets.asset_paths import data_folder, on_asset_path, searched, write_whole
from qdgrasp_assets.geometry.collision_parts import Tell, collision_parts
from qdgrasp_assets.geometry.mesh import Mesh, read_parts
from qdgrasp_assets.geometry.mesh_io import read_mesh_file
from qdgrasp_assets.geometry.mesh_repair import drop_degenerate, surface_faults
from qdgrasp_assets.object_model import ObjectModel, read_solid
from qdgrasp_assets.stand_ins import STAND_INS
from qdgrasp_protocol.errors import AssetError, UnknownName, UnreadableHere

EXTENTS_TOLERANCE = 5e-5  # m; the table is rounded to 1e-5
VOLUME_TOLERANCE = 1e-3  # share
FRAME_TOLERANCE = 1e-3  # m; a mesh that lies further off is shifted to where it belongs
MILLIMETRES = 1000.0
SILENCE_LIMIT = 30.0  # s without a byte


class Scan(Struct, frozen=True, forbid_unknown_fields=True):
    """One scan: its archive, and its mesh after `correct_mesh`."""

    archive: str
    """Path of the archive below the address of the set."""
    member: str
    """Path of the mesh in the archive."""
    extents: tuple[float, float, float]
    """Sides of the bounding box [m]."""
    low: tuple[float, float, float]
    """Low corner of the bounding box [m]."""
    volume: float
    """Enclosed volume [m3]."""
    faces: int


SCANS: dict[str, Scan] = msgspec.convert(
    tomllib.loads((Path(__file__).parent / "scans.toml").read_text(encoding="utf-8")), dict[str, Scan]
)


def fetched_mesh(name: str) -> Path:
    """Return the path of the unprocessed mesh file of the fetched scan `name` of `SCAN_NAMES`."""
    return data_folder() / "ycb" / name / "mesh.ply"


def correct_mesh(mesh: Mesh, scan: Scan) -> Mesh:
    """Correct a mesh: in metres, without folded triangles, wound outward, moved into place."""
    if np.isclose(mesh.extents.max() / max(scan.extents), MILLIMETRES, rtol=0.02):
        mesh = Mesh(mesh.vertices / MILLIMETRES, mesh.faces)
    mesh, _ = drop_degenerate(mesh)
    if mesh.volume < 0:
        mesh = mesh.flipped()
    off = np.array(scan.low) - mesh.bounds[0]
    return mesh.moved(off) if np.abs(off).max() > FRAME_TOLERANCE else mesh


def lengths_in_words(extents: Iterable[float]) -> str:
    """Return three lengths in words, without their unit."""
    return " x ".join(f"{side:.4f}" for side in extents)


PREFIX = "ycb_"
SCAN_NAMES = tuple(SCANS)
LICENCE = "CC BY 4.0 (YCB Object and Model Set, YCB Benchmarks)"


class ReferenceEntry(Struct, frozen=True):
    """Entry of one object in `objects.json`."""

    ycb_table_mass_kg: float
    urdf_mass_kg: float
    inertial_origin_xyz: tuple[float, float, float]
    paper_visual_here: str
    """Mesh whose frame inertial origin, collision parts and S_G use."""


def scan_source(name: str) -> str:
    """Return the source of a scan of `SCAN_NAMES`: "asset path", "fetched" or "absent"."""
    if _reference_folder(name) is not None:
        return "asset path"
    with suppress(UnreadableHere):
        return "fetched" if fetched_mesh(name).is_file() else "absent"
    return "absent"


def read_scan(name: str, protocol: str) -> ObjectModel:
    """Read the scan `name` of `SCAN_NAMES`; its CoM is the inertial origin of the authors' URDF.

    The mass is the YCB table's, in `released` the authors' (the banana weighs 1 kg there); a fetched scan has
    mass and CoM of the stand-in, which are the scan's. Raises `AssetError` if the scan is not there or
    broken, or `released` needs what a fetched one does not have.
    """
    check_there(name)
    folder = _reference_folder(name)
    if folder is not None:
        entry = _reference_entry(folder)
        source = collision_source = "asset path"
        mass = entry.urdf_mass_kg if protocol == "released" else entry.ycb_table_mass_kg
        com, mesh = entry.inertial_origin_xyz, read_solid(folder / entry.paper_visual_here)
        parts = read_parts(folder / "collision_vhacd.obj")
    elif protocol == "released":
        raise AssetError(
            "The protocol 'released' needs the collision hulls of the reference data, which the fetched scan "
            f"'{name}' does not have: {searched()}; use the protocol 'paper'."
        )
    else:
        same = STAND_INS[name.removeprefix(PREFIX)]
        source, mass, com = "fetched", same.mass, same.com
        mesh = correct_mesh(read_mesh_file(fetched_mesh(name)).mesh, SCANS[name])
        collision_source, parts = collision_parts(mesh)
    return ObjectModel(
        name=name,
        source=source,
        licence=LICENCE,
        collision_source=collision_source,
        mass=mass,
        mesh=mesh,
        parts=parts,
        com_in_mesh=np.array(com),
    )


def _reference_entry(folder: Path) -> ReferenceEntry:
    index = folder.parent / "objects.json"
    try:
        return msgspec.json.decode(index.read_bytes(), type=dict[str, ReferenceEntry])[folder.name]
    except (OSError, msgspec.MsgspecError, KeyError) as error:
        raise AssetError(f"'{index}' does not describe '{folder.name}': {error}.") from None


def check_there(name: str) -> None:
    """Check that the scan `name` of `SCAN_NAMES` is there; `AssetError` if it is not."""
    if _reference_folder(name) is None and not fetched_mesh(name).is_file():
        raise AssetError(
            f"The object '{name}' is a scan of the reference data (objects/{name.removeprefix(PREFIX)}), "
            f"which is not there: {searched()}; `qdgrasp asset fetch {name}` fetches it from the YCB set."
        )


def _reference_folder(name: str) -> Path | None:
    return on_asset_path(f"objects/{name.removeprefix(PREFIX)}")


def read_member(archive: Path, member: str) -> bytes:
    """Return the file `member` of a `.tgz`; `AssetError` if it is missing or broken."""
    try:
        with tarfile.open(archive, mode="r:gz") as tar:
            found = [entry for entry in tar if entry.isreg() and Path(entry.name) == Path(member)]
            file = tar.extractfile(found[0]) if found else None
            if file is None:
                raise AssetError(f"There is no file '{member}' in '{archive.name}'.")
            return file.read()
    except (tarfile.TarError, zlib.error, EOFError, OSError) as error:
        raise AssetError(f"'{archive.name}' is not a whole tar archive: {error}.") from None


def download(url: str, file: Path) -> None:
    """Download `url`, http or https, into `file`, whole or not at all.

    Raises `AssetError` if there is no such file or the server cannot be reached, and `OSError` if the file
    cannot be written.
    """
    if not url.startswith(("http://", "https://")):
        raise AssetError(f"Scans are fetched from an http or https address, got '{url}'.")
    import pooch
    import requests

    pooch.get_logger().setLevel("WARNING")
    loader = pooch.HTTPDownloader(timeout=SILENCE_LIMIT)
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


class WrongScan(AssetError):
    """Fetched data that is not the expected scan; it was deleted."""


def fetch_scan(name: str, home: str, tell: Tell) -> Path:
    """Fetch one of `SCAN_NAMES` into the data folder; it is checked first, and written whole.

    `home` is the address that the paths of the archives are below, `tell` is called with a sentence. Returns
    the mesh file. Raises `UnknownName` if there is no such scan, `WrongScan` if it is another mesh, and
    `AssetError` if it cannot be fetched or written.
    """
    if name not in SCANS:
        raise UnknownName("scan", name, SCANS, "Other objects are built in or mesh files of your own.")
    scan = SCANS[name]
    archive = data_folder() / "downloads" / Path(scan.archive).name
    try:
        tell(f"fetching {name}")
        download(f"{home.rstrip('/')}/{scan.archive}", archive)
        try:
            return _accept(name, scan, archive)
        except AssetError as error:
            raise WrongScan(f"The data fetched for '{name}' was thrown away: {error}") from None
        finally:
            archive.unlink(missing_ok=True)
    except OSError as error:
        raise AssetError(
            f"'{name}' cannot be kept in '{data_folder()}': {error.strerror or error}; name another folder "
            "with QDGRASP_DATA."
        ) from None


def _accept(name: str, scan: Scan, archive: Path) -> Path:
    """Check the geometry of an archive's mesh, then put it in place."""
    content = read_member(archive, scan.member)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / Path(scan.member).name
        file.write_bytes(content)
        read = correct_mesh(read_mesh_file(file).mesh, scan)
    is_of_size = np.allclose(read.extents, scan.extents, rtol=0, atol=EXTENTS_TOLERANCE)
    is_of_volume = np.isclose(read.volume, scan.volume, rtol=VOLUME_TOLERANCE, atol=0)
    if not (is_of_size and is_of_volume and len(read.faces) == scan.faces) or surface_faults(read):
        size = f"{lengths_in_words(read.extents)} m large, of {read.volume * 1e6:.2f} cm3"
        raise AssetError(f"it is not that scan, but {size} and {len(read.faces)} triangles.")
    mesh = fetched_mesh(name)
    attribution = f"{scan.archive}: {scan.member}\n{YCB_TERMS}\n"
    write_whole(mesh.with_name("ATTRIBUTION.txt"), attribution.encode())
    write_whole(mesh, content)
    return mesh
