"""Told: what a file of grasps tells, whoever wrote it, before it is known of which hand and object.

Files come from anywhere: they are read without trust, and refused in one sentence.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats
from qdgrasp_coordinator.exchange.about import About
from qdgrasp_protocol.errors import InputError

MOST = 10_000_000
"""Grasps in a file, at most."""
Kind = TypeVar("Kind", bound=Struct)
OFF_UNIT = 1e-2
"""A quaternion may be so much longer or shorter than one, and a matrix so far from a rotation."""


class Unusable(InputError):
    """A file that no grasps can be read from.

    Parameters
    ----------
    path
        The file.
    reason
        Why not; lines of others become one.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"No grasps can be read from '{path}': {' '.join(reason.split()).rstrip('.')}.")


@dataclass(frozen=True)
class Told:
    """Grasps as a file tells them: arrays of n lines."""

    names: NDArray[np.str_]
    """(n,)."""
    poses: Floats
    """(n, 7): x y z [m] and quaternion xyzw of the hand in the object's frame."""
    is_turned: bool = False
    """Whether the hand's axes are +z towards the object and x across the jaw, not those of its root link."""
    starts: Mapping[str, Floats] = field(default_factory=dict)
    """Joints that hands start from, by name: (n,) [rad or m], NaN where it is not told."""
    joints: tuple[str, ...] = ()
    """Other joints of the hand that the file names."""
    synergies: NDArray[np.str_] | None = None
    """(n,), empty where all driven joints close; None: not told."""
    confidence: Floats | None = None
    """(n,); None: not told."""
    scale: float | None = None
    """What the object's mesh is scaled by; None: not told."""
    mass: float | None = None
    """Of the object [kg]; None: not told."""
    friction: float | None = None
    """Lateral coefficient of the object; None: not told."""
    about: About | None = None
    """None: the file is not one of ours."""

    def __len__(self) -> int:
        return len(self.poses)


def read_about(path: Path, text: str | bytes) -> About:
    """What a file of ours says of itself, as JSON.

    Raises
    ------
    Unusable
        It says something else.
    """
    try:
        return msgspec.json.decode(text, type=About)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise Unusable(path, f"what it says of itself cannot be read ({error})") from None


def check(path: Path, told: Told) -> None:
    """Check that a file tells grasps that can be.

    Raises
    ------
    Unusable
        There is none, a number is not finite, or a quaternion is not one of a rotation.
    """
    if not len(told):
        raise Unusable(path, "there is none in it")
    finite = np.asarray(np.isfinite(told.poses).all(axis=1))
    _check_each(path, told, finite, "its pose holds a number that is not finite")
    lengths = np.linalg.norm(told.poses[:, 3:], axis=1)
    unit = np.asarray(np.abs(lengths - 1.0) <= OFF_UNIT)
    wrong = lengths[~unit][0] if not unit.all() else 1.0
    _check_each(path, told, unit, f"its quaternion must be of length 1, and is of length {wrong:.4g}")
    for joint, values in told.starts.items():
        _check_each(path, told, ~np.isinf(values), f"joint '{joint}' is infinite")


def check_matrices(path: Path, matrices: Floats) -> None:
    """Check that matrices (n, 4, 4) are homogeneous ones of rigid motions.

    Raises
    ------
    Unusable
        One is not.
    """
    turns = matrices[:, :3, :3]
    with np.errstate(invalid="ignore", over="ignore"):
        is_finite = np.isfinite(matrices).all(axis=(1, 2))
        off = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0)
        is_rigid = is_finite & (off <= OFF_UNIT) & (np.linalg.det(turns) > 0)
        is_rigid &= (matrices[:, 3] == (0.0, 0.0, 0.0, 1.0)).all(axis=1)
    if not is_rigid.all():
        number = int(np.flatnonzero(~is_rigid)[0])
        raise Unusable(path, f"transform {number} is not a rotation and a translation")


def decoded(path: Path, payload: bytes, kind: type[Kind]) -> Kind:
    """What a JSON text says, as a struct.

    Raises
    ------
    Unusable
        It says something else, or is not JSON.
    """
    try:
        return msgspec.json.decode(payload, type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise Unusable(path, f"it is not JSON with grasps ({error})") from None


def to_array(
    path: Path, what: str, values: object, shape: tuple[int, ...], count: int | None = None
) -> Floats:
    """Lists of numbers as an array (n, *shape).

    Raises
    ------
    Unusable
        They are not of that shape.
    """
    try:
        found = np.array(values, dtype=np.float64)
    except ValueError:
        found = np.zeros(())
    if not found.size and shape:
        found = found.reshape(0, *shape)
    if found.ndim != 1 + len(shape) or found.shape[1:] != shape or count not in (None, len(found)):
        sides = "".join(f", {side}" for side in shape)
        raise Unusable(path, f"its {what} must be of shape ({'n' if count is None else count}{sides})")
    return found


def _check_each(path: Path, told: Told, good: NDArray[np.bool_], what: str) -> None:
    if not good.all():
        raise Unusable(path, f"of grasp '{told.names[~good][0]}' {what}")
