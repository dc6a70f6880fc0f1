"""The scanned YCB objects: of the reference data on the asset path, else as they were fetched."""

import json
from pathlib import Path

import numpy as np
from msgspec import Struct, ValidationError, convert

from qdgrasp_assets import scans
from qdgrasp_assets.convex import collision_parts
from qdgrasp_assets.files import on_asset_path, searched
from qdgrasp_assets.mesh import read_parts
from qdgrasp_assets.objects.stand_ins import STAND_INS
from qdgrasp_assets.solid import read_solid
from qdgrasp_assets.target import Target
from qdgrasp_protocol.errors import AssetError

PREFIX = "ycb_"
SCANS = tuple(scans.SCANS)
LICENCE = "CC BY 4.0 (YCB Object and Model Set, YCB Benchmarks)"


class Entry(Struct, frozen=True):
    """What `objects.json` says about one object."""

    ycb_table_mass_kg: float
    urdf_mass_kg: float
    inertial_origin_xyz: tuple[float, float, float]
    paper_visual_here: str
    """The mesh in whose frame inertial origin, collision parts and S_G are."""


def source(name: str) -> str:
    """Where the scan `name` of `SCANS` is: "asset path", "fetched" or "absent"."""
    if _folder(name) is not None:
        return "asset path"
    return "fetched" if scans.fetched_mesh(name).is_file() else "absent"


def read_scan(name: str, protocol: str) -> Target:
    """The scan `name` of `SCANS`; its CoM is the inertial origin of the authors' URDF.

    The mass is the YCB table's, in `released` the authors' (the banana weighs 1 kg there).

    Raises
    ------
    AssetError
        The scan is not there or broken, or `released` needs what a fetched one does not have.
    """
    folder = _folder(name)
    if folder is not None:
        return _of_reference(name, folder, protocol)
    check_there(name)
    if protocol == "released":
        raise AssetError(
            "The protocol 'released' needs the collision hulls of the reference data, which the fetched scan "
            f"'{name}' does not have: {searched()}; use the protocol 'paper'."
        )
    return _of_fetched(name)


def check_there(name: str) -> None:
    """Check that the scan `name` of `SCANS` is there.

    Raises
    ------
    AssetError
        It is not.
    """
    if _folder(name) is None and not scans.fetched_mesh(name).is_file():
        raise AssetError(
            f"The object '{name}' is a scan of the reference data (objects/{name.removeprefix(PREFIX)}), "
            f"which is not there: {searched()}; `qdgrasp asset fetch {name}` fetches it from the YCB set."
        )


def _folder(name: str) -> Path | None:
    return on_asset_path(f"objects/{name.removeprefix(PREFIX)}")


def _of_reference(name: str, folder: Path, protocol: str) -> Target:
    entry = _entry(folder)
    return Target(
        name=name,
        source="asset path",
        licence=LICENCE,
        collision_source="asset path",
        mass=entry.urdf_mass_kg if protocol == "released" else entry.ycb_table_mass_kg,
        mesh=read_solid(folder / entry.paper_visual_here),
        parts=read_parts(folder / "collision_vhacd.obj"),
        com_in_mesh=np.array(entry.inertial_origin_xyz),
    )


def _of_fetched(name: str) -> Target:
    """Mass and CoM are those of the stand-in, which has the scan's."""
    same = STAND_INS[name.removeprefix(PREFIX)]
    mesh = scans.read_fetched(name)
    collision_source, parts = collision_parts(mesh, name)
    return Target(
        name=name,
        source="fetched",
        licence=LICENCE,
        collision_source=collision_source,
        mass=same.mass,
        mesh=mesh,
        parts=parts,
        com_in_mesh=np.array(same.com),
    )


def _entry(folder: Path) -> Entry:
    index = folder.parent / "objects.json"
    try:
        return convert(json.loads(index.read_text(encoding="utf-8"))[folder.name], Entry)
    except OSError as error:
        raise AssetError(
            f"No table of the scans can be read at '{index}': {error.strerror or error}."
        ) from None
    except (ValueError, KeyError, ValidationError) as error:
        raise AssetError(f"'{index}' does not describe '{folder.name}': {error}.") from None
