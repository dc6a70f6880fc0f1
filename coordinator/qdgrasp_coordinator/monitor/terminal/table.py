"""Tables that fit: columns without room are left out, the least important first, and no line is broken."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

from rich.cells import cell_len, set_cell_size
from rich.text import Text

from qdgrasp_coordinator.monitor.terminal.glyphs import Glyphs

GAP = 2  # characters between columns

Row = TypeVar("Row")
Lines = list[Text]


@dataclass(frozen=True)
class Column(Generic[Row]):
    """A column of a table.

    Attributes
    ----------
    title
        What stands above it.
    value
        What a row has there, others' words made printable.
    width
        How wide it is at least.
    rank
        How important it is; 0 is never left out.
    align
        To which side.
    grows
        Whether it takes the room that is left.
    """

    title: str
    value: Callable[[Row], str]
    width: int
    rank: int = 0
    align: Literal["left", "right"] = "right"
    grows: bool = False


def table(
    columns: Sequence[Column[Row]],
    rows: Sequence[Row],
    width: int,
    glyphs: Glyphs,
    style: Callable[[Row], str] = lambda _: "",
) -> Lines:
    """A line with the titles, and one for each row; no line is longer than `width`.

    A column without a title is there where it tells something.
    """
    told = [column for column in columns if column.title or any(column.value(row).strip() for row in rows)]
    chosen = fitting(told, width)
    widths = [column.width for column in chosen]
    growing = [number for number, column in enumerate(chosen) if column.grows]
    spare = width - _total(chosen)
    for number in growing[:1]:
        needed = max([cell_len(chosen[number].value(row)) for row in rows], default=0)
        widths[number] += max(0, min(spare, needed - widths[number]))
    sized = list(zip(chosen, widths, strict=True))
    head = Text(_line([(column.title, at, column.align) for column, at in sized], glyphs), style="dim")
    return [
        head,
        *(
            Text(
                _line([(column.value(row), at, column.align) for column, at in sized], glyphs),
                style=style(row),
            )
            for row in rows
        ),
    ]


def fitting(columns: Sequence[Column[Row]], width: int) -> list[Column[Row]]:
    """The columns that there is room for."""
    kept = list(columns)
    while _total(kept) > width and any(column.rank for column in kept):
        least = max(column.rank for column in kept)
        kept.remove([column for column in kept if column.rank == least][-1])
    return kept


def fit(words: str, width: int, glyphs: Glyphs, align: str = "left") -> str:
    """Words in exactly so many cells: filled up, or cut off where that shows."""
    if cell_len(words) > width:
        return set_cell_size(words, max(0, width - 1)) + glyphs.more if width > 0 else ""
    return " " * (width - cell_len(words)) + words if align == "right" else set_cell_size(words, width)


def _total(columns: Sequence[Column[Row]]) -> int:
    return sum(column.width for column in columns) + GAP * max(0, len(columns) - 1)


def _line(cells: Sequence[tuple[str, int, str]], glyphs: Glyphs) -> str:
    return (" " * GAP).join(fit(words, width, glyphs, align) for words, width, align in cells).rstrip()
