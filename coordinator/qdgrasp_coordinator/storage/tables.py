"""CSV tables: rows of values by column name as text, and back.

A file is UTF-8 with one header line; an empty cell stands for no value. Where semicolons separate the cells
of the header, as spreadsheets write it in many countries, numbers may have decimal commas.
"""

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import TextIO

from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.text import counted

Value = str | int | float | None
DECIMAL_COMMA = re.compile(r"\A(\s*[-+]?\d*),(\d+(?:[eE][-+]?\d+)?\s*)\Z")
Row = Mapping[str, Value]
"""Values by column; None where there is none."""


def write_csv(file: TextIO, rows: Iterable[Row], columns: Sequence[str] = ()) -> None:
    """Write rows to an open text file, one after the other.

    `columns` are those written, in their order; none: all, in the order of their first occurrence.
    """
    every = rows if columns else list(rows)
    names = columns or list(dict.fromkeys(name for row in every for name in row))
    writer = csv.DictWriter(file, names, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(every)


def csv_text(rows: Iterable[Row], columns: Sequence[str] = ()) -> str:
    """Return rows as the text of a CSV file, as `write_csv`."""
    text = io.StringIO()
    write_csv(text, rows, columns)
    return text.getvalue()


def read_csv(path: Path, needed: Sequence[str] = ()) -> list[dict[str, str]]:
    """Read the rows of a CSV file, cells stripped of spaces; blank lines are skipped.

    Raises InputError for a file that cannot be read, that lacks a column that is `needed`, or with a line of
    more cells than its header.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            header = file.readline()
            file.seek(0)
            if ";" not in header or "," in header:
                return _parsed_rows(list(csv.reader(file)), needed)
            lines = csv.reader(file, delimiter=";")
            return _parsed_rows(
                [[DECIMAL_COMMA.sub(r"\1.\2", cell) for cell in line] for line in lines], needed
            )
    except (OSError, ValueError, csv.Error) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise InputError(f"'{path}' cannot be read as a table: {why}.") from None


def _parsed_rows(lines: Sequence[Sequence[str]], needed: Sequence[str]) -> list[dict[str, str]]:
    header, *rest = [[cell.strip() for cell in line] for line in lines] or [[]]
    if lacking := [name for name in needed if name not in header]:
        raise ValueError(f"it has no column '{lacking[0]}'")
    for number, line in enumerate(rest, 2):
        if len(line) > len(header):
            raise ValueError(f"row {number} has {counted(len(line), 'cell')}, its header {len(header)}")
    return [dict(zip_longest(header, line, fillvalue="")) for line in rest if any(line)]
