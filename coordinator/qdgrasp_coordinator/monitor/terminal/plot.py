"""Curves in characters: two by four dots to each in braille, one mark to each in ASCII."""

from bisect import bisect_right
from collections.abc import Sequence

from qdgrasp_coordinator.monitor.terminal.glyphs import Glyphs

BRAILLE = 0x2800
DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""The bits of the dots of a braille character: four lines of two."""


def plot(
    places: Sequence[float], values: Sequence[float], width: int, height: int, most: float, glyphs: Glyphs
) -> list[str]:
    """A curve in `height` lines of `width` characters.

    Parameters
    ----------
    places, values
        Its points, in order of their places.
    most
        The value at the upper edge; the lower one is 0.
    """
    across, up = (2, 4) if glyphs.has_braille else (1, 1)
    columns = sampled(places, values, width * across)
    levels = [min(height * up - 1, int(value / most * height * up)) if most > 0 else 0 for value in columns]
    dots: set[tuple[int, int]] = set()
    for column, level in enumerate(levels):
        before = levels[column - 1] if column else level
        low, high = sorted((level, before + (level > before) - (level < before)))
        dots |= {(column, height * up - 1 - at) for at in range(low, high + 1)}
    if not glyphs.has_braille:
        return ["".join("*" if (x, y) in dots else " " for x in range(width)) for y in range(height)]
    return ["".join(_braille(dots, 2 * x, 4 * y) for x in range(width)) for y in range(height)]


def sampled(places: Sequence[float], values: Sequence[float], columns: int) -> list[float]:
    """The values of a curve at so many even places, on straight lines between its points."""
    if not places:
        return []
    if len(places) == 1 or places[0] == places[-1]:
        return [values[-1]]
    first, wide = places[0], places[-1] - places[0]
    return [
        _between(places, values, first + wide * column / max(1, columns - 1)) for column in range(columns)
    ]


def _between(places: Sequence[float], values: Sequence[float], place: float) -> float:
    after = min(len(places) - 1, max(1, bisect_right(places, place)))
    wide = places[after] - places[after - 1]
    share = min(1.0, (place - places[after - 1]) / wide) if wide > 0 else 1.0
    return values[after - 1] + share * (values[after] - values[after - 1])


def _braille(dots: set[tuple[int, int]], left: int, top: int) -> str:
    bits = sum(DOTS[y][x] for y in range(4) for x in range(2) if (left + x, top + y) in dots)
    return chr(BRAILLE + bits) if bits else " "
