"""Writing of journals: one transaction per group of rows, on the disk when `append` returns.

A few journals are open for writing at a time: each holds three files open.
"""

import json
import os
import sqlite3
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import groupby
from pathlib import Path

import numpy as np

from qdgrasp_coordinator.storage import outputs
from qdgrasp_coordinator.storage.journal import (
    NO_PLATFORM,
    Journal,
    JournalIdentity,
    JournalSlice,
    create_tables,
    explaining_errors,
)
from qdgrasp_coordinator.storage.outputs import JOURNAL
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.spec import RunSpec, to_toml

TURN = "INSERT OR IGNORE INTO turns VALUES (?, ?, ?)"
META = "INSERT OR REPLACE INTO meta VALUES (?, ?)"


class JournalWriter(Journal):
    """A journal to append to; the process that opens it holds its job's lock (`JobFolder.lock`)."""

    def __init__(self, database: sqlite3.Connection, file: Path) -> None:
        super().__init__(database, file)
        self._opened = file.stat()

    @classmethod
    def create(
        cls,
        folder: Path,
        identity: JournalIdentity,
        epoch: int = 0,
        now: float = 0.0,
    ) -> "JournalWriter":
        """Begin the journal of a run; the file appears whole or not at all.

        With it is written that the coordinator of an epoch (0: none yet) opened the run at `now` [s since
        1970]. It is written without a wait for the disk, then flushed as a whole: before any row is in it.
        """
        part = folder / f"{JOURNAL}.part"
        for left in folder.glob(f"{part.name}*"):
            left.unlink(missing_ok=True)
        with explaining_errors(folder / JOURNAL):
            database = sqlite3.connect(part, isolation_level=None)
            try:
                database.execute("PRAGMA synchronous = OFF")
                create_tables(database, identity)
                if epoch:
                    database.execute(TURN, (epoch, now, now))
                database.execute("PRAGMA journal_mode = WAL")
            finally:
                database.close()
        with outputs.writing(folder):
            outputs.sync(part)
            part.replace(folder / JOURNAL)
        return cls._connect(folder)

    @classmethod
    def open(cls, folder: Path) -> "JournalWriter":
        """Open the journal in a run's folder to add to it; raises as `Journal.open` does."""
        Journal.open(folder).close()
        return cls._connect(folder)

    @classmethod
    def _connect(cls, folder: Path) -> "JournalWriter":
        file = folder / JOURNAL
        with explaining_errors(file):
            database = sqlite3.connect(file, isolation_level=None)
            try:
                database.execute("PRAGMA journal_mode = WAL")
                database.execute("PRAGMA synchronous = FULL")
                return cls(database, file)
            except BaseException:
                database.close()
                raise

    def begin_epoch(self, epoch: int, now: float) -> None:
        """Record that the coordinator of an epoch opened the run at `now` [s since 1970]."""
        with self._transaction():
            self._database.execute(TURN, (epoch, now, now))

    def append(
        self, part: JournalSlice, epoch: int, now: float, platform: Mapping[str, str] = NO_PLATFORM
    ) -> None:
        """Add the next rows, and the platform that they were made on: all of them, durably, or none.

        Raises `DiskFull`, or `FolderError` where the file cannot be written or was deleted, or `ValueError`
        for other rows than the next ones.
        """
        if part.first > (count := self.count):  # it was restored while it was closed
            raise self._replaced()
        if part.first < count:
            raise ValueError(f"row {count} is next, got {part.first}")
        with self._transaction():
            insert_rows(self._database, part, epoch)
            if platform:
                self._database.execute(META, ("platform", json.dumps(dict(platform), sort_keys=True)))
            self._database.execute("UPDATE turns SET last = max(last, ?) WHERE epoch = ?", (now, epoch))

    def withdraw(self, first: int) -> int:
        """Take back the block of row `first` and all behind it; returns how many rows are left."""
        with self._transaction():
            self._database.execute("INSERT INTO withdrawn SELECT * FROM blocks WHERE first + n > ?", (first,))
            self._database.execute("DELETE FROM blocks WHERE first + n > ?", (first,))
            left = self.count
            self._database.execute("DELETE FROM errors WHERE row >= ?", (left,))
            self._database.execute("DELETE FROM makers WHERE first >= ?", (left,))
        return left

    def set_spec(self, spec: RunSpec) -> None:
        """Replace the spec by the same one with another budget."""
        with self._transaction():
            self._database.execute(META, ("spec", to_toml(spec)))

    def _check_file(self) -> None:
        """Raise `FolderError` if the file at the path is not the one that was opened."""
        with suppress(OSError):
            if os.path.samestat(self._file.stat(), self._opened):
                return
        raise self._replaced()

    def _replaced(self) -> FolderError:
        return FolderError(
            f"{self._file} was deleted or replaced while its run was being recorded, and what is recorded "
            "now would be lost; restore the folder from a copy and go on with `qdgrasp resume`, or begin the "
            "run anew."
        )

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with explaining_errors(self._file):
            self._database.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._database.execute("COMMIT")
            except BaseException:
                if self._database.in_transaction:
                    self._database.execute("ROLLBACK")
                raise
        self._check_file()


def insert_rows(database: sqlite3.Connection, part: JournalSlice, epoch: int) -> None:
    """Add rows to the tables of a journal, within a transaction."""
    # All first bytes of rows, then all second ones: neighbours are alike, and deflate to a third.
    by_row = np.frombuffer(part.rows.tobytes(), dtype=np.uint8).reshape(len(part), part.rows.dtype.itemsize)
    blob = zlib.compress(by_row.T.tobytes())
    block = (part.first, len(part), epoch, part.cpu_seconds, zlib.crc32(blob), blob)
    errors = [(part.first + failure.row, failure.reason) for failure in part.failures]
    database.execute("INSERT INTO blocks VALUES (?, ?, ?, ?, ?, ?)", block)
    database.executemany("INSERT INTO errors VALUES (?, ?)", errors)
    first = part.first
    for maker, same in groupby(part.makers):
        n, (worker, _, host) = sum(1 for _ in same), maker.partition(" ")
        database.execute("INSERT INTO makers VALUES (?, ?, ?, ?)", (first, n, worker, host))
        first += n


class OpenJournals:
    """Opens at most `most` journals as they are needed; closes the one unused for longest.

    A context manager that closes them all. Raises as `JournalWriter.open` and `JournalWriter.create`.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._open: dict[Path, JournalWriter] = {}

    def at(self, folder: Path) -> JournalWriter:
        """The journal in a run's folder, to be used before the next one is asked for."""
        journal = self._open.pop(folder, None) or self._make_room().open(folder)
        self._open[folder] = journal  # the last one is the one used last
        return journal

    def begin(self, folder: Path, identity: JournalIdentity, epoch: int, now: float) -> None:
        """Begin the journal of a run, as `JournalWriter.create`."""
        self._open[folder] = self._make_room().create(folder, identity, epoch, now)

    def close(self, folder: Path) -> None:
        """Close the journal in a run's folder, if it is open."""
        if journal := self._open.pop(folder, None):
            journal.close()

    def __enter__(self) -> "OpenJournals":
        return self

    def __exit__(self, *_: object) -> None:
        while self._open:
            self._close_oldest()

    def _make_room(self) -> type[JournalWriter]:
        while len(self._open) >= self._most:
            self._close_oldest()
        return JournalWriter

    def _close_oldest(self) -> None:
        self._open.pop(next(iter(self._open))).close()
