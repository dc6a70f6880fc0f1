"""Reduction: a journal that keeps the successes of runs and their trials, and what all their rows came to.

Pruning reduces the journal of a finished run; merging reduces several into one. What needs every row - the
digest, resume, curves - cannot be had of a reduced journal, and is refused.
"""

import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path

import msgspec

from qdgrasp_coordinator.campaigns.summary import Summary, summary
from qdgrasp_coordinator.counts.stretch import Stretch
from qdgrasp_coordinator.folders.digest import digest
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.journal_format import REDUCED, Identity, lay_out
from qdgrasp_coordinator.folders.journal_writer import fitting, insert
from qdgrasp_coordinator.folders.sources import Source
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import COLUMNS, Rows, Shape
from qdgrasp_protocol.spec import to_toml

BLOCK = 4096
"""Rows in a block."""


def kept(rows: Rows) -> Rows:
    """The rows that a reduced journal keeps: nominal successes, and all trials, which are of successes."""
    chosen: Rows = rows[(rows["trial"] > 0) | (rows["outcome"] >= Outcome.DROPPED)]
    return chosen


def sources(folder: RunFolder) -> tuple[Source, ...]:
    """The runs that a folder holds rows of: those it was reduced from, or itself.

    Raises
    ------
    FolderError
        Its journal cannot be read, or grows meanwhile.
    """
    with folder.journal() as journal:
        if journal.sources:
            return journal.sources
        found = summary(folder)
        _check_same(folder.path.absolute().name, journal.count, found.rows)
        return (
            Source(
                run=folder.path.absolute().name,
                spec=to_toml(folder.spec),
                scene=journal.scene,
                digest=digest(journal),
                package=journal.package,
                platform=journal.platform,
                summary=msgspec.to_builtins(found),
                kept=found.successes + found.trials,
            ),
        )


def rows_of(folder: RunFolder, number: int) -> Iterator[Rows]:
    """The rows that are kept of the source of that number in a folder, some thousands at a time."""
    with folder.journal() as journal:
        if not journal.sources:
            yield from map(kept, journal.blocks())
            return
        first = sum(source.kept for source in journal.sources[:number])
        yield from journal.kept(first, first + journal.sources[number].kept)


def padded(rows: Rows, shape: Shape) -> Rows:
    """The same rows in a shape that is as wide or wider: behind genes and descriptors stand zeros."""
    if rows.dtype == shape.dtype:
        return rows
    wider = shape.empty(len(rows))
    for column in COLUMNS:
        values = rows[column.name]
        wider[column.name][tuple(slice(n) for n in values.shape)] = values
    return wider


def trimmed(rows: Rows, shape: Shape) -> Rows:
    """The rows as they were before they were `padded`, in their own shape."""
    if rows.dtype == shape.dtype:
        return rows
    narrower = shape.empty(len(rows))
    for column in COLUMNS:
        target = narrower[column.name]
        target[...] = rows[column.name][tuple(slice(n) for n in target.shape)]
    return narrower


def write(
    file: Path, identity: Identity, found: Summary, parts: Iterable[tuple[Source, Iterable[Rows]]]
) -> None:
    """Write a reduced journal into a new file.

    Parameters
    ----------
    found
        What is told of it.
    parts
        The sources in their order, each with its kept rows, of the identity's shape.

    Raises
    ------
    DiskFull, FolderError
        It cannot be written, or a source has other rows by now than it says.
    """
    file.unlink(missing_ok=True)
    with fitting(file.parent), closing(sqlite3.connect(file, isolation_level=None)) as database:
        lay_out(database, identity)
        database.execute("BEGIN")
        database.execute(f"PRAGMA user_version = {REDUCED}")
        database.execute("CREATE TABLE sources (number INTEGER PRIMARY KEY, source TEXT NOT NULL) STRICT")
        told = {"platform": found.platform, "summary": found}
        meta = [(name, msgspec.json.encode(value).decode()) for name, value in told.items()]
        database.executemany("INSERT INTO meta VALUES (?, ?)", meta)
        first = 0
        for number, (source, blocks) in enumerate(parts):
            text = msgspec.json.encode(source).decode()
            database.execute("INSERT INTO sources VALUES (?, ?)", (number, text))
            expected = first + source.kept
            for rows in blocks:
                first = _insert(database, first, rows)
            _check_same(source.run, expected, first)
        database.execute("COMMIT")


def _check_same(run: str, expected: int, rows: int) -> None:
    """Check that a run has as many rows as it had when it was looked at first."""
    if rows != expected:
        raise FolderError(f"'{run}' grew while it was read; wait until it is done, or stop it.")


def _insert(database: sqlite3.Connection, first: int, rows: Rows) -> int:
    """Add rows as blocks; gives the number of the next row."""
    for start in range(0, len(rows), BLOCK):
        part = Stretch(first, rows[start : start + BLOCK])
        insert(database, part, epoch=0)
        first = part.stop
    return first


def shape_of(folders: Iterable[RunFolder]) -> Shape:
    """The shape that the rows of all folders fit into."""
    shapes = []
    for folder in folders:
        with folder.journal() as journal:
            shapes.append(journal.shape)
    return Shape(
        max(shape.genes for shape in shapes),
        max(shape.joints for shape in shapes),
        max(shape.descriptors for shape in shapes),
    )
