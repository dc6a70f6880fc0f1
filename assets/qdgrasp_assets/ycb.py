"""The scanned YCB objects: those on the asset path, or downloaded ones.

`scans.toml` has the dimensions of each downloaded mesh; `lock.toml`, and a lock file of the user's, hold
sizes and hashes of the archives.
"""

import json
import tomllib
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np
import tomli_w
from msgspec import Struct, convert

from qdgrasp_assets.asset_paths import data_folder, on_asset_path, searched, write_whole
from qdgrasp_assets.geometry.collision_parts import collision_parts
from qdgrasp_assets.geometry.mesh import Mesh, read_parts
from qdgrasp_assets.geometry.mesh_io import read_mesh
from qdgrasp_assets.object_model import ObjectModel, read_solid
from qdgrasp_assets.stand_ins import STAND_INS
from qdgrasp_protocol.errors import AssetError, UnreadableHere

EXTENTS_TOLERANCE = 5e-5  # m; the table is rounded to 1e-5
VOLUME_TOLERANCE = 1e-3  # share
FRAME_TOLERANCE = 1e-3  # m; a mesh that lies further off is shifted to where it belongs
MILLIMETRES = 1000.0


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


def read_fetched(name: str) -> Mesh:
    """Read the mesh of a fetched scan, corrected by `correct_mesh`; or raise `AssetError`."""
    return correct_mesh(read_mesh(fetched_mesh(name)), SCANS[name])


def correct_mesh(mesh: Mesh, scan: Scan) -> Mesh:
    """Correct a mesh: in metres, without folded triangles, wound outward, moved into place."""
    if np.isclose(mesh.extents.max() / max(scan.extents), MILLIMETRES, rtol=0.02):
        mesh = Mesh(mesh.vertices / MILLIMETRES, mesh.faces)
    mesh = drop_folded(mesh)
    if mesh.volume < 0:
        mesh = mesh.flipped()
    off = np.array(scan.low) - mesh.bounds[0]
    return mesh.moved(off) if np.abs(off).max() > FRAME_TOLERANCE else mesh


def scan_differences(mesh: Mesh, scan: Scan) -> tuple[str, ...]:
    """Describe a corrected mesh's differences from the table; empty if it is that scan."""
    found = []
    if not np.allclose(mesh.extents, scan.extents, rtol=0, atol=EXTENTS_TOLERANCE):
        found.append(
            f"it is {lengths_in_words(mesh.extents)} m large instead of {lengths_in_words(scan.extents)} m"
        )
    if not np.isclose(mesh.volume, scan.volume, rtol=VOLUME_TOLERANCE, atol=0):
        found.append(f"it encloses {mesh.volume * 1e6:.2f} cm3 instead of {scan.volume * 1e6:.2f} cm3")
    if len(mesh.faces) != scan.faces:
        found.append(f"it has {len(mesh.faces)} triangles instead of {scan.faces}")
    return tuple(found)


def lengths_in_words(extents: Iterable[float]) -> str:
    """Return three lengths in words, without their unit."""
    return " x ".join(f"{side:.4f}" for side in extents)


def drop_folded(mesh: Mesh) -> Mesh:
    """Remove degenerate triangles, and pairs that lie on each other."""
    corners = np.sort(mesh.faces, axis=1)
    whole = (np.diff(corners, axis=1) > 0).all(axis=1)
    faces, corners = mesh.faces[whole], corners[whole]
    _, first, which, times = np.unique(
        corners, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    odd = times[which.reshape(-1)] % 2 == 1
    is_first = np.zeros(len(faces), dtype=bool)
    is_first[first] = True
    return Mesh(mesh.vertices, faces[odd & is_first])


BUILT_IN_LOCK = Path(__file__).parent / "lock.toml"


class ArchivePin(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Size and hashes of one archive; None where unknown."""

    size: int | None = None
    """Size of the archive [bytes]."""
    sha256: str | None = None
    mesh_sha256: str | None = None
    """sha256 of the mesh file in the archive."""

    def difference(self, other: "ArchivePin") -> str | None:
        """Describe the first difference from `other`; unknown values are not compared."""
        kinds = {"size": "{} bytes", "sha256": "sha256 {}", "mesh_sha256": "mesh sha256 {}"}
        for field, words in kinds.items():
            known, other_value = getattr(self, field), getattr(other, field)
            if None not in (known, other_value) and known != other_value:
                return f"expected {words.format(known)}, got {words.format(other_value)}"
        return None


def users_lock() -> Path:
    """Return the path of the user's lock file, which `write_pin` writes."""
    return data_folder() / "lock.toml"


def read_pin(archive: str) -> ArchivePin:
    """Return an archive's pin: ours, else the user's; `AssetError` for a broken lock file."""
    return {**_read_lock(users_lock()), **_read_lock(BUILT_IN_LOCK)}.get(archive, ArchivePin())


def write_pin(archive: str, found: ArchivePin) -> Path:
    """Write an archive's size and hashes to the user's lock file; return its path."""
    path = users_lock()
    pins = {**_read_lock(path), archive: found}
    write_whole(path, tomli_w.dumps(msgspec.to_builtins(pins)).encode(), is_synced=True)
    return path


def _read_lock(path: Path) -> dict[str, ArchivePin]:
    try:
        return msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), dict[str, ArchivePin])
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (OSError, ValueError) as error:
        raise AssetError(f"The lock file '{path}' cannot be read: {error}; mend or remove it.") from None


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
        mesh = read_fetched(name)
        collision_source, parts = collision_parts(mesh, name)
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
        return convert(json.loads(index.read_text(encoding="utf-8"))[folder.name], ReferenceEntry)
    except OSError as error:
        raise AssetError(
            f"No table of the scans can be read at '{index}': {error.strerror or error}."
        ) from None
    except (ValueError, KeyError, RecursionError) as error:
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
