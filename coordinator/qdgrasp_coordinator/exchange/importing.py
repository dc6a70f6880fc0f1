"""Importing: from a file of grasps to poses that can be evaluated with a hand and an object at hand."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats, conjugate
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_coordinator.exchange import reading
from qdgrasp_coordinator.exchange.about import About
from qdgrasp_coordinator.exchange.checking import check_positions
from qdgrasp_coordinator.exchange.frames import COM, MESH, Frame, jaw_turn, moved, turned
from qdgrasp_coordinator.exchange.things import Thing
from qdgrasp_coordinator.exchange.told import LONGEST, Told, Unusable
from qdgrasp_coordinator.folders.outputs import OutFile
from qdgrasp_protocol.genome import NO_SYNERGY
from qdgrasp_protocol.phrases import few

NEAR = 1e-9
"""Two lengths that differ by less are the same [m]."""
ALIKE = 1e-6
"""Two scales that differ by a smaller share are the same."""
SHOWN = 5
"""Names in a note, at most."""


@dataclass(frozen=True)
class Imported:
    """Poses of a hand's root link in the object's centre-of-mass frame, as `qdgrasp evaluate` takes them."""

    arrays: dict[str, NDArray[np.generic]]
    """By name, as in an npz file of poses; beside them `name` and `confidence` as the file told them."""
    notes: tuple[str, ...]
    """What is not as the file says, a sentence each."""
    about: About | None
    """What the file says of itself, if it is one of ours."""
    mass: float | None
    """Of the object, as the file says [kg]; None: it does not."""
    friction: float | None
    """The same of its lateral friction."""

    def __len__(self) -> int:
        return len(self.arrays["name"])

    def write(self, out: OutFile) -> None:
        """Write the poses.

        Raises
        ------
        DiskFull, OutputError
            They cannot be written.
        """
        with out.writing() as made, made.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **self.arrays)


def read_grasps(path: Path, hand: SceneGripper, thing: Thing, frame: Frame | None = None) -> Imported:
    """The grasps in a file, for a hand and an object.

    Parameters
    ----------
    frame
        In which frame of the object the file tells poses; None: as it says, or that of the mesh.

    Raises
    ------
    Unusable
        The file cannot be read, says that poses are told in another frame, or names synergies that the hand
        does not have.
    """
    told = reading.read(path)
    _check_frame(path, told, frame)
    poses = _poses(told, hand, thing, frame)
    check_positions(path, told.names, poses)
    arrays: dict[str, NDArray[np.generic]] = {
        "base_position": poses[:, :3].astype(np.float32),
        "base_quaternion_xyzw": poses[:, 3:].astype(np.float32),
        "synergy": _labels(path, told, hand),
        "spread": _spreads(told, hand),
        "name": told.names,
        "confidence": np.full(len(told), np.nan) if told.confidence is None else told.confidence,
    }
    return Imported(arrays, tuple(_notes(told, hand, thing)), told.about, told.mass, told.friction)


def _check_frame(path: Path, told: Told, frame: Frame | None) -> None:
    if told.about and frame not in (None, told.about.frame):
        raise Unusable(
            path,
            f"it says that its poses are told in the object's {told.about.frame} frame; leave --frame out",
        )


def _poses(told: Told, hand: SceneGripper, thing: Thing, frame: Frame | None) -> Floats:
    """(n, 7): of the root link, in the centre-of-mass frame."""
    poses = turned(told.poses, conjugate(jaw_turn(hand)[None])[0]) if told.is_turned else told.poses
    source = told.frame or frame or MESH
    known = np.array(told.about.com_in_mesh) if told.about else thing.com_in_mesh
    if source == COM and np.abs(known - thing.com_in_mesh).max() < NEAR:
        return poses
    return moved(moved(poses, known, source, MESH), thing.com_in_mesh, MESH, COM)


def _labels(path: Path, told: Told, hand: SceneGripper) -> NDArray[np.int64]:
    """The label (n,) of each synergy; none is told: all driven joints close."""
    names = [synergy.name for synergy in hand.synergies]
    if told.synergies is None:
        return np.full(len(told), NO_SYNERGY)
    labels = {name: label for label, name in enumerate(names)} | {"": NO_SYNERGY}
    for name in np.unique(told.synergies).tolist():
        if name not in labels:
            known = ", ".join(names) or "none"
            raise Unusable(path, f"it names synergy '{name}'; the gripper '{hand.name}' has {known}")
    return np.array([labels[name] for name in told.synergies.tolist()], dtype=np.int64)


def _spreads(told: Told, hand: SceneGripper) -> Floats:
    """What free joints start from (n, k) [rad]; NaN: the open posture."""
    unknown = np.full(len(told), np.nan)
    free = [told.starts.get(joint.name, unknown) for joint in hand.free_joints]
    return np.stack(free, axis=1) if free else np.zeros((len(told), 0))


def _notes(told: Told, hand: SceneGripper, thing: Thing) -> Iterator[str]:
    """What is not as the file says, a sentence each."""
    if told.scale is not None and abs(told.scale / thing.scale - 1) > ALIKE and not _is_built_in(told):
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
        some = few(unknown, SHOWN)
        yield f"The file names joints that gripper '{hand.name}' does not have: {some}; they are left aside."
    about = told.about
    if about and np.abs(np.array(about.com_in_mesh) - thing.com_in_mesh).max() >= NEAR:
        name = about.object[:LONGEST]
        yield (
            f"The object '{name}' of the file has its centre of mass elsewhere in its mesh, "
            "so it is not the same object."
        )


def _is_built_in(told: Told) -> bool:
    return told.about is not None and not told.about.object_file
