"""A gripper's TOML file, read and checked against its URDF; all faults are listed at once."""

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct

from qdgrasp_assets.asset_paths import on_asset_path, read_table, searched
from qdgrasp_assets.grippers.urdf import Urdf, UrdfJoint
from qdgrasp_assets.grippers.urdf_checks import kind_fault
from qdgrasp_assets.scene import Jaw, Synergy
from qdgrasp_protocol.errors import AssetError

ON_ASSET_PATH = "asset://"
NOTHING_CLOSES = "no joint closes: give those of the fingers a closed position that is not the open one"


class JointTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[joints.NAME]`: one joint of the hand."""

    open: float
    """Position in the open posture [rad or m]."""
    closed: float | None = None
    """Target when the hand closes; None: the joint keeps its position."""
    effort: float | None = None
    """Motor force [N or Nm]; the URDF's by default."""
    velocity: float | None = None
    """Velocity limit [m/s or rad/s]; the URDF's by default."""
    driven: bool = True
    """False: never commanded, held by the simulator."""
    rated_effort: float | None = None
    """Greatest force or torque of the real drive at this joint [N or Nm]; None: not stated."""
    rated_velocity: float | None = None
    """Speed at which the real hand closes [m/s or rad/s]; None: not stated."""

    @property
    def closes(self) -> bool:
        """True if a motor moves it when the hand closes."""
        return self.driven and self.closed not in (None, self.open)


class FreeJointTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[free_joints.NAME]`: a joint whose initial position is a gene."""

    low: float
    high: float


class OriginalBase(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The base link of a hand in its maker's URDF, for exports.

    Its pose is in the frame of `base_link`, which was added to the hand. A pose of that link is a pose of the
    base link times this one.
    """

    link: str
    position: tuple[float, float, float]
    """Position [m]."""
    orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    """Quaternion x, y, z, w."""


class GripperFile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Content of a gripper's TOML file (docs/grippers.md)."""

    urdf: str
    """Path relative to the TOML, or `asset://...` on the asset path."""
    licence: str = "not stated"
    base_link: str
    approach_axis: tuple[float, float, float]
    palm_offset: float
    standoff: tuple[float, float]
    finger_links: tuple[str, ...]
    joints: dict[str, JointTable]
    synergies: tuple[Synergy, ...] = ()
    free_joints: dict[str, FreeJointTable] = {}
    fixed_joints: dict[str, float] = {}
    """Joints of the real hand that do not move in the URDF, with their positions [rad or m], for exports."""
    jaw: Jaw | None = None
    """Its axis may be of any length; None: not a two-finger hand."""
    carrier_hold_force: float = 100.0
    """Force that holds the carrier's joints in `released` [N, Nm]."""
    ratings_source: str = "not stated"
    """Origin of `rated_effort` and `rated_velocity`: data sheet, document, edition."""
    disabled_collisions: tuple[tuple[str, str], ...] = ()
    """Pairs of links that may overlap (MoveIt's term); a joint's parent and child always may."""

    def find_urdf(self, toml: Path) -> Path | None:
        """Return the path of the URDF for this TOML; None if it is not on the asset path."""
        if self.urdf.startswith(ON_ASSET_PATH):
            return on_asset_path(self.urdf.removeprefix(ON_ASSET_PATH))
        return toml.parent / self.urdf


def urdf_path(path: Path, file: GripperFile) -> Path:
    """Return the path of the URDF of a file; `AssetError` if not found on the asset path."""
    found = file.find_urdf(path)
    if found is None:
        raise AssetError(
            f"The gripper '{path.stem}' needs '{file.urdf.removeprefix(ON_ASSET_PATH)}' of the reference "
            f"data, which is not there: {searched()}."
        )
    return found


def read_gripper_file(path: Path) -> GripperFile:
    """Read a gripper's TOML alone; `AssetError` if it is absent or has other keys or kinds."""
    return read_table(path, GripperFile, "gripper", "docs/grippers.md")


RIGHT_ANGLE_TOLERANCE = 1e-3  # the cosine up to which an angle is taken for a right one


def gripper_faults(file: GripperFile, robot: Urdf) -> Iterator[str]:
    """Yield all faults of a gripper's file: impossible values, and mismatches with its URDF."""
    unknown = tuple(_unknown_names(robot, "base_link", [file.base_link], robot.links))
    yield from unknown
    if not unknown:
        yield from _hand_faults(file, robot, robot.subtree(file.base_link))
    yield from _synergy_faults(file)
    yield from _number_faults(file)


def _hand_faults(file: GripperFile, robot: Urdf, hand: Urdf) -> Iterator[str]:
    moving = {joint.name: joint for joint in hand.joints if joint.moves}
    yield from (fault for joint in hand.joints if (fault := kind_fault(joint.name, joint.kind)))
    yield from _unknown_names(robot, "finger_links", file.finger_links, hand.links)
    yield from _unknown_names(robot, "joints", file.joints, moving)
    yield from _unknown_names(robot, "free_joints", file.free_joints, file.joints)
    paired = dict.fromkeys(chain.from_iterable(file.disabled_collisions))
    yield from _unknown_names(robot, "disabled_collisions", paired, hand.links)
    if twice := file.fixed_joints.keys() & moving:
        yield f"fixed_joints names {', '.join(sorted(twice))}, which moves; give it a table in [joints]"
    for synergy in file.synergies:
        yield from _unknown_names(robot, f"synergy '{synergy.name}'", synergy.joints, file.joints)
    for name in moving:
        if name not in file.joints:
            yield (
                f"it says nothing about the joint '{name}' of '{robot.path}', which moves; "
                f"add [joints.{name}] with its open and closed positions, or with driven = false"
            )
    for name, table in file.joints.items():
        if name in moving:
            yield from _joint_faults(moving[name], table)
    for name, free in file.free_joints.items():
        if name not in moving:
            continue
        for label, position in (("low", free.low), ("high", free.high)):
            yield from _limit_faults(moving[name], f"free_joints.{name}.{label}", position)
        if free.low == free.high:
            yield (
                f"free_joints.{name} has one place, {free.low:g}, for low and high; make it a range, or "
                "leave it out"
            )


def _unknown_names(robot: Urdf, field: str, names: Any, known: Any) -> Iterator[str]:
    for name in names:
        if name not in known:
            yield (
                f"{field} names '{name}', which '{robot.path}' does not have below its base link; "
                f"it has {', '.join(sorted(known)) or 'none'}"
            )


def _joint_faults(joint: UrdfJoint, table: JointTable) -> Iterator[str]:
    for label, position in (("open", table.open), ("closed", table.closed)):
        if position is not None:
            yield from _limit_faults(joint, f"joints.{joint.name}.{label}", position)
    for label in ("effort", "velocity"):
        stated, value = getattr(table, label), getattr(joint, label)
        if table.driven and (value if stated is None else stated) <= 0:
            yield (
                f"the {label} of the joint '{joint.name}' must be greater than 0; the URDF has {value:g}, "
                f"so give {label} in [joints.{joint.name}]"
            )
    for label in ("rated_effort", "rated_velocity"):
        rating = getattr(table, label)
        if rating is not None and rating <= 0:
            field = f"joints.{joint.name}.{label}"
            yield f"{field} must be greater than 0, got {rating:g}; leave it out if it is unknown"


def _limit_faults(joint: UrdfJoint, field: str, position: float) -> Iterator[str]:
    if not joint.allows(position):
        yield f"{field} is {position:g}, outside the URDF's limits {joint.lower:g} to {joint.upper:g}"


def _synergy_faults(file: GripperFile) -> Iterator[str]:
    for synergy in file.synergies:
        if not synergy.joints:
            yield f"the synergy '{synergy.name}' has no joints; name those that close together"
        for joint in synergy.joints:
            if joint in file.joints and not file.joints[joint].driven:
                yield (
                    f"the synergy '{synergy.name}' names '{joint}', which is not driven; leave it out, or "
                    f"take driven = false out of [joints.{joint}]"
                )


def _number_faults(file: GripperFile) -> Iterator[str]:
    low, high = file.standoff
    if not 0 <= low <= high:
        yield f"standoff must be [least, greatest], 0 or more, got [{low:g}, {high:g}]"
    if file.palm_offset < 0:
        yield f"palm_offset must be 0 or more, got {file.palm_offset:g}"
    if not file.carrier_hold_force > 0:
        yield f"carrier_hold_force must be greater than 0, got {file.carrier_hold_force:g}"
    if not np.linalg.norm(file.approach_axis) > 0:
        yield "approach_axis must not be zero"
    if jaw := file.jaw:
        if not jaw.opening > 0:
            yield f"jaw.opening must be greater than 0, got {jaw.opening:g}"
        lengths = np.linalg.norm(jaw.axis) * np.linalg.norm(file.approach_axis)
        if not lengths > 0 or abs(np.dot(jaw.axis, file.approach_axis)) > RIGHT_ANGLE_TOLERANCE * lengths:
            yield f"jaw.axis must be at right angles to approach_axis, got {list(jaw.axis)}"
    if not file.finger_links:
        yield "finger_links must name at least one link"
