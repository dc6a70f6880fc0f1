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
NAMES = (
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


class Entry(Struct, frozen=True):
    """What `objects.json` says about one object."""

    ycb_table_mass_kg: float
    urdf_mass_kg: float
    inertial_origin_xyz: tuple[float, float, float]
    paper_visual_here: str
    """The mesh in whose frame inertial origin, collision parts and S_G are."""


def read_scan(name: str, protocol: str) -> Target:
    """The scanned object `name` (without prefix); its CoM is the inertial origin of the authors' URDF.

    The mass is the YCB table's, in `released` the authors' (the banana weighs 1 kg there).

    Raises
    ------
    AssetError
        The reference data is not there, or broken.
    """
    index = on_asset_path("objects/objects.json")
    if index is None or not (index.parent / name).is_dir():
        raise AssetError(
            f"The object '{PREFIX}{name}' is a scanned mesh of the reference data (objects/{name}), "
            f"which is not there: {searched()}."
        )
    entry = _entry(index, name)
    folder = index.parent / name
    return Target(
        name=PREFIX + name,
        source="asset path",
        licence="CC BY 4.0 (YCB Object and Model Set, YCB Benchmarks)",
        collision_source="asset path",
        mass=entry.urdf_mass_kg if protocol == "released" else entry.ycb_table_mass_kg,
        mesh=read_solid(folder / entry.paper_visual_here),
        parts=read_parts(folder / "collision_vhacd.obj"),
        com_in_mesh=np.array(entry.inertial_origin_xyz),
    )


def _entry(index: Path, name: str) -> Entry:
    try:
        return convert(json.loads(index.read_text(encoding="utf-8"))[name], Entry)
    except (OSError, ValueError, KeyError, ValidationError) as error:
        raise AssetError(f"'{index}' does not describe '{name}': {error}.") from None
