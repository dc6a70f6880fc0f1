"""`qdgrasp methods`: the search methods that there are."""

import json

import typer

from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.searches.search import METHODS

COLUMNS = ("name", "prior", "overlaps", "population", "generations_in_flight", "summary")
WIDTHS = (18, 10, 9, 11, 22, 0)


def methods(as_json: options.Json = False) -> None:
    """Name every search method with its prior and its defaults; the first is the default.

    Example: qdgrasp methods --json
    """
    table = [{column: getattr(entry, column) for column in COLUMNS} for entry in METHODS.values()]
    if as_json:
        typer.echo(json.dumps(table))
        return
    typer.echo(_line(COLUMNS))
    for entry in table:
        typer.echo(_line(tuple(entry.values())))


def _line(cells: tuple[object, ...]) -> str:
    return " ".join(f"{cell!s:<{width}}" for cell, width in zip(cells, WIDTHS, strict=True))
