"""Replay files: a request to replay one evaluation and its answer, in one folder.

The processes that ask and replay are of different rooms. Lengths are metres, quaternions xyzw; the frame of
all of it is the object's centre-of-mass frame as the object lies at first.
"""

from typing import Literal

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

SCENE, REQUEST, ANSWER, FRAMES = "scene.bundle", "request.json", "answer.json", "frames.npy"
"""Files: scene bundle, `ReplayRequest`, `ReplayAnswer`, frames (n, height, width, 3), uint8."""

ReplayPart = Literal["all", "closing", "shakes"]
Phase = Literal["placed", "closing", "shake z", "shake x", "settling", "pushes", "lift"]
Vector = tuple[float, float, float]
Pose = tuple[float, float, float, float, float, float, float]
"""x y z [m], qx qy qz qw."""


class ReplayRequest(Struct, frozen=True, kw_only=True):
    """Evaluation and view to be shown."""

    genome: tuple[float, ...]
    """Genome of the prior `given`, each number as float32 has it."""
    trial: int
    """0: the nominal evaluation."""
    width: int
    height: int
    view: tuple[float, float] | None = None
    """Azimuth and elevation of the camera about the object's z [deg].

    None: the view in which fingers and object are seen best.
    """
    what: ReplayPart | None = None
    """The part of the evaluation that is filmed; None: one frame, of the hand after closing."""
    parts: bool = False
    """True: the object is drawn as its convex parts, which are simulated; False: its surface."""
    pregrasp: bool = False
    """True: one frame, of the hand as it is placed, before closing."""


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


class ReplayFrame(Struct, frozen=True, kw_only=True):
    """One frame."""

    phase: Phase
    step: int
    """Steps of 1/240 s since the phase began."""
    seconds: float
    """Duration for which it is shown."""
    hand: Pose
    """Pose of the hand's base link."""
    object: Pose
    touches: tuple[ContactPoint, ...]


class ReplayCamera(Struct, frozen=True, kw_only=True):
    """The camera of a frame."""

    azimuth: float
    """[deg]"""
    elevation: float
    """[deg]"""
    matrix: tuple[float, ...]
    """(4, 4), row by row: from homogeneous points to OpenGL's clip coordinates."""
    width: int
    height: int

    def pixels(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Project points (n, 3) to columns and rows (n, 2) from the image's upper left corner."""
        whole = np.column_stack([points, np.ones(len(points))])
        clip = whole @ np.array(self.matrix).reshape(4, 4).T
        right, up = (clip[:, :2] / clip[:, 3:]).T
        return np.column_stack([(1 + right) / 2 * self.width, (1 - up) / 2 * self.height])


class ReplayAnswer(Struct, frozen=True, kw_only=True):
    """Result of the replayed evaluation, with its frames."""

    outcome: int
    """Value of an `Outcome`."""
    fitness: int
    joints: tuple[float, ...]
    """Finger joints as a row has them."""
    contacts: int
    penetration: float
    settled: Pose
    """The hand's root link after closing, as a row has it; zeros where no finger touches then."""
    contact_links: tuple[int, ...]
    """As a row has them, without empty places; none where the scene has no room for contacts."""
    contact_points: tuple[float, ...]
    camera: ReplayCamera
    """The same for all frames."""
    shots: tuple[ReplayFrame, ...]
