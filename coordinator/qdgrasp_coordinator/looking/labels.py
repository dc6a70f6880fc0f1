"""Labels: words beside what they name, none over another."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

RIM = 4
"""Pixels between words and the edge of the picture."""
AIR = 1.0
"""Pixels around words that belong to them."""
HIGH = 1.05
"""How high a line is, in heights of its letters."""
Side: TypeAlias = Literal["l", "m", "r"]
"""Whether words begin where they stand, have their middle there, or end there."""
SHARES: dict[Side, float] = {"l": 0.0, "m": 0.5, "r": 1.0}
"""How much of a line lies left of where it stands."""


class Spot(NamedTuple):
    """Where words may stand, halfway up, in pixels."""

    x: float
    y: float
    side: Side


class Box(NamedTuple):
    """A part of a picture that is taken, in pixels."""

    left: float
    top: float
    right: float
    bottom: float

    def meets(self, other: "Box") -> bool:
        """Whether two of them have a part in common."""
        beside = self.right <= other.left or other.right <= self.left
        return not (beside or self.bottom <= other.top or other.bottom <= self.top)


@dataclass(frozen=True)
class Label:
    """Words, and where they may stand."""

    words: str
    size: int
    """Height of the letters [pixels]."""
    colour: str
    spots: Sequence[Spot]
    """The best one first."""
    is_needed: bool = True
    """Whether they may stand over dots, and at their first spot where none is free, or are left out there."""


def arranged(
    labels: Iterable[Label],
    lines: Iterable[Box],
    dots: Iterable[Box],
    width: float,
    length: Callable[[Label], float],
) -> Iterator[tuple[Label, Spot]]:
    """Labels with their spots, those that are needed first; each at its first spot that is free.

    Parameters
    ----------
    lines
        Which they keep clear of.
    dots
        Which those keep clear of that may be left out: in a film dots come and go, and names stay.
    width
        Of the picture, beyond which no letter lies.
    length
        How long a label is.
    """
    taken, dots = list(lines), list(dots)
    for label in sorted(labels, key=lambda label: not label.is_needed):
        others = taken if label.is_needed else taken + dots
        spots = [_within(spot, length(label), width) for spot in label.spots]
        free = [spot for spot in spots if not any(map(_box(label, spot, length(label)).meets, others))]
        for spot in free[:1] or spots[: label.is_needed]:
            taken.append(_box(label, spot, length(label)))
            yield label, spot


def _within(spot: Spot, length: float, width: float) -> Spot:
    """The spot, or the nearest one from which no letter is cut off."""
    before = SHARES[spot.side] * length
    return spot._replace(x=min(max(spot.x, before + RIM), width - (length - before) - RIM))


def _box(label: Label, spot: Spot, length: float) -> Box:
    left, half = spot.x - SHARES[spot.side] * length, HIGH * label.size / 2
    return Box(left - AIR, spot.y - half - AIR, left + length + AIR, spot.y + half + AIR)
