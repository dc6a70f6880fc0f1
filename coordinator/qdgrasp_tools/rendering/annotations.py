"""Draws frames, the approach axis, contacts and labels over a rendered picture.

Labels stand beside the parts that they name, none over another, and none over the hand or the object; lines
are supersampled.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Literal, NamedTuple, TypeAlias

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial.transform import Rotation

from qdgrasp_assets.scene import SceneGripper
from qdgrasp_protocol.replay_messages import ContactPoint, Pose, ReplayCamera, ReplayFrame

EDGE_MARGIN = 4  # Pixels between words and the edge of the picture
LINE_HEIGHT = 1.05  # Height of a line, in heights of its letters
Anchor: TypeAlias = Literal["l", "m", "r"]
"""Alignment: words begin at their spot, have their middle there, or end there."""
ANCHOR_SHARES: dict[Anchor, float] = {"l": 0.0, "m": 0.5, "r": 1.0}
"""Share of a line that lies left of its spot."""


class LabelSpot(NamedTuple):
    """A place for words, at half their height, in pixels."""

    x: float
    y: float
    anchor: Anchor


class PixelBox(NamedTuple):
    """A part of a picture that is taken, in pixels."""

    left: float
    top: float
    right: float
    bottom: float

    def overlaps(self, other: "PixelBox") -> bool:
        """Return whether two boxes overlap."""
        beside = self.right <= other.left or other.right <= self.left
        return not (beside or self.bottom <= other.top or other.bottom <= self.top)


@dataclass(frozen=True)
class Label:
    """Words, and where they may stand."""

    words: str
    size: int
    """Height of the letters [pixels]."""
    colour: str
    spots: Sequence[LabelSpot]
    """Places where it may stand, best first."""
    is_needed: bool = True
    """True: it may cover dots, and goes where there is room if no spot is free; False: it is left out."""
    named: tuple[float, float] | None = None
    """Column and row of what it names, to which a thin line leads from afar; None: its first spot."""


class CoveredArea:
    """The pixels (rows, columns) of a picture in which hand or object is seen."""

    def __init__(self, is_covered: NDArray[np.bool_]) -> None:
        self.height, self.width = is_covered.shape
        # counts of covered pixels above and left of each corner: a box takes four of them (Crow 1984)
        self._counts = np.zeros((self.height + 1, self.width + 1), np.int64)
        self._counts[1:, 1:] = is_covered.cumsum(axis=0).cumsum(axis=1)

    def overlaps(self, box: PixelBox) -> bool:
        """Return whether a covered pixel is in a box."""
        left, right = np.clip([np.floor(box.left), np.ceil(box.right)], 0, self.width).astype(int)
        top, bottom = np.clip([np.floor(box.top), np.ceil(box.bottom)], 0, self.height).astype(int)
        counts = self._counts
        return bool(counts[bottom, right] - counts[top, right] - counts[bottom, left] + counts[top, left])

    def spots_around(self, spot: LabelSpot, step: float) -> Iterator[LabelSpot]:
        """Yield places all over the picture, `step` pixels apart, the nearest ones first."""
        sides = (np.arange(step, side - step / 2, step) for side in (self.width, self.height))
        places = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
        order = np.argsort(np.hypot(*(places - [spot.x, spot.y]).T), kind="stable")
        yield from (LabelSpot(x, y, "m") for x, y in places[order].tolist())


def arrange_labels(
    labels: Iterable[Label],
    lines: Iterable[PixelBox],
    dots: Iterable[PixelBox],
    covered: CoveredArea,
    length: Callable[[Label], float],
) -> Iterator[tuple[Label, LabelSpot]]:
    """Yield labels with their spots, needed ones first, each at its first spot that is free.

    No label stands on what is `covered`, none on the boxes `lines`, and none that may be left out on the
    boxes `dots`: in a film dots come and go, and names stay. A needed label with no free spot stands at the
    nearest place with room, if need be over lines. No letter lies beyond the width of the picture; `length`
    returns that of a label.
    """
    taken, dots = list(lines), list(dots)
    for label in sorted(labels, key=lambda label: not label.is_needed):
        everywhere = covered.spots_around(label.spots[0], label.size) if label.is_needed else ()
        wide, others = length(label), taken if label.is_needed else taken + dots
        spots = (_shifted_inside(spot, wide, covered.width) for spot in chain(label.spots, everywhere))
        spot = _chosen_spot(label, spots, wide, covered, others)
        if spot is not None:
            taken.append(_label_box(label, spot, wide))
            yield label, spot


def _chosen_spot(
    label: Label, spots: Iterable[LabelSpot], length: float, covered: CoveredArea, taken: Sequence[PixelBox]
) -> LabelSpot | None:
    """Return the first free spot; without one, of a needed label, the first uncovered one."""
    over_lines = None
    for spot in spots:
        box = _label_box(label, spot, length)
        if not covered.overlaps(box):
            if not any(map(box.overlaps, taken)):
                return spot
            over_lines = over_lines or spot
    return over_lines if label.is_needed else None


def _shifted_inside(spot: LabelSpot, length: float, width: float) -> LabelSpot:
    """Return the spot, or the nearest one from which no letter is cut off."""
    before = ANCHOR_SHARES[spot.anchor] * length
    return spot._replace(x=min(max(spot.x, before + EDGE_MARGIN), width - (length - before) - EDGE_MARGIN))


def _label_box(label: Label, spot: LabelSpot, length: float) -> PixelBox:
    left, half = spot.x - ANCHOR_SHARES[spot.anchor] * length, LINE_HEIGHT * label.size / 2
    halo = _halo(label.size)
    return PixelBox(left - halo, spot.y - half - halo, left + length + halo, spot.y + half + halo)


def _halo(size: int) -> int:
    """Return the width of the rim around letters that belongs to them [pixels]."""
    return max(1, size // 7)


SUPERSAMPLING = 3  # Factor by which lines are drawn finer than they are shown
FONT_FILE = "DejaVuSans.ttf"
LEAST_LETTERS = 7  # The smallest letters [pixels]
LEADER_FROM, LEADER_WIDTH = 1.5, 1.0  # Distance of words with a leader [their heights]; its width [pixels]
LINE_BOX_STEP = 2.0  # Spacing of the boxes along a line that words keep clear of [pixels]
HALO_COLOUR = "white"  # Colour behind words, so that they can be read over anything
PixelPoint = tuple[float, float]  # Column and row


class Canvas:
    """A picture (rows, columns, 3), uint8, that is drawn over; words keep off what is `covered`."""

    def __init__(self, image: NDArray[np.uint8], covered: CoveredArea) -> None:
        self._covered = covered
        self._image = Image.fromarray(np.ascontiguousarray(image)).convert("RGBA")
        columns, rows = self._image.size
        self._lines = Image.new("RGBA", (SUPERSAMPLING * columns, SUPERSAMPLING * rows))
        self._pen = ImageDraw.Draw(self._lines)
        self._labels: list[Label] = []
        self._clear: list[PixelBox] = []
        self._dots: list[PixelBox] = []

    def draw_line(self, start: PixelPoint, end: PixelPoint, colour: str, width: float) -> None:
        """Draw a line."""
        self._pen.line(
            [*_supersampled(start), *_supersampled(end)], fill=colour, width=round(SUPERSAMPLING * width)
        )

    def draw_arrow(self, start: PixelPoint, end: PixelPoint, colour: str, width: float) -> None:
        """Draw a line that ends in a tip."""
        way = np.subtract(end, start)
        length = float(np.hypot(*way))
        if length < 1.0:  # it points at the viewer
            self.draw_disc(start, width, colour)
            return
        along = way / length
        across = np.array([-along[1], along[0]])
        tip = min(4.0 * width, 0.6 * length)
        neck = np.array(end) - tip * along
        self.draw_line(start, tuple(neck), colour, width)
        corners = [end, tuple(neck + 0.42 * tip * across), tuple(neck - 0.42 * tip * across)]
        self._pen.polygon([_supersampled(corner) for corner in corners], fill=colour)

    def draw_disc(self, middle: PixelPoint, radius: float, colour: str) -> None:
        """Draw a disc with a white rim."""
        self._dots.append(PixelBox(*np.subtract(middle, radius), *np.add(middle, radius)))
        x, y = _supersampled(middle)
        for reach, fill in ((radius + 1.0, HALO_COLOUR), (radius, colour)):
            side = SUPERSAMPLING * reach
            self._pen.ellipse([x - side, y - side, x + side, y + side], fill=fill)

    def reserve_line(self, start: PixelPoint, end: PixelPoint) -> None:
        """Keep words off a line where there is room beside it."""
        steps = 1 + round(np.hypot(*np.subtract(end, start)) / LINE_BOX_STEP)
        half = LINE_BOX_STEP / 2
        for x, y in np.linspace(start, end, steps).tolist():
            self._clear.append(PixelBox(x - half, y - half, x + half, y + half))

    def add_label(self, label: Label) -> None:
        """Write words where there is room for them."""
        self._labels.append(label)

    def composed(self, *, has_words: bool = True) -> Image.Image:
        """Return the picture with all that was drawn over it, words on top."""
        sketch = ImageDraw.Draw(self._image)

        def length(label: Label) -> float:
            return sketch.textlength(label.words, label_font(label.size))

        labels = self._labels if has_words else ()
        placed = list(arrange_labels(labels, self._clear, self._dots, self._covered, length))
        for label, spot in placed:
            self._draw_leader(label, spot, length(label))
        whole = Image.alpha_composite(self._image, self._lines.resize(self._image.size, Image.Resampling.BOX))
        pen = ImageDraw.Draw(whole)
        for label, spot in placed:
            pen.text(
                spot[:2], label.words, label.colour, label_font(label.size), anchor=f"{spot.anchor}m",
                stroke_width=_halo(label.size), stroke_fill=HALO_COLOUR,
            )  # fmt: skip
        return whole.convert("RGB")

    def _draw_leader(self, label: Label, spot: LabelSpot, length: float) -> None:
        """Draw a thin line from words that stand far from what they name to its place."""
        box, (x, y) = _label_box(label, spot, length), label.named or label.spots[0][:2]
        near = min(max(x, box.left), box.right), min(max(y, box.top), box.bottom)
        if np.hypot(x - near[0], y - near[1]) > LEADER_FROM * label.size:
            self.draw_line(near, (x, y), label.colour, LEADER_WIDTH)


def fitting_size(pen: ImageDraw.ImageDraw, words: str, size: int, width: float, extra: float = 0.0) -> int:
    """Return the letters up to `size` in which words and `extra` letters beside them fit."""
    while size > LEAST_LETTERS and pen.textlength(words, label_font(size)) + extra * size > width:
        size -= 1
    return size


def label_font(size: int) -> ImageFont.FreeTypeFont:
    """Return the font of all figures, which comes with matplotlib, at a height [pixels]."""
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / FONT_FILE, size)


def _supersampled(point: PixelPoint) -> PixelPoint:
    x, y = point
    return SUPERSAMPLING * x, SUPERSAMPLING * y


FRAME_LENGTH = 0.04  # Length of the axes of a frame [m]
APPROACH_LENGTH = 0.06  # Length at which the approach axis is drawn, from the palm [m]
NORMAL_LENGTH = 0.025  # Length at which a contact's normal is drawn [m]
AXIS_COLOURS = {"x": "#cc3311", "y": "#2e8b57", "z": "#2a73b9"}
APPROACH_COLOUR = "#aa3377"
INK = "#22262b"
FINGER_CONTACT_COLOUR, OTHER_CONTACT_COLOUR, OVERLAP_COLOUR = "#ee7733", "#c0a020", "#dd1144"
CONTACT_WORDS = {
    FINGER_CONTACT_COLOUR: "contact of a finger",
    OTHER_CONTACT_COLOUR: "contact of another link",
    OVERLAP_COLOUR: "overlap of the open hand",
}
"""Meanings of the colours of contacts."""
ANNOTATION_COLOURS = (APPROACH_COLOUR, *AXIS_COLOURS.values(), *CONTACT_WORDS)  # Colours of all marks
LABEL_OFFSET = 0.55  # From a point to the words beside it; this and what follows in heights of letters
TIP_OFFSETS = (0.8, 1.3)
"""From the tip of an axis to the middle of its letter, farther where something else stands."""
LABEL_SHIFTS = (0.0, 1.2, -1.2, 2.4, -2.4)
"""Offsets by which a name is moved down where something else stands."""
LINE, BOLD, THIN, DOT = 0.16, 0.2, 0.12, 0.24
"""Width of the axes of a frame, of the approach axis and of a normal; radius of a contact."""
Floats = NDArray[np.float64]


class SceneAnnotations:
    """Draws frames, approach axis and contacts of a replay; words are `size` pixels high."""

    def __init__(self, gripper: SceneGripper, camera: ReplayCamera, size: int) -> None:
        self._camera = camera
        self._base = gripper.base_link
        self._size = size
        axis = np.array(gripper.approach_axis)
        reaches = (gripper.palm_offset, gripper.palm_offset + APPROACH_LENGTH)
        self._approach = np.array([reach * axis for reach in reaches])

    def draw(self, canvas: Canvas, shot: ReplayFrame) -> None:
        """Draw all that belongs to a frame."""
        self._draw_frame(canvas, shot.object, "object, centre of mass")
        self._draw_frame(canvas, shot.hand, f"hand base {self._base}")
        palm, far = self._project(transform_points(shot.hand, self._approach))
        canvas.draw_arrow(palm, far, APPROACH_COLOUR, BOLD * self._size)
        canvas.reserve_line(palm, far)
        beside = LABEL_OFFSET * self._size
        spots = [LabelSpot(far[0] + beside, far[1], "l"), LabelSpot(far[0] - beside, far[1], "r")]
        canvas.add_label(Label("approach", self._size, APPROACH_COLOUR, spots, named=far))
        for touch in shot.touches:
            point, hue = np.array(touch.point), contact_colour(shot, touch)
            start, end = self._project(np.array([point, point + NORMAL_LENGTH * np.array(touch.normal)]))
            canvas.draw_arrow(start, end, hue, THIN * self._size)
            canvas.draw_disc(start, DOT * self._size, hue)

    def _draw_frame(self, canvas: Canvas, pose: Pose, name: str) -> None:
        """Draw the axes of a frame, and its name where they do not point."""
        origin, *tips = self._project(
            transform_points(pose, np.vstack([np.zeros(3), FRAME_LENGTH * np.eye(3)]))
        )
        for (axis, hue), tip in zip(AXIS_COLOURS.items(), tips, strict=True):
            canvas.draw_arrow(origin, tip, hue, LINE * self._size)
            canvas.reserve_line(origin, tip)
            along = _direction(origin, tip)
            steps = [beyond * self._size * along for beyond in TIP_OFFSETS]
            spots = [LabelSpot(tip[0] + right, tip[1] + down, "m") for right, down in steps]
            canvas.add_label(Label(axis, self._size, hue, spots, is_needed=False))
        away = _direction(np.mean(tips, axis=0), origin)
        x, y = np.array(origin) + 2 * LABEL_OFFSET * self._size * away
        side: Anchor = "r" if away[0] < 0 else "l"
        spots = [LabelSpot(x, y + step * self._size, side) for step in LABEL_SHIFTS]
        canvas.add_label(Label(name, self._size, INK, spots, named=origin))

    def _project(self, points: Floats) -> list[PixelPoint]:
        return [(column, row) for column, row in self._camera.pixels(points).tolist()]


def _direction(start: PixelPoint | Floats, end: PixelPoint | Floats) -> Floats:
    """Return the unit direction from one place to another; shorter where within one pixel."""
    way: Floats = np.subtract(end, start)
    return way / max(1.0, float(np.hypot(*way)))


def transform_points(pose: Pose, points: Floats) -> Floats:
    """Return points (n, 3) of a frame at a pose, in the frame of the pose."""
    return np.asarray(Rotation.from_quat(pose[3:]).apply(points) + pose[:3])


def contact_colour(shot: ReplayFrame, touch: ContactPoint) -> str:
    """Return the colour that stands for the kind of a contact."""
    if shot.phase == "placed" and touch.distance < 0:
        return OVERLAP_COLOUR
    return FINGER_CONTACT_COLOUR if touch.is_finger else OTHER_CONTACT_COLOUR


def contact_colours(shots: Iterable[ReplayFrame]) -> list[str]:
    """Return the colours of the contacts in some frames, in the order of the legend."""
    found = {contact_colour(shot, touch) for shot in shots for touch in shot.touches}
    return [hue for hue in CONTACT_WORDS if hue in found]
