"""The scans that can be fetched: where each lies, what it must measure, and how its mesh is put right."""

import tomllib
from collections.abc import Iterable
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct

from qdgrasp_assets.files import data_folder
from qdgrasp_assets.mesh import Floats, Mesh
from qdgrasp_assets.mesh_file import read_mesh

EXTENTS_TOLERANCE = 5e-5  # m; the table is rounded to 1e-5
VOLUME_TOLERANCE = 1e-3  # share
FRAME_TOLERANCE = 1e-3  # m; a mesh that lies further off is shifted to where it belongs
MILLIMETRES = 1000.0


class Scan(Struct, frozen=True, forbid_unknown_fields=True):
    """One scan: its archive, and its mesh after `put_right`."""

    archive: str
    """Path below the address of the set."""
    member: str
    """Path of the mesh in the archive."""
    extents: tuple[float, float, float]
    """[m]."""
    low: tuple[float, float, float]
    """Low corner of the bounding box [m]."""
    volume: float
    """[m3]."""
    faces: int


SCANS: dict[str, Scan] = msgspec.convert(
    tomllib.loads((Path(__file__).parent / "scans.toml").read_text(encoding="utf-8")), dict[str, Scan]
)


def fetched_folder(name: str) -> Path:
    """Where the scan `name` of `SCANS` is kept once it is fetched."""
    return data_folder() / "ycb" / name


def fetched_mesh(name: str) -> Path:
    """The mesh file in `fetched_folder`, as it came."""
    return fetched_folder(name) / "mesh.ply"


def read_fetched(name: str) -> Mesh:
    """The mesh of a fetched scan, put right.

    Raises
    ------
    AssetError
        It cannot be read.
    """
    return put_right(read_mesh(fetched_mesh(name)), SCANS[name])


def put_right(mesh: Mesh, scan: Scan) -> Mesh:
    """The mesh in metres, without folded triangles, wound outward, with its bounding box where it belongs."""
    mesh = unfolded(_in_metres(mesh, np.array(scan.extents)))
    if mesh.volume < 0:
        mesh = mesh.flipped()
    off = np.array(scan.low) - mesh.bounds[0]
    return mesh.moved(off) if np.abs(off).max() > FRAME_TOLERANCE else mesh


def differences(mesh: Mesh, scan: Scan) -> tuple[str, ...]:
    """How a mesh that was put right differs from the table, in words; empty when it is that scan."""
    found = []
    if not np.allclose(mesh.extents, scan.extents, rtol=0, atol=EXTENTS_TOLERANCE):
        found.append(f"it is {size(mesh.extents)} m large instead of {size(np.array(scan.extents))} m")
    if not np.isclose(mesh.volume, scan.volume, rtol=VOLUME_TOLERANCE, atol=0):
        found.append(f"it encloses {mesh.volume * 1e6:.2f} cm3 instead of {scan.volume * 1e6:.2f} cm3")
    if len(mesh.faces) != scan.faces:
        found.append(f"it has {len(mesh.faces)} triangles instead of {scan.faces}")
    return tuple(found)


def size(extents: Iterable[float]) -> str:
    """Three lengths in words, without their unit."""
    return " x ".join(f"{side:.4f}" for side in extents)


def unfolded(mesh: Mesh) -> Mesh:
    """The mesh without triangles of fewer than three corners, or that lie on each other in pairs."""
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


def _in_metres(mesh: Mesh, expected: Floats) -> Mesh:
    if np.isclose(mesh.extents.max() / expected.max(), MILLIMETRES, rtol=0.02):
        return Mesh(mesh.vertices / MILLIMETRES, mesh.faces)
    return mesh
