"""A canvas: a picture that lines, marks and words are drawn over, without jagged edges."""

from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

FINE = 3
"""So many times finer lines are drawn than they are shown."""
FONT = "DejaVuSans.ttf"
RIM = 4
"""Pixels between words and the edge of the picture."""
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
        self._words: list[tuple[Point, str, int, str, str]] = []

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
        for reach, fill in ((radius + 1.0, HALO), (radius, colour)):
            x, y = _fine(middle)
            self._pen.ellipse(
                [x - FINE * reach, y - FINE * reach, x + FINE * reach, y + FINE * reach], fill=fill
            )

    def write(self, place: Point, words: str, size: int, colour: str, *, leftward: bool = False) -> None:
        """Write words from a place to the right, or to the left, halfway up."""
        self._words.append((place, words, size, colour, "rm" if leftward else "lm"))

    def finished(self) -> Image.Image:
        """The picture with all that was drawn over it, words on top."""
        whole = Image.alpha_composite(self._image, self._lines.resize(self._image.size, Image.Resampling.BOX))
        pen = ImageDraw.Draw(whole)
        for place, words, size, colour, anchor in self._words:
            pen.text(
                self._within(place, pen.textlength(words, font(size)), anchor),
                words,
                colour,
                font(size),
                anchor=anchor,
                stroke_width=max(1, size // 7),
                stroke_fill=HALO,
            )
        return whole.convert("RGB")

    def _within(self, place: Point, length: float, anchor: str) -> Point:
        """Where words of some length begin or end, so that no letter is cut off."""
        before, behind = (length, 0.0) if anchor == "rm" else (0.0, length)
        return min(max(place[0], before + RIM), self._image.width - behind - RIM), place[1]


def font(size: int) -> ImageFont.FreeTypeFont:
    """The font of all figures, that comes with matplotlib, so high [pixels]."""
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / FONT, size)


def _fine(point: Point) -> Point:
    x, y = point
    return FINE * x, FINE * y
