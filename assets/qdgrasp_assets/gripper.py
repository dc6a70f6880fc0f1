"""Grippers: a URDF and one TOML that says how the hand grasps, read and checked against each other."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

from qdgrasp_assets.carrier import CARRIERS
from qdgrasp_assets.gripper_faults import gripper_faults
from qdgrasp_assets.gripper_file import GripperFile, JointTable, read_gripper_file, urdf_path
from qdgrasp_assets.hands.meshes import missing_meshes
from qdgrasp_assets.hands.source import read_source
from qdgrasp_assets.hands.visuals import without_visuals
from qdgrasp_assets.hands.weight import weight_faults
from qdgrasp_assets.scene import FreeJoint, Joint, SceneGripper, Synergy
from qdgrasp_assets.shapes import largest_side
from qdgrasp_assets.urdf import Urdf, tree
from qdgrasp_assets.vectors import unit
from qdgrasp_protocol.errors import AssetError


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
            A collision mesh is missing or no ordinary file; masses are made up, refused, or hold a link
            still.
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
            A collision mesh is missing, empty or cannot be read.
        """
        file = self.file
        carried = CARRIERS[protocol](self.robot, file.base_link, file.carrier_hold_force)
        element, meshes = without_visuals(carried.urdf).bundled()
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
            approach_axis=unit(file.approach_axis),
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


def _check(path: Path, file: GripperFile, robot: Urdf) -> None:
    for fault in gripper_faults(file, robot):
        raise AssetError(f"The gripper '{path}': {fault}.")
