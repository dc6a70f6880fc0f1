"""Draws grasps beside each other: a panel each, by one camera at one scale, words below."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from qdgrasp_assets.geometry.mesh import Mesh
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.grippers.hand_geometry import hand_geometry
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import Rows
from qdgrasp_tools.rendering.annotations import INK, fitting_size, label_font
from qdgrasp_tools.rendering.ray_renderer import (
    RAYS_PER_PIXEL,
    LayeredImage,
    ParallelCamera,
    RayMesh,
    fit_camera,
)
from qdgrasp_tools.rendering.views import (
    CLAY,
    ELEVATION,
    FINGER_HUES,
    DrawnLink,
    SurfaceDistanceGrid,
    best_azimuth,
    object_mesh,
    paint_link,
    paint_solid,
    rgb,
)

HAND_HUE = FINGER_HUES[0]
FAINT = "#5c646d"
RULE = "#d9dde1"
GAP = 6  # Pixels between panels, and between words and what is beside them
SCALE_BARS = (0.05, 0.1, 0.2, 0.5, 1.0)  # Lengths of the scale bar [m]: the first that is long enough
LEAST_BAR = 24.0  # Its least length [pixels]


@dataclass(frozen=True)
class PlacedHands:
    """Hands around an object: n poses with their joints, in the object's centre-of-mass frame."""

    scene: Scene
    rows: Rows
    """(n,): the evaluations that they are of."""
    poses: Floats
    """(n, 7): x y z [m] and quaternion xyzw of the hand's root link."""
    joints: Floats
    """(n, j): finger joints [rad or m], in the gripper's order."""

    def links(self) -> Iterator[list[DrawnLink]]:
        """Yield the links of each hand where they stand."""
        hand = hand_geometry(self.scene.gripper)
        for pose, joints in zip(self.poses, self.joints, strict=True):
            yield [
                DrawnLink(Mesh(vertices, shape.faces), rgb(HAND_HUE), hand.is_finger(shape))
                for shape, vertices in hand.place_meshes(pose, joints)
            ]


def common_camera(
    hands: PlacedHands, width: int, height: int, view: tuple[float, float] | None = None
) -> ParallelCamera:
    """Return a camera with the object and every hand in its image of `width` by `height` pixels.

    `view` is azimuth and elevation about the object's z [deg]; None: where most of the object is seen.
    """
    azimuth, elevation = np.radians(view) if view else (best_azimuth(hands.scene, hands.rows), ELEVATION)
    bodies = [object_mesh(hands.scene).vertices]
    bodies += [link.mesh.vertices for links in hands.links() for link in links]
    rows, columns = RAYS_PER_PIXEL * height, RAYS_PER_PIXEL * width
    return fit_camera(np.concatenate(bodies), float(azimuth), float(elevation), rows, columns)


def draw_hands(hands: PlacedHands, camera: ParallelCamera) -> Iterator[NDArray[np.uint8]]:
    """Yield a picture (rows, columns, 3) of the object with each hand alone, on white."""
    for image in paint_hands(hands, camera, SurfaceDistanceGrid(object_mesh(hands.scene))):
        yield np.rint(255 * image.composed()).astype(np.uint8)


def paint_hands(
    hands: PlacedHands, camera: ParallelCamera, distance: SurfaceDistanceGrid
) -> Iterator[LayeredImage]:
    """Yield the image of the object with each hand alone; the next one takes its place.

    `distance` are distances from the object's surface.
    """
    image = LayeredImage(camera)
    paint_solid(image, RayMesh(object_mesh(hands.scene)), rgb(CLAY))
    for links in hands.links():
        image.translucent.clear()
        for link in links:
            paint_link(image, link, distance)
        yield image


class PanelLabel(NamedTuple):
    """The words below a panel: a line in ink behind a dot, and a fainter one."""

    title: str
    line: str
    colour: str
    """Colour of the dot, which shows the outcome of the evaluation."""


@dataclass(frozen=True)
class SheetLayout:
    """Places of n panels in rows, each of `width` by `height` pixels above its words."""

    n: int
    width: int
    height: int
    has_labels: bool

    @property
    def letters(self) -> int:
        """Height of the letters of a panel [pixels]."""
        return max(10, min(self.width // 22, self.height // 18))

    @property
    def columns(self) -> int:
        """Number of panels beside each other: as many as rows, or one more."""
        return int(np.ceil(np.sqrt(self.n)))

    @property
    def head(self) -> int:
        """Height of the line above all panels [pixels]."""
        return round(2.6 * self.letters) if self.has_labels else 0

    @property
    def foot(self) -> int:
        """Height of the words below a panel [pixels]."""
        return round(3.2 * self.letters) if self.has_labels else 0

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the whole picture [pixels]."""
        rows = -(-self.n // self.columns)
        wide = self.columns * self.width + (self.columns - 1) * GAP
        return wide, self.head + rows * (self.height + self.foot) + (rows - 1) * GAP

    def corner(self, place: int) -> tuple[int, int]:
        """Return the column and row of a panel's upper left corner."""
        row, column = divmod(place, self.columns)
        return column * (self.width + GAP), self.head + row * (self.height + self.foot + GAP)


def contact_sheet(
    pictures: Iterator[NDArray[np.uint8]],
    labels: Sequence[PanelLabel],
    title: str,
    camera: ParallelCamera,
    *,
    has_labels: bool = True,
    is_stopped: Callable[[], bool] = lambda: False,
) -> Image.Image:
    """Lay pictures of one camera out in rows, each above its label, below title and scale bar.

    Words stand beside the pictures, never in them; without `has_labels` there are none. Where
    `is_stopped`, no further picture is drawn.
    """
    width, height = camera.columns // RAYS_PER_PIXEL, camera.rows // RAYS_PER_PIXEL
    layout = SheetLayout(len(labels), width, height, has_labels)
    sheet = Image.new("RGB", layout.size, "white")
    pen = ImageDraw.Draw(sheet)
    for place, (label, picture) in enumerate(zip(labels, pictures, strict=True)):
        if is_stopped():
            break
        left, top = layout.corner(place)
        sheet.paste(Image.fromarray(picture), (left, top))
        if has_labels:
            _write_label(pen, label, layout, left, top + height)
    if has_labels:
        _write_head(pen, title, layout, camera)
    return sheet


def _write_label(
    pen: ImageDraw.ImageDraw, label: PanelLabel, layout: SheetLayout, left: int, top: int
) -> None:
    size, room = layout.letters, layout.width - 2 * GAP
    pen.line([left, top, left + layout.width - 1, top], fill=RULE)
    dot, middle = round(0.36 * size), top + size
    pen.ellipse([left + GAP, middle - dot, left + GAP + 2 * dot, middle + dot], fill=label.colour)
    x = left + GAP + round(1.2 * size)
    letters = fitting_size(pen, label.title, size, room - 1.2 * size)
    pen.text((x, middle), label.title, INK, label_font(letters), anchor="lm")
    letters = fitting_size(pen, label.line, round(0.86 * size), room)
    pen.text((left + GAP, top + round(2.3 * size)), label.line, FAINT, label_font(letters), anchor="lm")


def _write_head(pen: ImageDraw.ImageDraw, title: str, layout: SheetLayout, camera: ParallelCamera) -> None:
    """Write the title, and draw the scale bar with its length at the right."""
    size, middle, right = layout.letters, layout.head // 2, layout.size[0] - GAP
    pixel = camera.step * RAYS_PER_PIXEL
    length = next((each for each in SCALE_BARS if each / pixel >= LEAST_BAR), SCALE_BARS[-1])
    bar, words = length / pixel, f"{100 * length:g} cm"
    pen.line([right - bar, middle, right, middle], fill=FAINT, width=2)
    pen.text((right - bar - GAP, middle), words, FAINT, label_font(size), anchor="rm")
    taken = bar + 4 * GAP + pen.textlength(words, label_font(size))
    letters = fitting_size(pen, title, round(1.2 * size), layout.size[0] - taken)
    pen.text((GAP, middle), title, INK, label_font(letters), anchor="lm")
