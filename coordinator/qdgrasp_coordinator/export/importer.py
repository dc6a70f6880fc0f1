"""Imports a file of grasps as poses that can be evaluated with a hand and an object at hand.

The format is found by how a file begins. Of hands and objects only what poses depend on is made: no convex
parts, no mass.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.asset_paths import named_path
from qdgrasp_assets.catalog import check_object, find_gripper, find_object, object_names
from qdgrasp_assets.geometry.rotation import Floats, conjugate
from qdgrasp_assets.object_model import read_solid
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_coordinator.export import acronym, graspgen, isaac, tabular
from qdgrasp_coordinator.export.frames import COM, MESH, Frame, change_frame, jaw_turn, turn_hand_axes
from qdgrasp_coordinator.export.imported_grasps import (
    LONGEST,
    ImportedGrasps,
    UnreadableGrasps,
    check_grasps,
    check_positions,
    decode_json,
)
from qdgrasp_coordinator.export.metadata import GraspMetadata
from qdgrasp_coordinator.storage.outputs import OutFile
from qdgrasp_protocol.rows import NO_SYNERGY
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.text import first_few


@dataclass(frozen=True)
class ObjectFrame:
    """The object that grasps are evaluated on."""

    com_in_mesh: Floats
    """(3,) [m]: the centre of mass in the frame of the mesh, as scaled."""
    scale: float
    """What the lengths in its mesh file are multiplied by to be metres."""


def hand_named(name: str) -> SceneGripper:
    """The gripper of the catalog with this name, or the one whose TOML file this is.

    Raises UnknownName or UnknownKey or AssetError: as in `catalog.build_scene`.
    """
    return find_gripper(name).on_carrier("paper")


def object_frame(name: str, scale: float | None = None) -> ObjectFrame:
    """The object of the catalog with this name, or the one whose mesh file this is.

    Raises UnknownName or AssetError: as in `catalog.build_scene`.
    """
    check_object(name)
    if name in object_names():
        com = find_object(RunSpec(gripper="", object=name, scale=scale)).com_in_mesh
    else:
        com = read_solid(named_path(name), scale).centre_of_mass
    return ObjectFrame(np.array(com), 1.0 if scale is None else scale)


KNOWN_FORMATS = (
    "ACRONYM (HDF5 or JSON), GraspGen JSON, Isaac Grasp YAML, and Parquet that `qdgrasp export` wrote"
)
LARGEST_FILE = 1 << 32  # Bytes of a file that is read
LARGEST_JSON = 1 << 29  # The same of JSON, which takes more room in memory than on the disk
HEAD_BYTES = 4096


class ImportFormat(NamedTuple):
    """One line of the table."""

    fits: Callable[[bytes], bool]
    """Whether a file that begins so is one."""
    read: Callable[[Path], ImportedGrasps]


def read_grasp_file(path: Path) -> ImportedGrasps:
    """The grasps in a file of any format that is known, checked.

    Raises Unusable: it cannot be read, is of no known format, is damaged, or tells what cannot be.
    """
    head = _read_head(path)
    for reader in READERS:
        if reader.fits(head):
            try:
                told = reader.read(path)
                check_grasps(path, told)
            except MemoryError:
                raise UnreadableGrasps(path, "there is not enough memory for it") from None
            return told
    raise UnreadableGrasps(path, f"it is of none of the formats that are read: {KNOWN_FORMATS}")


def _read_head(path: Path) -> bytes:
    """How a file begins, if it is one that may be read."""
    try:
        if path.is_dir():
            raise UnreadableGrasps(
                path, f"it is a folder; of one that is for GraspGen name the JSON in {graspgen.DATA}"
            )
        if path.exists() and not path.is_file():
            raise UnreadableGrasps(path, "it is no ordinary file")
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
        size = path.stat().st_size
    except OSError as error:
        raise UnreadableGrasps(path, (error.strerror or str(error)).lower()) from None
    if not head.strip():
        raise UnreadableGrasps(path, "it is empty")
    if size > LARGEST_FILE:
        raise UnreadableGrasps(path, f"it is larger than {LARGEST_FILE >> 30} GiB")
    return head


class JsonKeys(msgspec.Struct):
    """What tells JSON files from each other."""

    grasps: msgspec.Raw = msgspec.Raw(b"")


def _read_json(path: Path) -> ImportedGrasps:
    if path.stat().st_size > LARGEST_JSON:
        raise UnreadableGrasps(path, f"it is JSON, and larger than {LARGEST_JSON >> 20} MiB")
    payload = path.read_bytes()
    is_nested = bool(bytes(decode_json(path, payload, JsonKeys).grasps))
    return graspgen.read(path, payload) if is_nested else acronym.read_json(path, payload)


def _refuse_csv(path: Path) -> ImportedGrasps:
    raise UnreadableGrasps(
        path, "it is CSV of `qdgrasp export`, which is not read back; export parquet instead"
    )


READERS = (
    ImportFormat(lambda head: head.startswith(b"# qdgrasp: "), _refuse_csv),
    ImportFormat(lambda head: head.startswith(b"\x89HDF\r\n\x1a\n"), acronym.read),
    ImportFormat(lambda head: head.startswith(tabular.MAGIC), tabular.read_parquet),
    ImportFormat(lambda head: head.lstrip().startswith(b"{"), _read_json),
    ImportFormat(lambda head: b"\0" not in head, isaac.read),
)


POSE_TOLERANCE = 1e-9  # Two lengths that differ by less are the same [m]
VALUE_TOLERANCE = 1e-6  # Two scales that differ by a smaller share are the same
MOST_SHOWN = 5  # Names in a note, at most


@dataclass(frozen=True)
class ImportedPoses:
    """Poses of a hand's root link in the object's centre-of-mass frame, as `qdgrasp evaluate` takes them."""

    arrays: dict[str, NDArray[np.generic]]
    """By name, as in an npz file of poses; beside them `name` and `confidence` as the file told them."""
    notes: tuple[str, ...]
    """What is not as the file says, a sentence each."""
    about: GraspMetadata | None
    """What the file says of itself, if it is one of ours."""
    mass: float | None
    """Of the object, as the file says [kg]; None: it does not."""
    friction: float | None
    """The same of its lateral friction."""

    def __len__(self) -> int:
        return len(self.arrays["name"])

    def write(self, out: OutFile) -> None:
        """Write the poses.

        Raises DiskFull or OutputError: they cannot be written.
        """
        with out.writing() as made, made.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **self.arrays)


def import_poses(
    path: Path, hand: SceneGripper, thing: ObjectFrame, frame: Frame | None = None
) -> ImportedPoses:
    """The grasps in a file, for a hand and an object.

    `frame`: in which frame of the object the file tells poses; None: as it says, or that of the mesh. Raises
    Unusable: the file cannot be read, says that poses are told in another frame, or names synergies that the
    hand does not have.
    """
    told = read_grasp_file(path)
    _check_frame(path, told, frame)
    poses = _root_poses(told, hand, thing, frame)
    check_positions(path, told.names, poses)
    arrays: dict[str, NDArray[np.generic]] = {
        "base_position": poses[:, :3].astype(np.float32),
        "base_quaternion_xyzw": poses[:, 3:].astype(np.float32),
        "synergy": _synergy_labels(path, told, hand),
        "spread": _spreads(told, hand),
        "name": told.names,
        "confidence": np.full(len(told), np.nan) if told.confidence is None else told.confidence,
    }
    return ImportedPoses(arrays, tuple(_notes(told, hand, thing)), told.about, told.mass, told.friction)


def _check_frame(path: Path, told: ImportedGrasps, frame: Frame | None) -> None:
    if told.about and frame not in (None, told.about.frame):
        raise UnreadableGrasps(
            path,
            f"it says that its poses are told in the object's {told.about.frame} frame; leave --frame out",
        )


def _root_poses(told: ImportedGrasps, hand: SceneGripper, thing: ObjectFrame, frame: Frame | None) -> Floats:
    """(n, 7): of the root link, in the centre-of-mass frame."""
    poses = turn_hand_axes(told.poses, conjugate(jaw_turn(hand)[None])[0]) if told.is_turned else told.poses
    source = told.frame or frame or MESH
    known = np.array(told.about.com_in_mesh) if told.about else thing.com_in_mesh
    if source == COM and np.abs(known - thing.com_in_mesh).max() < POSE_TOLERANCE:
        return poses
    return change_frame(change_frame(poses, known, source, MESH), thing.com_in_mesh, MESH, COM)


def _synergy_labels(path: Path, told: ImportedGrasps, hand: SceneGripper) -> NDArray[np.int64]:
    """The label (n,) of each synergy; none is told: all driven joints close."""
    names = [synergy.name for synergy in hand.synergies]
    if told.synergies is None:
        return np.full(len(told), NO_SYNERGY)
    labels = {name: label for label, name in enumerate(names)} | {"": NO_SYNERGY}
    for name in np.unique(told.synergies).tolist():
        if name not in labels:
            known = ", ".join(names) or "none"
            raise UnreadableGrasps(path, f"it names synergy '{name}'; the gripper '{hand.name}' has {known}")
    return np.array([labels[name] for name in told.synergies.tolist()], dtype=np.int64)


def _spreads(told: ImportedGrasps, hand: SceneGripper) -> Floats:
    """What free joints start from (n, k) [rad]; NaN: the open posture."""
    unknown = np.full(len(told), np.nan)
    free = [told.starts.get(joint.name, unknown) for joint in hand.free_joints]
    return np.stack(free, axis=1) if free else np.zeros((len(told), 0))


def _notes(told: ImportedGrasps, hand: SceneGripper, thing: ObjectFrame) -> Iterator[str]:
    """What is not as the file says, a sentence each."""
    if (
        told.scale is not None
        and abs(told.scale / thing.scale - 1) > VALUE_TOLERANCE
        and not _is_built_in(told)
    ):
        yield (
            f"The file scales its mesh by {told.scale:.16g}, and here it is scaled by {thing.scale:.16g}: if "
            f"it is the same mesh, add --scale {told.scale:.16g}."
        )
    if told.gripper not in (None, hand.name) or told.link not in (None, hand.base_link):
        link = "" if told.link is None else f" of link '{told.link[:LONGEST]}'"
        owner = "" if told.gripper is None else f" of gripper '{told.gripper[:LONGEST]}'"
        yield (
            f"The file tells poses{link}{owner}; they are taken for those of link '{hand.base_link}' of "
            f"gripper '{hand.name}'."
        )
    known = {joint.name for joint in hand.joints}
    if unknown := [name for name in dict.fromkeys((*told.starts, *told.joints)) if name not in known]:
        some = first_few(unknown, MOST_SHOWN)
        yield f"The file names joints that gripper '{hand.name}' does not have: {some}; they are left aside."
    about = told.about
    if about and np.abs(np.array(about.com_in_mesh) - thing.com_in_mesh).max() >= POSE_TOLERANCE:
        name = about.object[:LONGEST]
        yield (
            f"The object '{name}' of the file has its centre of mass elsewhere in its mesh, "
            "so it is not the same object."
        )


def _is_built_in(told: ImportedGrasps) -> bool:
    return told.about is not None and not told.about.object_file
