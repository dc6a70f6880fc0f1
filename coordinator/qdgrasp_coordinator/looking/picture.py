"""Pictures of a replay: each frame with its marks above a caption, in a PNG or a GIF."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageColor, ImageDraw

from qdgrasp_assets.scene import SceneGripper
from qdgrasp_coordinator.looking.canvas import Canvas, font
from qdgrasp_coordinator.looking.caption import Caption
from qdgrasp_coordinator.looking.marks import APPROACH, HUES, INK, WORDS, Marks, colours
from qdgrasp_coordinator.looking.replaying import Replay, Size
from qdgrasp_protocol.replay import Shot

SMALLEST, LARGEST = Size(320, 240), {".png": Size(3840, 2160), ".gif": Size(1280, 960)}
"""Of a picture, and by the ending of a file's name: a film has some ninety."""
FAINT = "#5c646d"
MARGIN = 10
"""Pixels beside and between words."""
SMALL = 7
"""The smallest letters [pixels]."""
SAMPLES = 8
"""Frames that a film's colours are taken from."""
COLOURS = 128
"""In a film, besides those of marks and words."""
APART = 12
"""How far they are from these in red, green or blue, of 255, so that none of these is taken for them."""


class Layout:
    """How a picture of some size is divided: the scene above, words below.

    Parameters
    ----------
    size
        Of the whole picture.
    """

    def __init__(self, size: Size) -> None:
        self.size = size
        self.large = max(12, min(size.width // 40, size.height // 32))
        """Height of the title's letters; those of other words are smaller [pixels]."""
        self.small = round(0.8 * self.large)
        self._rows = [self.large, *[self.small] * 4]

    @property
    def scene(self) -> Size:
        """Of what is replayed."""
        return Size(self.size.width, self.size.height - self._caption)

    @property
    def heights(self) -> list[int]:
        """The middles of the rows of words."""
        top = self.scene.height + MARGIN
        return [top + sum(map(self._step, self._rows[:n])) + row // 2 for n, row in enumerate(self._rows)]

    @property
    def _caption(self) -> int:
        return 2 * MARGIN + sum(map(self._step, self._rows))

    @staticmethod
    def _step(size: int) -> int:
        return round(1.45 * size)


def pictures(
    replay: Replay, gripper: SceneGripper, caption: Caption, layout: Layout
) -> Iterator[Image.Image]:
    """Each frame of a replay, finished."""
    shots = replay.answer.shots
    marks = Marks(gripper, replay.answer.camera, layout.small)
    legend = [("approach axis", APPROACH), *((WORDS[hue], hue) for hue in colours(shots))]
    for frame, shot in zip(replay.frames, shots, strict=True):
        canvas = Canvas(frame)
        marks.draw(canvas, shot)
        yield _with_words(canvas.finished(), caption, shot, legend, layout)


def write(path: Path, images: Iterator[Image.Image], shots: Sequence[Shot]) -> None:
    """Write the pictures of a replay to a new file: a PNG of the last of them, or a GIF of all."""
    WRITERS[path.suffix.lower()](path, list(images), shots)


def _with_words(
    scene: Image.Image, caption: Caption, shot: Shot, legend: Sequence[tuple[str, str]], layout: Layout
) -> Image.Image:
    """A scene with its caption below."""
    whole = Image.new("RGB", layout.size, "white")
    whole.paste(scene)
    pen = ImageDraw.Draw(whole)
    pen.line([0, scene.height, scene.width, scene.height], fill="#d9dde1")
    lines = [caption.title, *caption.lines, caption.phase(shot)]
    sizes = [layout.large, *[layout.small] * len(lines)]
    for height, size, words in zip(layout.heights, sizes, lines, strict=False):
        _fit(pen, height, words, size, INK if words is caption.title else FAINT, layout.size.width)
    _legend(pen, layout, legend)
    return whole


def _fit(pen: ImageDraw.ImageDraw, height: float, words: str, size: int, colour: str, width: int) -> None:
    """Write a line, in letters as small as it needs."""
    while size > SMALL and pen.textlength(words, font(size)) > width - 2 * MARGIN:
        size -= 1
    pen.text((MARGIN, height), words, colour, font(size), anchor="lm")


def _legend(pen: ImageDraw.ImageDraw, layout: Layout, legend: Sequence[tuple[str, str]]) -> None:
    """What the colours mean, side by side in the last line, in letters as small as it needs."""
    height, size, x = layout.heights[-1], layout.small, float(MARGIN)
    words = " ".join(word for word, _ in legend)
    while size > SMALL and pen.textlength(words, font(size)) + 3 * size * len(legend) > layout.size.width:
        size -= 1
    for words, colour in legend:
        pen.ellipse([x, height - size // 3, x + 2 * (size // 3), height + size // 3], fill=colour)
        pen.text((x + size, height), words, FAINT, font(size), anchor="lm")
        x += pen.textlength(words, font(size)) + 2.5 * size


def _write_png(path: Path, images: Sequence[Image.Image], _: Sequence[Shot]) -> None:
    images[-1].save(path, format="PNG")


def _write_gif(path: Path, images: Sequence[Image.Image], shots: Sequence[Shot]) -> None:
    """All frames in one set of colours, so that nothing flickers."""
    palette = _palette(images[:: max(1, len(images) // SAMPLES)])
    first, *others = (image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images)
    durations = [round(1000 * shot.seconds) for shot in shots]
    first.save(path, format="GIF", save_all=True, append_images=others, duration=durations, loop=0)


def _palette(images: Sequence[Image.Image]) -> Image.Image:
    """The colours of marks and words as they are, and those that stand for all others in some images."""
    sheet = Image.new("RGB", (images[0].width, images[0].height * len(images)))
    for place, image in enumerate(images):
        sheet.paste(image, (0, place * image.height))
    found = sheet.quantize(COLOURS, method=Image.Quantize.MEDIANCUT).convert("RGB").getcolors(COLOURS) or []
    exact = np.array([ImageColor.getrgb(hue) for hue in ("white", FAINT, INK, *HUES)])
    others = np.array([colour for _, colour in found])
    is_apart = np.abs(others[:, None] - exact).max(axis=2).min(axis=1) > APART
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.concatenate([exact, others[is_apart]]).ravel().tolist())
    return palette


WRITERS: dict[str, Callable[[Path, Sequence[Image.Image], Sequence[Shot]], None]] = {
    ".png": _write_png,
    ".gif": _write_gif,
}
"""By the ending of a file's name."""
