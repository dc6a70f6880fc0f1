"""Grippers: a URDF and one TOML that says how the hand grasps, read strictly."""

import tomllib
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct

from qdgrasp_assets.carrier import CARRIERS
from qdgrasp_assets.files import amiss, on_asset_path, searched
from qdgrasp_assets.finite import endless
from qdgrasp_assets.hands.meshes import missing_meshes
from qdgrasp_assets.hands.motion import kind_fault
from qdgrasp_assets.hands.source import read_source
from qdgrasp_assets.hands.weight import weight_faults
from qdgrasp_assets.scene import FreeJoint, Jaw, Joint, SceneGripper, Synergy, Vector
from qdgrasp_assets.shapes import largest_side
from qdgrasp_assets.urdf import Urdf, UrdfJoint, tree
from qdgrasp_protocol.errors import AssetError, UnknownKey

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
        return Jaw(axis=_unit(self.axis), opening=self.opening)


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


NESTED = {"joints": JointTable, "synergies": SynergyTable, "free_joints": FreeJointTable}
RIGHT = 1e-3  # the cosine up to which an angle is taken for a right one


@dataclass(frozen=True)
class Gripper:
    """A gripper's files, read and checked against each other."""

    name: str
    source: str
    file: GripperFile
    robot: Urdf
    """The whole URDF; the hand is its sub-tree from `base_link`."""

    def check_hand(self) -> None:
        """Check that the simulator finds the hand's meshes, and takes its masses as they are meant.

        Raises
        ------
        AssetError
            A mesh is missing or no ordinary file; masses are made up, refused, or hold a link still.
        """
        hand = self.robot.subtree(self.file.base_link)
        found = (*weight_faults(hand.element), *missing_meshes(hand))
        if found:
            raise AssetError(f"The URDF '{self.robot.path}' cannot be used as it is: {'; and '.join(found)}.")

    def on_carrier(self, protocol: str) -> SceneGripper:
        """The hand as an evaluation protocol carries it.

        Raises
        ------
        AssetError
            A mesh is missing, empty or cannot be read.
        """
        file = self.file
        carried = CARRIERS[protocol](self.robot, file.base_link, file.carrier_hold_force)
        element, meshes = carried.urdf.bundled()
        return SceneGripper(
            name=self.name,
            source=self.source,
            licence=file.licence,
            urdf=ET.tostring(element, encoding="unicode"),
            meshes=meshes,
            base_link=file.base_link,
            carrier=carried.joints,
            joints=tuple(self._joint(name, table) for name, table in file.joints.items()),
            finger_links=file.finger_links,
            synergies=tuple(Synergy(name=each.name, joints=each.joints) for each in file.synergies),
            free_joints=tuple(
                FreeJoint(name=name, low=each.low, high=each.high) for name, each in file.free_joints.items()
            ),
            approach_axis=_unit(file.approach_axis),
            palm_offset=file.palm_offset,
            standoff=file.standoff,
            jaw=file.jaw.packed if file.jaw else None,
            extent=self._extent(element, meshes),
        )

    def _extent(self, element: ET.Element, meshes: dict[str, bytes]) -> float:
        """The largest side of the hand [m], to the micrometre."""
        hand = tree(self.robot.path, element).subtree(self.file.base_link)
        try:
            return round(largest_side(hand, meshes), 6)
        except AssetError:
            raise
        except Exception as error:  # noqa: BLE001  # readers of meshes raise whatever they stumble over
            raise AssetError(
                f"The URDF '{self.robot.path}' has a collision shape that cannot be read: "
                f"{type(error).__name__}: {error}."
            ) from None

    def _joint(self, name: str, table: JointTable) -> Joint:
        told = self.robot.joint(name)
        assert told is not None  # noqa: S101  # `read_gripper` has checked it
        return Joint(
            name=name,
            opened=table.open,
            closed=table.open if table.closed is None else table.closed,
            effort=told.effort if table.effort is None else table.effort,
            velocity=told.velocity if table.velocity is None else table.velocity,
            driven=table.driven,
        )


def _unit(axis: Vector) -> Vector:
    x, y, z = (float(value) for value in np.array(axis) / np.linalg.norm(axis))
    return x, y, z


def read_gripper(path: Path, name: str, source: str) -> Gripper:
    """Read a gripper's TOML and the URDF that it names.

    Raises
    ------
    UnknownKey
        The TOML has a key that no field has.
    AssetError
        A file is missing or cannot be read, a value is impossible, or the two do not fit each other.
    """
    file = read_gripper_file(path)
    urdf = urdf_path(path, file)
    robot = tree(urdf, read_source(urdf))
    _check(path, file, robot)
    return Gripper(name, source, file, robot)


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
        As in `read_gripper`.
    """
    if why := amiss(path):
        raise AssetError(f"No gripper can be read at '{path}': it {why}; name a gripper's TOML file.")
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise AssetError(f"No gripper can be read at '{path}': {error.strerror or error}.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise AssetError(f"'{path}' is not TOML: {error}.") from None
    _check_keys(str(path), values, GripperFile)
    if "jaw" in values:
        _check_keys(f"{path}: jaw", values["jaw"], JawTable)
    for table, struct in NESTED.items():
        inner = values.get(table, {})
        for label, entry in inner.items() if isinstance(inner, dict) else enumerate(inner):
            _check_keys(f"{path}: {table}.{label}", entry, struct)
    try:
        return msgspec.convert(values, GripperFile)
    except msgspec.ValidationError as error:
        raise AssetError(f"The gripper '{path}': {error}.") from None


def _check_keys(where: str, values: Any, struct: Any) -> None:
    known = [field.name for field in msgspec.structs.fields(struct)]
    for key in values if isinstance(values, dict) else ():
        if key not in known:
            raise UnknownKey(where, key, known)


def _check(path: Path, file: GripperFile, robot: Urdf) -> None:
    for fault in gripper_faults(file, robot):
        raise AssetError(f"The gripper '{path}': {fault}.")


def gripper_faults(file: GripperFile, robot: Urdf) -> Iterator[str]:
    """All in which a gripper's file does not fit its URDF, or is impossible, in words.

    Names exist, every joint that moves is told of, numbers are possible.
    """
    if numbers := tuple(endless(file)):
        yield from numbers
        return
    unknown = tuple(_unknown(robot, "base_link", [file.base_link], robot.links))
    yield from unknown
    if not unknown:
        yield from _hand_faults(file, robot, robot.subtree(file.base_link))
    yield from _number_faults(file)


def _hand_faults(file: GripperFile, robot: Urdf, hand: Urdf) -> Iterator[str]:
    moving = {joint.name: joint for joint in hand.joints if joint.moves}
    yield from (fault for joint in hand.joints if (fault := kind_fault(joint.name, joint.kind)))
    yield from _unknown(robot, "finger_links", file.finger_links, hand.links)
    yield from _unknown(robot, "joints", file.joints, moving)
    yield from _unknown(robot, "free_joints", file.free_joints, file.joints)
    for synergy in file.synergies:
        yield from _unknown(robot, f"synergy '{synergy.name}'", synergy.joints, file.joints)
    for name in moving:
        if name not in file.joints:
            yield (
                f"it says nothing about the joint '{name}' of '{robot.path}', which moves; "
                f"add [joints.{name}] with its open and closed positions, or with driven = false"
            )
    for name, table in file.joints.items():
        if name in moving:
            yield from _joint_faults(moving[name], table)


def _unknown(robot: Urdf, field: str, names: Any, known: Any) -> Iterator[str]:
    for name in names:
        if name not in known:
            yield (
                f"{field} names '{name}', which '{robot.path}' does not have below its base link; "
                f"it has {', '.join(sorted(known)) or 'none'}"
            )


def _joint_faults(joint: UrdfJoint, table: JointTable) -> Iterator[str]:
    for label, position in (("open", table.open), ("closed", table.closed)):
        limited = joint.lower < joint.upper and joint.kind != "continuous"
        if position is not None and limited and not joint.lower - 1e-6 <= position <= joint.upper + 1e-6:
            yield (
                f"joints.{joint.name}.{label} is {position:g}, outside the URDF's limits "
                f"{joint.lower:g} to {joint.upper:g}"
            )
    for label, told, value in (
        ("effort", table.effort, joint.effort),
        ("velocity", table.velocity, joint.velocity),
    ):
        if table.driven and (value if told is None else told) <= 0:
            yield (
                f"the {label} of the joint '{joint.name}' must be greater than 0; the URDF has {value:g}, "
                f"so give {label} in [joints.{joint.name}]"
            )


def _number_faults(file: GripperFile) -> Iterator[str]:
    low, high = file.standoff
    if not 0 <= low <= high:
        yield f"standoff must be [least, greatest], 0 or more, got [{low:g}, {high:g}]"
    if file.palm_offset < 0:
        yield f"palm_offset must be 0 or more, got {file.palm_offset:g}"
    if not np.linalg.norm(file.approach_axis) > 0:
        yield "approach_axis must not be zero"
    if file.jaw is not None:
        yield from _jaw_faults(file, file.jaw)
    if not file.finger_links:
        yield "finger_links must name at least one link"
    for link in sorted(link for link, times in Counter(file.finger_links).items() if times > 1):
        yield f"finger_links names '{link}' more than once; name each link once"


def _jaw_faults(file: GripperFile, jaw: JawTable) -> Iterator[str]:
    if not jaw.opening > 0:
        yield f"jaw.opening must be greater than 0, got {jaw.opening:g}"
    lengths = np.linalg.norm(jaw.axis) * np.linalg.norm(file.approach_axis)
    if not lengths > 0 or abs(np.dot(jaw.axis, file.approach_axis)) > RIGHT * lengths:
        yield f"jaw.axis must be at right angles to approach_axis, got {list(jaw.axis)}"
