"""A canvas: a picture that lines, marks and words are drawn over, without jagged edges."""

from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from qdgrasp_coordinator.looking.labels import Box, Label, arranged

FINE = 3
"""So many times finer lines are drawn than they are shown."""
FONT = "DejaVuSans.ttf"
STEP = 2.0
"""Pixels from one place of a line to the next that words keep clear of."""
HALO = "white"
"""Behind words, so that they are read over anything."""
Point = tuple[float, float]
"""Column and row."""


class Canvas:
    """A picture that is drawn over.

    Parameters
    ----------
    image
        (rows, columns, 3), uint8.
    """

    def __init__(self, image: NDArray[np.uint8]) -> None:
        self._image = Image.fromarray(np.ascontiguousarray(image)).convert("RGBA")
        columns, rows = self._image.size
        self._lines = Image.new("RGBA", (FINE * columns, FINE * rows))
        self._pen = ImageDraw.Draw(self._lines)
        self._labels: list[Label] = []
        self._clear: list[Box] = []
        self._dots: list[Box] = []

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        return self._image.size

    def line(self, start: Point, end: Point, colour: str, width: float) -> None:
        """Draw a line."""
        self._pen.line([*_fine(start), *_fine(end)], fill=colour, width=round(FINE * width))

    def arrow(self, start: Point, end: Point, colour: str, width: float) -> None:
        """Draw a line that ends in a tip."""
        way = np.subtract(end, start)
        length = float(np.hypot(*way))
        if length < 1.0:  # it points at whoever looks
            self.disc(start, width, colour)
            return
        along = way / length
        across = np.array([-along[1], along[0]])
        tip = min(4.0 * width, 0.6 * length)
        neck = np.array(end) - tip * along
        self.line(start, tuple(neck), colour, width)
        corners = [end, tuple(neck + 0.42 * tip * across), tuple(neck - 0.42 * tip * across)]
        self._pen.polygon([_fine(corner) for corner in corners], fill=colour)

    def disc(self, middle: Point, radius: float, colour: str) -> None:
        """Draw a disc with a white rim."""
        self._dots.append(Box(*np.subtract(middle, radius), *np.add(middle, radius)))
        for reach, fill in ((radius + 1.0, HALO), (radius, colour)):
            x, y = _fine(middle)
            self._pen.ellipse(
                [x - FINE * reach, y - FINE * reach, x + FINE * reach, y + FINE * reach], fill=fill
            )

    def keep_clear(self, start: Point, end: Point) -> None:
        """Have no words stand over a line where there is room beside it."""
        steps = 1 + round(np.hypot(*np.subtract(end, start)) / STEP)
        for x, y in np.linspace(start, end, steps).tolist():
            self._clear.append(Box(x - STEP / 2, y - STEP / 2, x + STEP / 2, y + STEP / 2))

    def write(self, label: Label) -> None:
        """Write words where there is room for them."""
        self._labels.append(label)

    def finished(self) -> Image.Image:
        """The picture with all that was drawn over it, words on top."""
        whole = Image.alpha_composite(self._image, self._lines.resize(self._image.size, Image.Resampling.BOX))
        pen = ImageDraw.Draw(whole)
        for label, spot in arranged(
            self._labels,
            self._clear,
            self._dots,
            self._image.width,
            lambda label: pen.textlength(label.words, font(label.size)),
        ):
            pen.text(
                spot[:2],
                label.words,
                label.colour,
                font(label.size),
                anchor=f"{spot.side}m",
                stroke_width=max(1, label.size // 7),
                stroke_fill=HALO,
            )
        return whole.convert("RGB")


def font(size: int) -> ImageFont.FreeTypeFont:
    """The font of all figures, that comes with matplotlib, so high [pixels]."""
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / FONT, size)


def _fine(point: Point) -> Point:
    x, y = point
    return FINE * x, FINE * y
