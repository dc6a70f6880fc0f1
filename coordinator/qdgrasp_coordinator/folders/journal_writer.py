"""Writing a journal: one transaction per group of rows, on the disk when `append` returns."""

import json
import sqlite3
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from qdgrasp_coordinator.counts.cells import cells
from qdgrasp_coordinator.counts.stretch import Stretch
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_coordinator.folders.journal_format import FILE, NO_ROOM, Identity, lay_out, readable
from qdgrasp_protocol.errors import DiskFull, FolderError
from qdgrasp_protocol.outcome import Outcome

SUCCESS = "INSERT INTO successes VALUES (?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?)"


class JournalWriter(Journal):
    """A journal to add to; whoever opens it holds the lock of its job (`JobFolder.lock`)."""

    @classmethod
    def create(cls, folder: Path, identity: Identity) -> "JournalWriter":
        """Begin the journal of a run; the file appears whole or not at all.

        Raises
        ------
        DiskFull
            There is no room.
        """
        part = folder / f"{FILE}.part"
        part.unlink(missing_ok=True)
        with fitting(folder):
            database = sqlite3.connect(part, isolation_level=None)
            try:
                lay_out(database, identity)
            finally:
                database.close()
        part.replace(folder / FILE)
        return cls.open(folder)

    @classmethod
    def open(cls, folder: Path) -> "JournalWriter":
        """Open the journal in a run's folder to add to it; raises as `Journal.open` does."""
        file = folder / FILE
        with Journal.open(folder) as known:
            known.check_whole()
        with readable(file), fitting(folder):
            database = sqlite3.connect(file, isolation_level=None)
            try:
                database.execute("PRAGMA journal_mode = WAL")
                database.execute("PRAGMA synchronous = FULL")
                return cls(database, file)
            except BaseException:
                database.close()
                raise

    def begin_turn(self, epoch: int, now: float) -> None:
        """Note that a coordinator opened the run.

        Parameters
        ----------
        now
            The time of the day [s since 1970].
        """
        with self._transaction():
            self._database.execute("INSERT OR IGNORE INTO turns VALUES (?, ?, ?)", (epoch, now, now))

    def append(self, stretch: Stretch, epoch: int, now: float) -> None:
        """Add the next rows: all of them, durably, or none.

        Raises
        ------
        DiskFull
            There is no room; nothing was added.
        FolderError
            The file cannot be written for another reason; nothing was added.
        ValueError
            These are not the next rows.
        """
        if stretch.first != self.count:
            raise ValueError(f"row {self.count} is next, got {stretch.first}")
        with self._transaction():
            insert(self._database, stretch, epoch)
            self._database.execute("UPDATE turns SET last = max(last, ?) WHERE epoch = ?", (now, epoch))

    def set_platform(self, platform: dict[str, str]) -> None:
        """Note the platform that rows are made on."""
        self._set_meta("platform", json.dumps(platform, sort_keys=True))

    def set_spec(self, toml: str) -> None:
        """Replace the spec by the same one with another budget."""
        self._set_meta("spec", toml)

    def _set_meta(self, name: str, value: str) -> None:
        with self._transaction():
            self._database.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", (name, value))

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with fitting(self._file.parent):
            self._database.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._database.execute("COMMIT")
            except BaseException:
                if self._database.in_transaction:
                    self._database.execute("ROLLBACK")
                raise


def insert(database: sqlite3.Connection, stretch: Stretch, epoch: int) -> None:
    """Add rows to the tables of a journal, within a transaction."""
    blob = stretch.rows.tobytes()
    block = (stretch.first, len(stretch), epoch, stretch.cpu_seconds, zlib.crc32(blob), blob)
    errors = [(stretch.first + failure.row, failure.reason) for failure in stretch.failures]
    database.execute("INSERT INTO blocks VALUES (?, ?, ?, ?, ?, ?)", block)
    database.executemany(SUCCESS, _successes(stretch))
    database.executemany("INSERT INTO errors VALUES (?, ?)", errors)


def _successes(stretch: Stretch) -> list[tuple[float, ...]]:
    """What the table of successes holds of a stretch."""
    is_nominal = stretch.rows["trial"] == 0
    at = np.flatnonzero(is_nominal & (stretch.rows["outcome"] >= Outcome.DROPPED))
    rows = stretch.rows[at]
    columns = [stretch.first + at]
    columns += [rows[name] for name in ("generation", "index", "trial", "outcome", "fitness")]
    columns += [*rows["base_to_object"].T, *cells(rows["descriptor"][:, :3]).T]
    columns += [rows[name] for name in ("nu", "contacts", "penetration")]
    return list(zip(*(column.tolist() for column in columns), strict=True))


@contextmanager
def fitting(folder: Path) -> Iterator[None]:
    """Say in a sentence why nothing can be written, and tell a full disk from every other failure."""
    try:
        yield
    except sqlite3.OperationalError as error:
        if error.sqlite_errorcode in NO_ROOM:
            raise DiskFull(f"There is no room to write in {folder}: {error}.") from None
        raise FolderError(f"{folder} cannot be written: {error}.") from None
