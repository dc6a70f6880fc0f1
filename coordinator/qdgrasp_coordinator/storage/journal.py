"""The journal of a run: every evaluation in order, in `run.sqlite` (docs/run-folder.md).

Rows are kept as deflated blocks of structured arrays (`rows.RowShape.dtype`), one transaction per group of
rows; beside them stand the successes with what queries need, reasons of errors, the spec and the platform.
One process writes; any number may read while it does, each sees the journal as it was when it was opened.
"""

import sqlite3
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Self

import msgspec
import numpy as np

from qdgrasp_coordinator.metrics.run_stats import successes
from qdgrasp_coordinator.storage.atomic_files import damaged_file
from qdgrasp_coordinator.storage.journal_schema import (
    APPLICATION,
    FORMAT,
    JournalIdentity,
    create_tables,
    explaining_read_errors,
)
from qdgrasp_coordinator.storage.journal_slice import JournalSlice, join_slices
from qdgrasp_coordinator.storage.outputs import JOURNAL
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.messages import Failure, Width
from qdgrasp_protocol.rows import Rows, RowShape
from qdgrasp_protocol.spec import RunSpec, from_toml
from qdgrasp_protocol.text import printable


class JournalMeta(msgspec.Struct):
    """The entries of the table `meta` that every journal has."""

    run: str
    scene: str
    spec: str
    shape: str
    package: str
    created: float


class MetaShape(msgspec.Struct, forbid_unknown_fields=True):
    """A `RowShape` in JSON."""

    genes: Width
    joints: Width
    descriptors: Width = 3
    contact_slots: Width = 0


class Journal:
    """A journal to read; opened by `Journal.open`, closed by its with-block.

    Any method raises `FolderError` where the file is damaged.
    """

    def __init__(self, database: sqlite3.Connection, file: Path) -> None:
        self._database = database
        self._file = file
        self._check_format()
        try:
            meta = msgspec.convert(self._meta(), JournalMeta, strict=False)
            shape = msgspec.json.decode(meta.shape, type=MetaShape)
        except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
            raise damaged_file(file, printable(f"what it says of itself cannot be read ({error})")) from None
        self.run = meta.run
        self.scene = meta.scene
        """sha256 of the scene bundle."""
        self.shape = RowShape(**msgspec.structs.asdict(shape))
        self.package = meta.package
        """The version of this package that began it."""
        self.created = meta.created
        """When it was begun [s since 1970]."""
        self._check_end()

    @classmethod
    def open(cls, folder: Path) -> "Journal":
        """Open the journal in a run's folder as it is now.

        Raises `FolderError` where there is no journal, or a damaged one, or one of a newer version.
        """
        file = folder / JOURNAL
        if not file.is_file():
            raise FolderError(f"{folder} holds no journal ({JOURNAL}).")
        with explaining_read_errors(file):
            database = _connect(file)
            try:
                return cls(database, file)
            except BaseException:
                database.close()
                raise

    @classmethod
    def empty(cls, identity: JournalIdentity) -> "Journal":
        """Return the journal of a run that has not recorded anything yet, in memory."""
        database = sqlite3.connect(":memory:", isolation_level=None)
        create_tables(database, identity)
        return cls(database, Path(JOURNAL))

    @property
    def spec(self) -> RunSpec:
        """The full spec, with the latest budget."""
        return from_toml(self.spec_text, str(self._file))

    @property
    def spec_text(self) -> str:
        """The full spec as TOML, with the latest budget."""
        return self._meta()["spec"]

    @property
    def platform(self) -> dict[str, str]:
        """The platform that the rows were made on; empty while the journal has no rows."""
        if not self.count:
            return {}
        try:
            return msgspec.json.decode(self._meta().get("platform", "{}"), type=dict[str, str])
        except (msgspec.MsgspecError, RecursionError) as error:
            raise damaged_file(self._file, printable(f"its platform cannot be read ({error})")) from None

    @property
    def count(self) -> int:
        """Number of rows."""
        found = self._all("SELECT first + n FROM blocks ORDER BY first DESC LIMIT 1")
        return int(found[0][0]) if found else 0

    @property
    def mark(self) -> str:
        """Fingerprint of the rows, without reading them: their number and their checksums."""
        blocks, rows, crc = self._all("SELECT count(*), total(n), total(crc) FROM blocks")[0]
        return f"{blocks} blocks {rows:.0f} rows {crc:.0f}"

    @property
    def cpu_seconds(self) -> float:
        """CPU time of all rows on their workers [s]."""
        return float(self._all("SELECT total(cpu_seconds) FROM blocks")[0][0])

    @property
    def wall_seconds(self) -> float:
        """Sum over coordinators of the time from opening the run to its last commit [s]."""
        return float(self._all("SELECT total(last - opened) FROM turns")[0][0])

    def rows(self, first: int, limit: int) -> Rows:
        """At most `limit` rows from number `first` on, all columns."""
        return self.slice(first, limit).rows

    def slice(self, first: int, limit: int) -> JournalSlice:
        """Return at most `limit` rows from number `first` on, with their cost and failures."""
        stop = min(first + limit, self.count)
        if first >= stop:
            return JournalSlice(first, self.shape.empty(0))
        return join_slices([block.part(first, stop) for block in self._slices(first, stop)])

    def blocks(self, first: int = 0, stop: int | None = None) -> Iterator[Rows]:
        """The rows from number `first` up to `stop` in order, some thousands at a time."""
        end = self.count if stop is None else stop
        for block in self._slices(first, end):
            yield block.part(first, end).rows

    def slices(self) -> Iterator[JournalSlice]:
        """Yield all rows in order, some thousands at a time, with their cost and failures."""
        return self._slices(0, self.count)

    def successes(self) -> Rows:
        """Return every nominal success, in order, all columns; fitness 0 included (the archive A_o)."""
        found = [successes(rows) for rows in self.blocks()]
        return np.concatenate([self.shape.empty(0), *found])

    def errors(self) -> dict[int, str]:
        """Return the reasons of rows with `Outcome.ERROR`, by row number."""
        return {int(row): str(reason) for row, reason in self._all("SELECT row, reason FROM errors")}

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _slices(self, first: int, stop: int) -> Iterator[JournalSlice]:
        """The blocks that hold rows from `first` up to `stop`, checked to follow each other."""
        stop = min(stop, self.count)
        query = """SELECT first, n, cpu_seconds, crc, rows FROM blocks WHERE first < ?
            AND first >= (SELECT coalesce(max(first), 0) FROM blocks WHERE first <= ?) ORDER BY first"""
        reasons = "SELECT row, reason FROM errors WHERE row >= ? AND row < ? ORDER BY row"
        failures = self._all(reasons, first, stop)
        expected: int | None = None
        with explaining_read_errors(self._file), self._reading(query, stop, first) as found:
            for number, n, cpu_seconds, crc, blob in found:
                follows = 0 <= number <= first if expected is None else number == expected
                rows = self._block(blob, n) if follows and zlib.crc32(blob) == crc else None
                if rows is None:
                    raise self._altered_rows(number, n)
                here = (Failure(row=row - number, reason=reason) for row, reason in failures if row >= number)
                yield JournalSlice(number, rows, cpu_seconds, tuple(f for f in here if f.row < n))
                expected = number + n
        if (first if expected is None else expected) < stop:
            raise damaged_file(self._file, f"rows {expected or first} to {stop - 1} are missing")

    def _check_end(self) -> None:
        """Check that the last block has as many rows as it says: their number follows from it."""
        for first, n, blob in self._all("SELECT first, n, rows FROM blocks ORDER BY first DESC LIMIT 1"):
            with explaining_read_errors(self._file):
                rows = self._block(blob, n)
            if rows is None or first < 0:
                raise self._altered_rows(first, n)

    def _altered_rows(self, first: int, n: int) -> FolderError:
        return damaged_file(self._file, f"rows {first} to {first + n - 1} are not what was recorded")

    def _block(self, blob: bytes, n: int) -> Rows | None:
        """The n rows in a block's blob; None: it holds other bytes than n rows have."""
        size = self.shape.dtype.itemsize
        try:
            columns = zlib.decompress(blob)
        except zlib.error:
            return None
        if len(columns) != n * size:
            return None
        rows = np.frombuffer(columns, dtype=np.uint8).reshape(size, -1).T.tobytes()
        return np.frombuffer(rows, dtype=self.shape.dtype)

    @contextmanager
    def _reading(self, query: str, *values: object) -> Iterator[sqlite3.Cursor]:
        """Execute a query, and close its cursor at the end, also if the journal was closed before."""
        found = self._database.execute(query, values)
        try:
            yield found
        finally:
            with suppress(sqlite3.ProgrammingError):
                found.close()

    def _meta(self) -> dict[str, str]:
        return {str(name): str(value) for name, value in self._all("SELECT name, value FROM meta")}

    def _check_format(self) -> None:
        (application,), (number,) = (
            self._all(f"PRAGMA {name}")[0] for name in ("application_id", "user_version")
        )
        if application != APPLICATION:
            raise FolderError(f"{self._file} is not a journal of qdgrasp.")
        if number != FORMAT:
            raise FolderError(
                f"{self._file} is of format {number}, and this version of qdgrasp reads format {FORMAT}; use "
                "the version that wrote it."
            )

    def _all(self, query: str, *values: object) -> list[tuple[Any, ...]]:
        with explaining_read_errors(self._file):
            return self._database.execute(query, values).fetchall()


def _connect(file: Path) -> sqlite3.Connection:
    """A connection to read a journal as it is now."""
    wal = file.with_name(f"{file.name}-wal")
    for mode in ("mode=ro", "mode=ro&immutable=1"):  # the second on a read-only disk
        if "immutable" in mode and wal.is_file() and wal.stat().st_size:
            raise FolderError(
                f"{file} has rows in {wal.name}: copy the folder to where it can be written in."
            )
        database = sqlite3.connect(f"{file.absolute().as_uri()}?{mode}", uri=True, isolation_level=None)
        try:
            database.execute("BEGIN")
            database.execute("PRAGMA user_version").fetchone()
        except sqlite3.DatabaseError as error:
            database.close()
            if error.sqlite_errorcode != sqlite3.SQLITE_CANTOPEN:
                raise
            reason = error
        else:
            return database
    raise reason
