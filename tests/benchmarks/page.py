"""The parts of `make bench` for a person: tables on a terminal, and as Markdown."""

from collections.abc import Sequence

from rich.table import Table
from tests.benchmarks.measure import Figure, number, spread, taken


def table(name: str, figures: Sequence[Figure]) -> Table:
    """A part for a terminal."""
    heads, *rows = lines(figures)
    shown = Table(*heads, title=name, title_justify="left")
    for row in rows:
        shown.add_row(*row)
    return shown


def markdown(name: str, figures: Sequence[Figure]) -> str:
    """A part as a section."""
    heads, *rows = lines(figures)
    cells = [heads, ["---"] * len(heads), *rows]
    return "\n".join([f"## {name.capitalize()}", "", *(f"| {' | '.join(row)} |" for row in cells)])


def lines(figures: Sequence[Figure]) -> list[list[str]]:
    """The head of a part's table, and its rows."""
    is_beside = any(figure.published for figure in figures)
    heads = [
        "what",
        "per second",
        "one takes",
        "public code's calls, times" if is_beside else "first line, times",
    ]
    return [[*heads, "remark"], *(_line(figure, figures[0], is_beside) for figure in figures)]


def _line(figure: Figure, first: Figure, is_beside: bool) -> list[str]:
    if figure.clock == "none":
        return [figure.name, "", number(figure.count), "", figure.remark]
    times = figure.published if is_beside else figure.ratios(first)
    rate = spread(figure.rates or [figure.per_second])
    return [figure.name, rate, taken(figure.microseconds), spread(times), figure.remark]
