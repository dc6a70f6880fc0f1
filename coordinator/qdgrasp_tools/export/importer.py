"""Imports a file of grasps as poses that can be evaluated with a hand and an object at hand.

The first bytes of a file tell its format. Of hands and objects only what poses depend on is made: no convex
parts, no mass.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.asset_paths import named_path
from qdgrasp_assets.catalog import check_object, find_object, object_names
from qdgrasp_assets.geometry.rotation import Floats, conjugate, multiply
from qdgrasp_assets.object_model import read_solid
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_coordinator.storage.outputs import OutFile
from qdgrasp_protocol.errors import InputError, check_packages
from qdgrasp_protocol.rows import NO_SYNERGY
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.text import first_few
from qdgrasp_tools.export import jaw_files, tabular, yaml_files
from qdgrasp_tools.export.grasp_table import (
    COM,
    MESH,
    Frame,
    GraspMetadata,
    GraspTable,
    UnreadableGrasps,
    change_frame,
    check_positions,
    check_table,
    jaw_turn,
    turn_hand_axes,
)


@dataclass(frozen=True)
class ObjectFrame:
    """The object that grasps are evaluated on."""

    com_in_mesh: Floats
    """(3,) [m]: the centre of mass in the frame of the mesh, as scaled."""
    scale: float
    """Factor of the lengths in its mesh file, to metres."""
    extents: Floats
    """(3,) [m]: sides of its bounding box."""


def object_frame(name: str, scale: float | None = None) -> ObjectFrame:
    """Find an object by its name in the catalog, or by its mesh file."""
    check_object(name)
    if name in object_names():
        found = find_object(RunSpec(gripper="", object=name, scale=scale))
        com, mesh = found.com_in_mesh, found.mesh
    else:
        mesh = read_solid(named_path(name), scale)
        com = mesh.centre_of_mass
    return ObjectFrame(np.array(com), 1.0 if scale is None else scale, mesh.extents)


KNOWN_FORMATS = (
    "ACRONYM (HDF5 or JSON), GraspGen JSON, Isaac Grasp YAML, and Parquet that `qdgrasp export` wrote"
)


class ImportFormat(NamedTuple):
    """One format of files of grasps."""

    fits: Callable[[bytes], bool]
    """Returns True for the first bytes of a file of this format."""
    read: Callable[[Path], GraspTable]
    packages: tuple[str, ...] = ()
    """Packages of extras that read it."""


def read_grasp_file(path: Path) -> GraspTable:
    """Read and check the grasps in a file of any known format; raises UnreadableGrasps."""
    if path.is_dir():
        raise UnreadableGrasps(path, "it is a folder; name a file in it")
    try:
        with path.open("rb") as file:
            head = file.read(64)
    except OSError as error:
        raise UnreadableGrasps(path, (error.strerror or str(error)).lower()) from None
    if not head.strip():
        raise UnreadableGrasps(path, "it is empty")
    reader = next((each for each in READERS if each.fits(head)), None)
    if reader is None:
        raise UnreadableGrasps(path, f"it is of none of the formats that are read: {KNOWN_FORMATS}")
    check_packages(str(path), *reader.packages)
    try:
        table = reader.read(path)
        check_table(path, table)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001  # of h5py, pyarrow, yaml, msgspec and numpy
        raise UnreadableGrasps(path, f"it is damaged, or not of its format ({error})") from None
    return table


READERS = (
    ImportFormat(lambda head: head.startswith(b"\x89HDF\r\n\x1a\n"), jaw_files.read_acronym, ("h5py",)),
    ImportFormat(lambda head: head.startswith(b"PAR1"), tabular.read_parquet, ("pyarrow",)),
    ImportFormat(lambda head: head.lstrip().startswith(b"{"), jaw_files.read_json),
    ImportFormat(lambda head: b"\0" not in head and head[:1] != b"#", yaml_files.read_isaac),
)
POSE_TOLERANCE = 1e-9  # Two lengths that differ by less are the same [m]
VALUE_TOLERANCE = 1e-6  # Two scales that differ by a smaller share are the same
SAME_OBJECT = 0.02
"""Difference of sides and centre of mass, as a share of the largest side, up to which two objects are one."""
HALF_TURN = np.array([[0.0, 0.0, 1.0, 0.0]])  # Quaternion of 180 degrees about z
MOST_SHOWN = 5  # Names in a note, at most


@dataclass(frozen=True)
class ImportedPoses:
    """Poses of a hand's root link, CoM frame of the object, as `qdgrasp evaluate` takes them."""

    arrays: dict[str, NDArray[np.generic]]
    """By name, as in an npz file of poses; beside them the file's `name` and `confidence`."""
    notes: tuple[str, ...]
    """Differences from what the file says, a sentence each."""
    mismatches: tuple[str, ...]
    """Reasons why the file is of another hand or object, a sentence each; known of files of ours alone."""
    imported: GraspTable
    """The grasps as the file gives them."""

    def __len__(self) -> int:
        return len(self.arrays["name"])

    def write(self, out: OutFile) -> None:
        """Write the poses as an npz file."""
        with out.writing() as made, made.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **self.arrays)


def import_poses(
    path: Path,
    hand: SceneGripper,
    body: ObjectFrame,
    frame: Frame | None = None,
    *,
    flip_jaw: bool = False,
) -> ImportedPoses:
    """Read the grasps in a file as poses of a hand on an object.

    `frame` is that of the object in which the file gives poses; None: as it says, or that of the mesh. With
    `flip_jaw` the axes of the jaw in the file are turned by 180 degrees about the approach against
    `jaw_turn`. Raises UnreadableGrasps if the file cannot be read, says that poses are in another frame, or
    names synergies that the hand does not have.
    """
    imported = read_grasp_file(path)
    metadata = imported.metadata
    if metadata and frame not in (None, metadata.frame):
        reason = f"it says that its poses are in the object's {metadata.frame} frame; leave --frame out"
        raise UnreadableGrasps(path, reason)
    if flip_jaw and not imported.has_jaw_axes:
        raise UnreadableGrasps(path, "its axes are those of a link, not of a jaw; leave --flip-jaw out")
    poses = _root_poses(imported, hand, body, frame, flip_jaw=flip_jaw)
    check_positions(path, imported.names, poses)
    unknown = np.full(len(imported), np.nan)  # the open posture
    columns = () if imported.pregrasp is None else imported.pregrasp.T
    starts = dict(zip(imported.joint_names, columns, strict=False))
    free = [starts.get(joint.name, unknown) for joint in hand.free_joints]
    arrays: dict[str, NDArray[np.generic]] = {
        "base_position": poses[:, :3].astype(np.float32),
        "base_quaternion_xyzw": poses[:, 3:].astype(np.float32),
        "synergy": _synergy_labels(path, imported, hand),
        "spread": np.stack(free, axis=1) if free else np.zeros((len(imported), 0)),
        "name": imported.names,
        "confidence": np.full(len(imported), np.nan) if imported.confidence is None else imported.confidence,
    }
    notes, mismatches = list(_notes(imported, hand, body)), list[str]()
    if metadata:
        mismatches += _object_mismatches(metadata, body)
    if other := _other_hand(imported, hand):
        here = f"link '{hand.base_link}' of gripper '{hand.name}'"
        if metadata:
            mismatches.insert(0, f"{other}, not of {here}.")
        else:
            notes.insert(0, f"{other}; they are taken for those of {here}.")
    return ImportedPoses(arrays, tuple(notes), tuple(mismatches), imported)


def _root_poses(
    imported: GraspTable, hand: SceneGripper, body: ObjectFrame, frame: Frame | None, *, flip_jaw: bool
) -> Floats:
    """Return the poses (n, 7) of the root link, in the centre-of-mass frame."""
    poses = imported.poses
    if imported.has_jaw_axes:
        back = conjugate(jaw_turn(hand)[None])
        poses = turn_hand_axes(poses, (multiply(HALF_TURN, back) if flip_jaw else back)[0])
    source = imported.frame or frame or MESH
    known = np.array(imported.metadata.com_in_mesh) if imported.metadata else body.com_in_mesh
    if source == COM and np.abs(known - body.com_in_mesh).max() < POSE_TOLERANCE:
        return poses
    return change_frame(change_frame(poses, known, source, MESH), body.com_in_mesh, MESH, COM)


def _synergy_labels(path: Path, imported: GraspTable, hand: SceneGripper) -> NDArray[np.int64]:
    """Return the label (n,) of each synergy; without one all driven joints close."""
    names = [synergy.name for synergy in hand.synergies]
    if imported.synergies is None:
        return np.full(len(imported), NO_SYNERGY)
    labels = {name: label for label, name in enumerate(names)} | {"": NO_SYNERGY}
    for name in np.unique(imported.synergies).tolist():
        if name not in labels:
            known = ", ".join(names) or "none"
            raise UnreadableGrasps(path, f"it names synergy '{name}'; the gripper '{hand.name}' has {known}")
    return np.array([labels[name] for name in imported.synergies.tolist()], dtype=np.int64)


def _notes(imported: GraspTable, hand: SceneGripper, body: ObjectFrame) -> Iterator[str]:
    is_built_in = imported.metadata is not None and not imported.metadata.object_file
    scale = imported.scale
    if scale is not None and abs(scale / body.scale - 1) > VALUE_TOLERANCE and not is_built_in:
        yield (
            f"The file scales its mesh by {scale:.16g}, and here it is scaled by {body.scale:.16g}: if "
            f"it is the same mesh, add --units {scale:.16g}."
        )
    known = {joint.name for joint in hand.joints}
    if unknown := [name for name in imported.joint_names if name not in known]:
        some = first_few(unknown, MOST_SHOWN)
        yield f"The file names joints that gripper '{hand.name}' does not have: {some}; they are ignored."


def _other_hand(imported: GraspTable, hand: SceneGripper) -> str:
    """Return the beginning of a sentence on a file of another hand; empty: it is of this one."""
    if imported.gripper in (None, hand.name) and imported.link in (None, hand.base_link):
        return ""
    link = "" if imported.link is None else f" of link '{imported.link}'"
    owner = "" if imported.gripper is None else f" of gripper '{imported.gripper}'"
    return f"The file has poses{link}{owner}"


def _object_mismatches(metadata: GraspMetadata, body: ObjectFrame) -> Iterator[str]:
    """Yield in which ways a file is of another object, by its size and centre of mass."""
    name, size = metadata.object, metadata.object_size
    largest = float(body.extents.max())
    if np.abs(body.extents - size).max() > SAME_OBJECT * largest:
        here, there = (" x ".join(f"{side:.4f}" for side in each) for each in (body.extents, size))
        yield f"The object '{name}' of the file is {there} m large, and the one named here {here} m."
    if np.abs(np.array(metadata.com_in_mesh) - body.com_in_mesh).max() > max(
        SAME_OBJECT * largest, POSE_TOLERANCE
    ):
        yield (
            f"The object '{name}' of the file has its centre of mass elsewhere in its mesh, "
            "so it is not the same object."
        )
