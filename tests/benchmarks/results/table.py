"""The table of results: one line a run, sorted, so that a run more is a line more."""

import csv
import io
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import msgspec
from tests.benchmarks.results.row import COLUMNS, NEEDED, Key, Row, written

from qdgrasp_coordinator.folders import disk, lock
from qdgrasp_protocol.errors import InputError

Table = Mapping[Key, Row]
HEAD = "restore the head of the table, or move the table away to begin another"
LINE = "restore the line, or delete it to have the run done again"


def read(file: Path) -> dict[Key, Row]:
    """The table in a file; empty where there is none.

    Raises
    ------
    InputError
        It is not such a table: the line and what is wrong with it are named.
    """
    if not file.exists():
        return {}
    with disk_text(file) as lines:
        reader = csv.DictReader(lines, strict=True)
        _check_columns(file, reader.fieldnames or ())
        table: dict[Key, Row] = {}
        for values in _lines(file, reader):
            row = _row(file, reader.line_num, values)
            if table.setdefault(row.key, row) is not row:
                raise _wrong(file, reader.line_num, f"{row.key.words} has a line already")
    return table


def text(table: Table) -> str:
    """A table as CSV, by key; the inverse of `read`."""
    lines = io.StringIO()
    writer = csv.DictWriter(lines, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for _, row in sorted(table.items()):
        writer.writerow({name: written(getattr(row, name)) for name in COLUMNS})
    return lines.getvalue()


def merged(table: Table, rows: Iterable[Row], current: Collection[str]) -> dict[Key, Row]:
    """A table with these rows, each in the place of the one of its key.

    A row of the current evaluation code is not replaced by one of another.

    Parameters
    ----------
    current
        Digests of evaluation code that count as today's.
    """
    whole = dict(table)
    for row in rows:
        old = whole.get(row.key)
        if old is None or row.code in current or old.code not in current:
            whole[row.key] = row
    return dict(sorted(whole.items()))


@contextmanager
def held(file: Path) -> Iterator[None]:
    """Be the only process that changes a table; see `lock.exclusive`."""
    with disk.writing(file.parent):
        file.parent.mkdir(parents=True, exist_ok=True)
    with lock.exclusive(file.parent, f".{file.name}.lock"):
        yield


def write(file: Path, table: Table) -> None:
    """Replace a table."""
    with disk.writing(file.parent):
        disk.write(file, text(table).encode())


@contextmanager
def disk_text(file: Path) -> Iterator[io.StringIO]:
    """A file's text as lines; what is no CSV at all is told in a sentence."""
    try:
        yield io.StringIO(disk.read(file).decode())
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"{file} is no table of results: {error}.") from None


def _check_columns(file: Path, columns: Collection[str]) -> None:
    """Check the columns; figures that an older table does not have yet may be missing."""
    if unknown := [name for name in columns if name not in COLUMNS]:
        raise _wrong(file, 1, f"unknown column '{unknown[0]}'", HEAD)
    if missing := [name for name in NEEDED if name not in columns]:
        raise _wrong(file, 1, f"column '{missing[0]}' is missing", HEAD)


def _lines(file: Path, reader: "csv.DictReader[str]") -> Iterator[dict[str, str]]:
    for values in reader:
        if None in values or None in values.values():
            raise _wrong(file, reader.line_num, f"expected {len(reader.fieldnames or ())} fields")
        yield values


def _row(file: Path, line: int, values: Mapping[str, str]) -> Row:
    said = {name: value for name, value in values.items() if value or name in NEEDED}
    try:
        return msgspec.convert(said, Row, strict=False)
    except msgspec.ValidationError as error:
        raise _wrong(file, line, str(error)) from None


def _wrong(file: Path, line: int, what: str, remedy: str = LINE) -> InputError:
    return InputError(f"{file}, line {line}: {what}; {remedy}.")
