"""Journals that keep the successes of runs, their trials, and sums over all their rows.

Runs that several folders hold are found by their search and digest, and counted once.
"""

import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import astuple, dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.storage.journal_schema import (
    REDUCED,
    SOURCES,
    JournalIdentity,
    JournalSource,
    create_tables,
)
from qdgrasp_coordinator.storage.journal_slice import JournalSlice
from qdgrasp_coordinator.storage.journal_writer import explaining_write_errors, insert_rows
from qdgrasp_coordinator.storage.run_folder import RunFolder, journal_digest, search_digest
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.rows import COLUMNS, Outcome, Rows, RowShape
from qdgrasp_protocol.spec import to_toml
from qdgrasp_tools.campaign.summary import RunSummary, run_summary

BLOCK_ROWS = 4096  # Rows in a block


def is_kept(rows: Rows) -> NDArray[np.bool_]:
    """Return which rows (n,) a reduced journal keeps: nominal successes, and all trials."""
    return np.asarray((rows["trial"] > 0) | (rows["outcome"] >= Outcome.DROPPED))


def journal_sources(folder: RunFolder) -> tuple[JournalSource, ...]:
    """Return the runs that a folder holds rows of: those it was reduced from, or itself.

    Raises FolderError if its journal cannot be read, or grows meanwhile.
    """
    with folder.journal() as journal:
        if journal.sources:
            return journal.sources
        found = run_summary(folder)
        _check_same(folder.path.absolute().name, journal.count, found.rows)
        return (
            JournalSource(
                run=folder.path.absolute().name,
                spec=to_toml(folder.spec),
                scene=journal.scene,
                digest=journal_digest(journal),
                package=journal.package,
                platform=journal.platform,
                summary=msgspec.to_builtins(found),
                kept=found.successes + found.trials,
            ),
        )


def source_rows(folder: RunFolder, number: int) -> Iterator[Rows]:
    """Yield the kept rows of a folder's source of that number, some thousands at a time."""
    with folder.journal() as journal:
        if not journal.sources:
            yield from (rows[is_kept(rows)] for rows in journal.blocks())
            return
        first = sum(source.kept for source in journal.sources[:number])
        yield from journal.kept(first, first + journal.sources[number].kept)


def reshape_rows(rows: Rows, shape: RowShape) -> Rows:
    """Return the rows in a shape that is wider, zeros behind genes and descriptors, or narrower."""
    if rows.dtype == shape.dtype:
        return rows
    made = shape.empty(len(rows))
    for column in COLUMNS:
        source, target = rows[column.name], made[column.name]
        common = tuple(map(slice, np.minimum(source.shape, target.shape)))
        target[common] = source[common]
    return made


def write_reduced_journal(
    file: Path,
    identity: JournalIdentity,
    found: RunSummary,
    parts: Iterable[tuple[JournalSource, Iterable[Rows]]],
) -> None:
    """Write a reduced journal, with its summary `found`, into a new file.

    `parts` are the sources in their order, each with its kept rows, of the identity's shape. Raises DiskFull
    or FolderError if it cannot be written, or a source has other rows by now than it says.
    """
    file.unlink(missing_ok=True)
    with (
        explaining_write_errors(file.parent),
        closing(sqlite3.connect(file, isolation_level=None)) as database,
    ):
        create_tables(database, identity)
        database.execute("BEGIN")
        database.execute(f"PRAGMA user_version = {REDUCED}")
        database.execute(SOURCES)
        values = {"platform": found.platform, "summary": found}
        meta = [(name, msgspec.json.encode(value).decode()) for name, value in values.items()]
        database.executemany("INSERT INTO meta VALUES (?, ?)", meta)
        first = 0
        for number, (source, blocks) in enumerate(parts):
            text = msgspec.json.encode(source).decode()
            database.execute("INSERT INTO sources VALUES (?, ?)", (number, text))
            expected = first + source.kept
            for rows in blocks:
                for start in range(0, len(rows), BLOCK_ROWS):
                    part = JournalSlice(first, rows[start : start + BLOCK_ROWS])
                    insert_rows(database, part, epoch=0)
                    first = part.stop
            _check_same(source.run, expected, first)
        database.execute("COMMIT")


def _check_same(run: str, expected: int, rows: int) -> None:
    if rows != expected:
        raise FolderError(f"'{run}' grew while it was read; wait until it is done, or stop it.")


def common_shape(folders: Iterable[RunFolder]) -> RowShape:
    """Return the shape that the rows of all folders fit into."""
    shapes = []
    for folder in folders:
        with folder.journal() as journal:
            shapes.append(journal.shape)
    widths = zip(*map(astuple, shapes), strict=True)
    return RowShape(*map(max, widths))


@dataclass(frozen=True)
class MergePart:
    """A run that is merged: the folder of its rows, and its number among the sources there."""

    folder: RunFolder
    number: int
    source: JournalSource

    @property
    def identity(self) -> tuple[str, int, str, str]:
        """Sort key among others; parts with equal keys are one run."""
        asked = self.source.asked
        return asked.method, asked.seed, self.source.digest, self.source.scene

    @property
    def size_key(self) -> tuple[int, int, str]:
        """Sort key by how much of its search it has; no two are equal."""
        return self.source.kept, self.source.summary["rows"], self.source.digest

    @property
    def location(self) -> str:
        """Location of its rows, for a person."""
        path = self.folder.path
        return str(path) if self.source.run == path.absolute().name else f"'{self.source.run}' in {path}"

    def rows(self, shape: RowShape) -> Iterator[Rows]:
        """Return its kept rows, in a shape that is as wide or wider."""
        return (reshape_rows(rows, shape) for rows in source_rows(self.folder, self.number))

    def row_bytes(self) -> set[bytes]:
        """Return its kept rows, each as bytes; no two have the same key."""
        return {row.tobytes() for rows in source_rows(self.folder, self.number) for row in rows}


def merge_parts(folders: Sequence[RunFolder]) -> tuple[list[MergePart], tuple[str, ...]]:
    """Return the runs in folders, each search once, and a sentence for each left out; sorted.

    A run that is named twice, or is in two merged folders, is one run.
    """
    parts = [
        MergePart(folder, n, source) for folder in folders for n, source in enumerate(journal_sources(folder))
    ]
    ordered = sorted(parts, key=lambda part: (part.identity, part.source.run), reverse=True)
    distinct = {part.identity: part for part in ordered}
    searches: dict[str, list[MergePart]] = {}
    for part in distinct.values():
        search = search_digest(part.source.asked, part.source.scene)  # whatever its budget and goals
        searches.setdefault(search, []).append(part)
    repeats = {
        part.identity: f"{part.location} records a part of the search that {whole.location} records: "
        "it counts once."
        for records in searches.values()
        if len(records) > 1
        for part, whole in _repeats(records)
    }
    kept = [distinct[identity] for identity in sorted(distinct) if identity not in repeats]
    return kept, tuple(repeats[identity] for identity in sorted(repeats))


def _repeats(records: list[MergePart]) -> Iterator[tuple[MergePart, MergePart]]:
    """Yield the records of one search whose rows a larger one has too, each with that one."""
    wholes: list[tuple[MergePart, set[bytes]]] = []
    for part in sorted(records, key=lambda part: part.size_key, reverse=True):
        content = part.row_bytes()
        whole = next((one for one, known in wholes if content <= known), None)
        if whole is None:
            wholes.append((part, content))
        else:
            yield part, whole
