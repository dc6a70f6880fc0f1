"""A gripper's TOML file, which says how the hand grasps, read strictly."""

import tomllib
from pathlib import Path

import msgspec
from msgspec import Struct

from qdgrasp_assets.files import amiss, on_asset_path, searched
from qdgrasp_assets.gripper_values import check_values
from qdgrasp_assets.scene import Jaw
from qdgrasp_assets.vectors import unit
from qdgrasp_protocol.errors import AssetError

ON_ASSET_PATH = "asset://"


class JointTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[joints.NAME]`: one joint of the hand."""

    open: float
    """Position in the open posture [rad or m]."""
    closed: float | None = None
    """Target when the hand closes; without it the joint stays where it is."""
    effort: float | None = None
    """Motor force [N or Nm]; the URDF's by default."""
    velocity: float | None = None
    """Velocity limit [m/s or rad/s]; the URDF's by default."""
    driven: bool = True
    """False: never commanded, held by the simulator."""


class SynergyTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[[synergies]]`: joints that close together."""

    name: str
    joints: tuple[str, ...]


class FreeJointTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[free_joints.NAME]`: a joint whose initial position is a gene."""

    low: float
    high: float


class JawTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[jaw]`: the two opposing fingers of a two-finger hand."""

    axis: tuple[float, float, float]
    """From one finger to the other, base link's frame."""
    opening: float
    """Between the open fingers [m]."""

    @property
    def packed(self) -> Jaw:
        """As a scene holds it."""
        return Jaw(axis=unit(self.axis), opening=self.opening)


class GripperFile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a gripper's TOML says (docs/grippers.md)."""

    urdf: str
    """Relative to the TOML, or `asset://...` on the asset path."""
    licence: str = "not stated"
    base_link: str
    approach_axis: tuple[float, float, float]
    palm_offset: float
    standoff: tuple[float, float]
    finger_links: tuple[str, ...]
    joints: dict[str, JointTable]
    synergies: tuple[SynergyTable, ...] = ()
    free_joints: dict[str, FreeJointTable] = {}
    jaw: JawTable | None = None
    """Left out: not a two-finger hand."""
    carrier_hold_force: float = 100.0
    """Force that holds the carrier's joints in `released` [N, Nm]."""

    def find_urdf(self, toml: Path) -> Path | None:
        """Where the URDF should be, for this TOML; None when it is nowhere on the asset path."""
        if self.urdf.startswith(ON_ASSET_PATH):
            return on_asset_path(self.urdf.removeprefix(ON_ASSET_PATH))
        return toml.parent / self.urdf


TABLES = {
    "": GripperFile,
    "joints": JointTable,
    "synergies": SynergyTable,
    "free_joints": FreeJointTable,
    "jaw": JawTable,
}


def urdf_path(path: Path, file: GripperFile) -> Path:
    """Where the URDF is that a gripper's file names.

    Raises
    ------
    AssetError
        It is to be on the asset path, and is not.
    """
    found = file.find_urdf(path)
    if found is None:
        raise AssetError(
            f"The gripper '{path.stem}' needs '{file.urdf.removeprefix(ON_ASSET_PATH)}' of the reference "
            f"data, which is not there: {searched()}."
        )
    return found


def read_gripper_file(path: Path) -> GripperFile:
    """Read a gripper's TOML alone.

    Raises
    ------
    UnknownKey, AssetError
        A key that no field has; it is not there, no TOML, or a field is left out or of another kind.
    """
    if why := amiss(path):
        raise AssetError(f"No gripper can be read at '{path}': it {why}; name a gripper's TOML file.")
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise AssetError(f"No gripper can be read at '{path}': {error.strerror or error}.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise AssetError(f"'{path}' is not TOML: {error}.") from None
    check_values(path, values, TABLES)
    return msgspec.convert(values, GripperFile)
