"""Grasps as a file gives them, before their hand and object are known; and their checks.

Files come from anywhere: they are read without trust, and refused in one sentence. All that read them raise
UnreadableGrasps.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_coordinator.search.fixed_poses import FARTHEST
from qdgrasp_protocol.errors import InputError
from qdgrasp_tools.export.frames import Frame
from qdgrasp_tools.export.metadata import GraspMetadata

MOST_GRASPS = 2_000_000  # Grasps in a file, at most
LONGEST = 200  # Letters of a name, at most: arrays of names have room for the longest in each place
Kind = TypeVar("Kind", bound=Struct)


class UnreadableGrasps(InputError):
    """A file that no grasps can be read from; lines of the reason become one."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"No grasps can be read from '{path}': {' '.join(reason.split()).rstrip('.')}.")


@dataclass(frozen=True)
class ImportedGrasps:
    """Grasps in a file, as arrays of n lines; None: the file does not say it."""

    names: NDArray[np.str_]
    poses: Floats
    """(n, 7): x y z [m] and quaternion xyzw of the hand in the object's frame."""
    has_jaw_axes: bool = False
    """True: the hand's axes are +z toward the object and x across the jaw, not its root link's."""
    frame: Frame | None = None
    """The object's frame that poses are given in."""
    gripper: str | None = None
    link: str | None = None
    """The hand's link that has the poses."""
    start_positions: Mapping[str, Floats] = field(default_factory=dict)
    """Joints that hands start from, by name: (n,) [rad or m], NaN where it is unknown."""
    joints: tuple[str, ...] = ()
    """Other joints of the hand that the file names."""
    synergies: NDArray[np.str_] | None = None
    """(n,), empty where all driven joints close."""
    confidence: Floats | None = None
    scale: float | None = None
    """Factor of the lengths of the object's mesh."""
    mass: float | None = None
    """Mass of the object [kg]."""
    friction: float | None = None
    """Lateral friction coefficient of the object."""
    metadata: GraspMetadata | None = None
    """Metadata of a file of ours."""

    def __len__(self) -> int:
        return len(self.poses)


def decode_metadata(path: Path, text: str | bytes) -> GraspMetadata:
    """Decode the metadata of a file of ours from JSON."""
    return decode_json(path, text, GraspMetadata, "what it says of itself cannot be read")


def decode_json(
    path: Path, payload: str | bytes, kind: type[Kind], fault: str = "it is not JSON with grasps"
) -> Kind:
    """Decode a JSON text as a struct."""
    try:
        return msgspec.json.decode(payload, type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise UnreadableGrasps(path, f"{fault} ({error})") from None


def to_array(
    path: Path, what: str, values: object, shape: tuple[int, ...], count: int | None = None
) -> Floats:
    """Convert lists of numbers to an array (n, *shape), where n is `count` if it is given."""
    try:
        found = np.array(values, dtype=np.float64)
    except ValueError:
        found = np.zeros(())
    if not found.size and shape:
        found = found.reshape(0, *shape)
    if found.ndim != 1 + len(shape) or found.shape[1:] != shape or count not in (None, len(found)):
        sides = "".join(f", {side}" for side in shape)
        raise UnreadableGrasps(
            path, f"its {what} must be of shape ({'n' if count is None else count}{sides})"
        )
    return found


def to_words(path: Path, what: str, words: Iterable[str]) -> NDArray[np.str_]:
    """Convert words to an array (n,); a word that is too long is refused."""
    found = list(words)
    for word in found:
        if len(word) > LONGEST:
            raise UnreadableGrasps(
                path, f"its {what} must be of {LONGEST} letters at most, and '{word[:20]}...' is longer"
            )
    return np.array(found, dtype=str)


UNIT_TOLERANCE = 1e-2
"""Tolerance of a quaternion's length, and of a matrix's products from the identity."""


def check_grasps(path: Path, imported: ImportedGrasps) -> None:
    """Check that there are grasps, and that their numbers are possible."""
    if not len(imported):
        raise UnreadableGrasps(path, "there is none in it")
    check_positions(path, imported.names, imported.poses)
    lengths = np.linalg.norm(imported.poses[:, 3:], axis=1)
    unit = np.asarray(np.abs(lengths - 1.0) <= UNIT_TOLERANCE)
    wrong = lengths[~unit][0] if not unit.all() else 1.0
    _check_each(
        path, imported.names, unit, f"its quaternion must be of length 1, and is of length {wrong:.4g}"
    )
    for joint, values in imported.start_positions.items():
        _check_each(path, imported.names, ~np.isinf(values), f"joint '{joint}' is infinite")
    for what, value in (("scale", imported.scale), ("mass", imported.mass), ("friction", imported.friction)):
        _check_positive(path, f"the object's {what}", value)
    if imported.metadata:
        _check_metadata(path, imported.metadata)


def check_positions(path: Path, names: NDArray[np.str_], poses: Floats) -> None:
    """Check that poses (n, 7) are finite, and near enough for their digits to mean something."""
    finite = np.asarray(np.isfinite(poses).all(axis=1))
    _check_each(path, names, finite, "its pose holds a number that is not finite")
    near = np.asarray((np.abs(poses[:, :3]) <= FARTHEST).all(axis=1))
    _check_each(path, names, near, f"its position is more than {FARTHEST:g} m away; lengths are metres")


def check_matrices(path: Path, matrices: Floats) -> None:
    """Check that matrices (n, 4, 4) are homogeneous ones of rigid motions."""
    turns = matrices[:, :3, :3]
    with np.errstate(invalid="ignore", over="ignore"):
        is_finite = np.isfinite(matrices).all(axis=(1, 2))
        off = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0)
        is_rigid = is_finite & (off <= UNIT_TOLERANCE) & (np.linalg.det(turns) > 0)
        is_rigid &= (matrices[:, 3] == (0.0, 0.0, 0.0, 1.0)).all(axis=1)
    if not is_rigid.all():
        number = int(np.flatnonzero(~is_rigid)[0])
        raise UnreadableGrasps(path, f"transform {number} is not a rotation and a translation")


def _check_metadata(path: Path, metadata: GraspMetadata) -> None:
    for name in ("object_scale", "object_mass"):
        _check_positive(path, name, getattr(metadata, name))
    if not 0 <= metadata.object_friction < np.inf:
        raise UnreadableGrasps(
            path, f"object_friction in it must not be negative, and is {metadata.object_friction:g}"
        )
    for name in ("object_com", "com_in_mesh"):
        if not all(abs(value) <= FARTHEST for value in getattr(metadata, name)):
            raise UnreadableGrasps(
                path, f"{name} in it must be finite, and not more than {FARTHEST:g} m away"
            )
    for origin in metadata.runs:
        try:
            _ = origin.asked
        except InputError as error:
            why = str(error).rstrip(".")
            raise UnreadableGrasps(
                path, f"the spec of run '{origin.run[:40]}' in it cannot be read: {why}"
            ) from None


def _check_positive(path: Path, what: str, value: float | None) -> None:
    if value is not None and not 0 < value < np.inf:
        raise UnreadableGrasps(path, f"{what} in it must be a number greater than 0, and is {value:g}")


def _check_each(path: Path, names: NDArray[np.str_], good: NDArray[np.bool_], what: str) -> None:
    if not good.all():
        raise UnreadableGrasps(path, f"of grasp '{names[~good][0]}' {what}")
