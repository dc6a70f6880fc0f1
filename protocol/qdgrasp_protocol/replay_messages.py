"""Replay files: a request to replay one evaluation and its answer, in one folder.

The processes that ask and replay are of different rooms. Lengths are metres, quaternions xyzw; the frame of
all of it is the object's centre-of-mass frame as the object lies at first.
"""

from typing import Literal

from msgspec import Struct

from qdgrasp_protocol.rows import RESULT

SCENE, REQUEST, ANSWER = "scene.bundle", "request.json", "answer.json"
"""Files: scene bundle, `ReplayRequest`, `ReplayAnswer`."""

Phase = Literal["placed", "closing", "shake z", "shake x", "settling", "pushes", "lift"]
Vector = tuple[float, float, float]
Pose = tuple[float, float, float, float, float, float, float]
"""x y z [m], qx qy qz qw."""


class ReplayRequest(Struct, frozen=True, kw_only=True):
    """The evaluation to replay."""

    genome: tuple[float, ...]
    """Genome of the prior `given`, each number as float32 has it."""
    trial: int
    """0: the nominal evaluation."""


class ContactPoint(Struct, frozen=True, kw_only=True):
    """A point where hand and object touch."""

    link: str
    """Link of the hand."""
    is_finger: bool
    """True if contact of this link makes a success."""
    point: Vector
    """Point on the object."""
    normal: Vector
    """Object's unit normal there, towards the hand."""
    distance: float
    """Signed distance, negative where they penetrate."""


class Snapshot(Struct, frozen=True, kw_only=True):
    """State of hand and object before or after a step."""

    phase: Phase
    step: int
    """Steps of 1/240 s since the phase began."""
    root: Pose
    """Pose of the root link of the hand's URDF."""
    joints: dict[str, float]
    """Positions of all joints that move, by name [rad or m]."""
    object: Pose
    touches: tuple[ContactPoint, ...]
    """The contacts of the last collision detection."""


NOT_REPLAYED = ("steps", "descriptor", "base_to_object", "surface_point", "nu")
REPLAYED = tuple(column for column in RESULT if column.name not in NOT_REPLAYED)
"""The columns of a row that a replay finds: a pose is given to it, and it takes no shortcut."""


class ReplayAnswer(Struct, frozen=True, kw_only=True):
    """Result of the replayed evaluation, and its course."""

    columns: dict[str, bytes]
    """All of `REPLAYED` for one row, as they travel."""
    snapshots: tuple[Snapshot, ...]
    """In time; the first is of the hand as it was placed."""
