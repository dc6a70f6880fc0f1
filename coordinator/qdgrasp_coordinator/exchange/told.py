"""Told: what a file of grasps tells, whoever wrote it, before it is known of which hand and object.

Files come from anywhere: they are read without trust, and refused in one sentence.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats
from qdgrasp_coordinator.exchange.about import About
from qdgrasp_coordinator.exchange.frames import Frame
from qdgrasp_protocol.errors import InputError

MOST = 2_000_000
"""Grasps in a file, at most."""
LONGEST = 200
"""Letters of a name, at most: arrays of names have room for the longest in each place."""
Kind = TypeVar("Kind", bound=Struct)


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
    frame: Frame | None = None
    """The object's frame in which they are told; None: it is not said."""
    gripper: str | None = None
    """Whose poses they are; None: it is not said."""
    link: str | None = None
    """Its link whose poses they are; None: it is not said."""
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


def to_words(path: Path, what: str, words: Iterable[str]) -> NDArray[np.str_]:
    """Words as an array (n,).

    Raises
    ------
    Unusable
        One is too long.
    """
    found = list(words)
    for word in found:
        if len(word) > LONGEST:
            raise Unusable(
                path, f"its {what} must be of {LONGEST} letters at most, and '{word[:20]}...' is longer"
            )
    return np.array(found, dtype=str)
