"""Marks: frames, the approach axis and contacts, drawn where the camera sees them."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from qdgrasp_assets.scene import SceneGripper
from qdgrasp_coordinator.looking.canvas import Canvas, Point
from qdgrasp_coordinator.looking.labels import Label, Side, Spot
from qdgrasp_protocol.replay import Camera, Pose, Shot, Touch

FRAME = 0.04
"""Length of the axes of a frame [m]."""
ARROW = 0.06
"""Length at which the approach axis is drawn, from the palm [m]."""
NORMAL = 0.025
"""Length at which a contact's normal is drawn [m]."""
AXES = {"x": "#cc3311", "y": "#2e8b57", "z": "#2a73b9"}
APPROACH = "#aa3377"
INK = "#22262b"
CONTACT, OTHER, OVERLAP = "#ee7733", "#c0a020", "#dd1144"
WORDS = {
    CONTACT: "contact of a finger",
    OTHER: "contact of another link",
    OVERLAP: "overlap of the open hand",
}
"""What the colours of contacts mean."""
HUES = (APPROACH, *AXES.values(), *WORDS)
"""All of the above."""
BESIDE = 0.55
"""From a point to what is written beside it; this and what follows in heights of letters."""
BEYOND = (0.8, 1.3)
"""From the tip of an axis to the middle of its letter, farther where something else stands."""
STEPS = (0.0, 1.2, -1.2, 2.4, -2.4)
"""How far a name is moved down where something else stands."""
LINE, BOLD, THIN, DOT = 0.16, 0.2, 0.12, 0.24
"""Width of the axes of a frame, of the approach axis and of a normal; radius of a contact."""
Floats = NDArray[np.float64]


class Marks:
    """What is drawn over the frames of one replay.

    Parameters
    ----------
    size
        Of the words [pixels].
    """

    def __init__(self, gripper: SceneGripper, camera: Camera, size: int) -> None:
        self._camera = camera
        self._base = gripper.base_link
        self._size = size
        axis = np.array(gripper.approach_axis)
        reaches = (gripper.palm_offset, gripper.palm_offset + ARROW)
        self._approach = np.array([reach * axis for reach in reaches])

    def draw(self, canvas: Canvas, shot: Shot) -> None:
        """Draw all that belongs to a frame."""
        self._frame(canvas, shot.object, "object, centre of mass")
        self._frame(canvas, shot.hand, f"hand base {self._base}")
        self._arrow(canvas, shot.hand)
        for touch in shot.touches:
            self._contact(canvas, touch, colour(shot, touch))

    def _frame(self, canvas: Canvas, pose: Pose, name: str) -> None:
        """The axes of a frame, and its name where they do not point."""
        origin, *tips = self._seen(placed(pose, np.vstack([np.zeros(3), FRAME * np.eye(3)])))
        for (axis, hue), tip in zip(AXES.items(), tips, strict=True):
            canvas.arrow(origin, tip, hue, LINE * self._size)
            canvas.keep_clear(origin, tip)
            along = _towards(origin, tip)
            steps = [beyond * self._size * along for beyond in BEYOND]
            spots = [Spot(tip[0] + right, tip[1] + down, "m") for right, down in steps]
            canvas.write(Label(axis, self._size, hue, spots, is_needed=False))
        away = _towards(np.mean(tips, axis=0), origin)
        x, y = np.array(origin) + 2 * BESIDE * self._size * away
        side: Side = "r" if away[0] < 0 else "l"
        canvas.write(Label(name, self._size, INK, [Spot(x, y + step * self._size, side) for step in STEPS]))

    def _arrow(self, canvas: Canvas, hand: Pose) -> None:
        """From the palm along the approach axis."""
        palm, far = self._seen(placed(hand, self._approach))
        canvas.arrow(palm, far, APPROACH, BOLD * self._size)
        canvas.keep_clear(palm, far)
        beside = BESIDE * self._size
        spots = [Spot(far[0] + beside, far[1], "l"), Spot(far[0] - beside, far[1], "r")]
        canvas.write(Label("approach", self._size, APPROACH, spots))

    def _contact(self, canvas: Canvas, touch: Touch, hue: str) -> None:
        point = np.array(touch.point)
        start, end = self._seen(np.array([point, point + NORMAL * np.array(touch.normal)]))
        canvas.arrow(start, end, hue, THIN * self._size)
        canvas.disc(start, DOT * self._size, hue)

    def _seen(self, points: Floats) -> list[Point]:
        return [(column, row) for column, row in self._camera.pixels(points).tolist()]


def _towards(start: Point | Floats, end: Point | Floats) -> Floats:
    """The direction from one place to another, of length one; shorter where they are nearer than a pixel."""
    way: Floats = np.subtract(end, start)
    return way / max(1.0, float(np.hypot(*way)))


def placed(pose: Pose, points: Floats) -> Floats:
    """Points (n, 3) of a frame at a pose, in the frame of the pose."""
    moved: Floats = Rotation.from_quat(pose[3:]).apply(points) + pose[:3]
    return moved


def colour(shot: Shot, touch: Touch) -> str:
    """The colour of a contact: what it means."""
    if shot.phase == "placed" and touch.distance < 0:
        return OVERLAP
    return CONTACT if touch.is_finger else OTHER


def colours(shots: Iterable[Shot]) -> list[str]:
    """The colours of the contacts in some frames, in the order of the legend."""
    found = {colour(shot, touch) for shot in shots for touch in shot.touches}
    return [hue for hue in WORDS if hue in found]
