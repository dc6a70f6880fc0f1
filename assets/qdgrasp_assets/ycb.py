"""The scanned YCB objects of the reference data on the asset path."""

import json
from pathlib import Path

import numpy as np
from msgspec import Struct, ValidationError, convert

from qdgrasp_assets.files import on_asset_path, searched
from qdgrasp_assets.mesh import read_parts, read_solid
from qdgrasp_assets.target import Target
from qdgrasp_protocol.errors import AssetError

PREFIX = "ycb_"
SCANS = tuple(
    PREFIX + name
    for name in (
        "banana",
        "bleach_cleanser",
        "bowl",
        "chips_can",
        "cracker_box",
        "mug",
        "power_drill",
        "rubiks_cube",
        "spatula",
        "tennis_ball",
    )
)
LICENCE = "CC BY 4.0 (YCB Object and Model Set, YCB Benchmarks)"


class Entry(Struct, frozen=True):
    """What `objects.json` says about one object."""

    ycb_table_mass_kg: float
    urdf_mass_kg: float
    inertial_origin_xyz: tuple[float, float, float]
    paper_visual_here: str
    """The mesh in whose frame inertial origin, collision parts and S_G are."""


def is_there(name: str) -> bool:
    """Whether the scan `name` of `SCANS` is on the asset path."""
    return on_asset_path(f"objects/{name.removeprefix(PREFIX)}") is not None


def read_scan(name: str, protocol: str) -> Target:
    """The scan `name` of `SCANS`; its CoM is the inertial origin of the authors' URDF.

    The mass is the YCB table's, in `released` the authors' (the banana weighs 1 kg there).

    Raises
    ------
    AssetError
        The reference data is not there, or broken.
    """
    folder = on_asset_path(f"objects/{name.removeprefix(PREFIX)}")
    if folder is None:
        raise AssetError(
            f"The object '{name}' is a scan of the reference data (objects/{name.removeprefix(PREFIX)}), "
            f"which is not there: {searched()}."
        )
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
