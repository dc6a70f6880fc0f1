"""The journal of a run: every evaluation in order, in `run.sqlite` (docs/run-folder.md).

Rows are kept as deflated blocks of structured arrays (`rows.RowShape.dtype`), one transaction per group of
rows; beside them stand reasons of errors, the spec and the platform.
One process writes; any number may read while it does, each sees the journal as it was when it was opened.
"""

import json
import sqlite3
import time
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from itertools import chain, groupby, repeat
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import msgspec
import numpy as np

from qdgrasp_coordinator.storage.outputs import JOURNAL, damaged_file
from qdgrasp_protocol.errors import DiskFull, FolderError, MessageError
from qdgrasp_protocol.messages import Failure, OpenRun, Recordable, deflated
from qdgrasp_protocol.rows import COLUMNS, Rows, RowShape, pack, unpack
from qdgrasp_protocol.spec import RunSpec, from_toml, to_toml
from qdgrasp_protocol.text import printable

APPLICATION = 0x71646772  # "qdgr"
FORMAT = 2
NO_PLATFORM: Mapping[str, str] = MappingProxyType({})
UNUSABLE = {
    *(sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM, sqlite3.SQLITE_BUSY, sqlite3.SQLITE_NOMEM),
    *(sqlite3.SQLITE_READONLY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_IOERR),
}
NO_ROOM = {
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_IOERR_WRITE,  # a file at its size limit, a quota
    sqlite3.SQLITE_IOERR_SHMSIZE,  # also of readers
}
"""SQLite's error codes for a write that does not fit; the transaction is rolled back."""
SCHEMA = """
CREATE TABLE meta (name TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT, WITHOUT ROWID;
CREATE TABLE turns (
    epoch INTEGER PRIMARY KEY, -- a coordinator's turn at the run
    opened REAL NOT NULL,      -- when it opened the run [s since 1970]
    last REAL NOT NULL         -- the last commit of its rows
) STRICT;
CREATE TABLE blocks (
    first INTEGER PRIMARY KEY, -- number of the block's first row
    n INTEGER NOT NULL,
    epoch INTEGER NOT NULL,
    cpu_seconds REAL NOT NULL, -- what the rows cost on their workers
    crc INTEGER NOT NULL,      -- crc32 of the blob
    rows BLOB NOT NULL         -- rows of the dtype of rows.RowShape: their first bytes, their second bytes,
                               -- and so on, deflated (zlib)
) STRICT;
CREATE TABLE errors (row INTEGER PRIMARY KEY, reason TEXT NOT NULL) STRICT;
CREATE TABLE makers (
    first INTEGER PRIMARY KEY, -- number of the first of some rows that one worker made
    n INTEGER NOT NULL,
    worker TEXT NOT NULL,      -- its id, new at every start
    host TEXT NOT NULL
) STRICT;
CREATE TABLE withdrawn ( -- blocks, as they were, of which rows were taken back: their maker was found wrong
    first INTEGER, n INTEGER, epoch INTEGER, cpu_seconds REAL, crc INTEGER, rows BLOB
) STRICT;
"""


@dataclass(frozen=True)
class JournalIdentity:
    """The run that a journal belongs to, or that a coordinator opens."""

    run: str
    spec: RunSpec
    scene: str
    """sha256 of the scene bundle."""
    shape: RowShape

    @classmethod
    def of(cls, asked: OpenRun) -> Self:
        """Return the run that a coordinator opens; an `InputError` says what is wrong with its spec."""
        spec = from_toml(asked.spec.decode(errors="replace"), "the coordinator's spec")
        shape = RowShape(asked.genes, asked.joints, asked.contact_slots)
        return cls(asked.run, spec, asked.scene, shape)


def create_tables(database: sqlite3.Connection, identity: JournalIdentity) -> None:
    """Create the tables of a run's journal in an empty database."""
    meta = {
        "run": identity.run,
        "spec": to_toml(identity.spec),
        "scene": identity.scene,
        "shape": json.dumps(asdict(identity.shape)),
        "package": version("qdgrasp"),
        "created": str(time.time()),
    }
    database.executescript(
        f"BEGIN; PRAGMA application_id = {APPLICATION}; PRAGMA user_version = {FORMAT}; {SCHEMA}"
    )
    database.executemany("INSERT INTO meta VALUES (?, ?)", meta.items())
    database.execute("COMMIT")  # at once: each transaction is a wait for the disk


@contextmanager
def explaining_errors(file: Path) -> Iterator[None]:
    """Turn SQLite's errors about a journal into `FolderError` or `DiskFull`."""
    try:
        yield
    except (sqlite3.ProgrammingError, sqlite3.IntegrityError):
        raise  # how it is used, such as after the end: the file is as it was
    except sqlite3.DatabaseError as error:
        code = getattr(error, "sqlite_errorcode", None)  # text that is not UTF-8 has none
        if code == sqlite3.SQLITE_NOTADB:
            raise FolderError(f"{file} is not a journal of qdgrasp.") from None
        if code in NO_ROOM:
            why = f"There is no room in {file.parent} for {file.name}, or its disk fails"
            raise DiskFull(f"{why}: {error}.") from None
        if code in UNUSABLE:
            raise FolderError(f"{file} cannot be read or written: {error}.") from None
        raise damaged_file(file, str(error)) from None


@dataclass(frozen=True)
class JournalSlice:
    """Rows of the journal from number `first` on."""

    first: int
    """The number of its first row; numbers count rows of the run from 0, in journal order."""
    rows: Rows
    cpu_seconds: float = 0.0
    """CPU time of these rows on workers [s]; outside the digest, so it may be an estimate."""
    failures: tuple[Failure, ...] = ()
    """Reasons of rows with `Outcome.ERROR`, by their place in `rows`."""
    makers: tuple[str, ...] = ()
    """Who made each row, a worker's id and host with a space between; empty: unknown."""

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def stop(self) -> int:
        """The number behind its last row."""
        return self.first + len(self.rows)

    def part(self, first: int, stop: int) -> "JournalSlice":
        """Return the part with numbers from `first` up to `stop`; the cost goes by share of rows."""
        low, high = max(first - self.first, 0), min(stop, self.stop) - self.first
        if (low, high) == (0, len(self)):
            return self
        failures = tuple(
            Failure(row=failure.row - low, reason=failure.reason)
            for failure in self.failures
            if low <= failure.row < high
        )
        cpu_seconds = self.cpu_seconds * (high - low) / len(self)
        rows, makers = self.rows[low:high], self.makers[low:high]
        return JournalSlice(self.first + low, rows, cpu_seconds, failures, makers)


def join_slices(slices: Sequence[JournalSlice]) -> JournalSlice:
    """Join slices that follow each other; at least one."""
    if len(slices) == 1:
        return slices[0]
    first = slices[0].first
    failures = tuple(
        Failure(row=part.first - first + failure.row, reason=failure.reason)
        for part in slices
        for failure in part.failures
    )
    rows = np.concatenate([part.rows for part in slices])
    makers = tuple(chain.from_iterable(part.makers or repeat("", len(part)) for part in slices))
    return JournalSlice(first, rows, sum(part.cpu_seconds for part in slices), failures, makers)


def slice_to_message(
    part: JournalSlice, run: str, epoch: int, shape: RowShape, platform: Mapping[str, str] = NO_PLATFORM
) -> Recordable:
    """Pack a part of a run's journal into a message."""
    return Recordable(
        epoch=epoch,
        run=run,
        first=part.first,
        n=len(part),
        **asdict(shape),
        columns=deflated(pack(part.rows, COLUMNS)),
        cpu_seconds=part.cpu_seconds,
        failures=list(part.failures),
        platform=dict(platform),
        makers=[(sum(1 for _ in same), maker) for maker, same in groupby(part.makers)],
    )


def slice_from_message(message: Recordable, shape: RowShape) -> JournalSlice:
    """Return the slice in a message; raise `MessageError` for other rows or unknown failed rows."""
    came = RowShape(message.genes, message.joints, message.contact_slots)
    if came != shape:
        raise MessageError(f"expected rows of {shape}, got {came}")
    if any(failure.row >= message.n for failure in message.failures):
        raise MessageError(f"a failure in a row behind its last, {message.n - 1}")
    if message.makers and sum(n for n, _ in message.makers) != message.n:
        raise MessageError(f"makers of other rows than {message.n}")
    rows = unpack(shape.empty(message.n), COLUMNS, message.columns)
    makers = tuple(chain.from_iterable(repeat(maker, n) for n, maker in message.makers))
    return JournalSlice(message.first, rows, message.cpu_seconds, tuple(message.failures), makers)


class Journal:
    """A journal to read; opened by `Journal.open`, closed by its with-block.

    Any method raises `FolderError` where the file is damaged.
    """

    def __init__(self, database: sqlite3.Connection, file: Path) -> None:
        self._database = database
        self._file = file
        self._check_format()
        try:
            meta = self._meta()
            self.run = meta["run"]
            self.scene = meta["scene"]
            """sha256 of the scene bundle."""
            self.created = float(meta["created"])
            """When it was begun [s since 1970]."""
            self.shape = msgspec.json.decode(meta["shape"], type=RowShape)
        except (KeyError, ValueError) as error:
            raise damaged_file(file, printable(f"what it says of itself cannot be read ({error})")) from None

    @classmethod
    def open(cls, folder: Path) -> "Journal":
        """Open the journal in a run's folder as it is now.

        Raises `FolderError` where there is no journal, or a damaged one, or one of a newer version.
        """
        file = folder / JOURNAL
        if not file.is_file():
            raise FolderError(f"{folder} holds no journal ({JOURNAL}).")
        with explaining_errors(file):
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
        return from_toml(self._meta()["spec"], str(self._file))

    @property
    def identity(self) -> JournalIdentity:
        """The run that it belongs to."""
        return JournalIdentity(self.run, self.spec, self.scene, self.shape)

    @property
    def platform(self) -> dict[str, str]:
        """The platform that the rows were made on; empty while the journal has no rows."""
        found: dict[str, str] = json.loads(self._meta().get("platform", "{}")) if self.count else {}
        return found

    @property
    def count(self) -> int:
        """Number of rows."""
        found = self._all("SELECT first + n FROM blocks ORDER BY first DESC LIMIT 1")
        return int(found[0][0]) if found else 0

    @property
    def cpu_seconds(self) -> float:
        """CPU time of all rows on their workers [s]."""
        return float(self._all("SELECT total(cpu_seconds) FROM blocks")[0][0])

    @property
    def wall_seconds(self) -> float:
        """Sum over coordinators of the time from opening the run to its last commit [s]."""
        return float(self._all("SELECT total(last - opened) FROM turns")[0][0])

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

    def errors(self) -> dict[int, str]:
        """Return the reasons of rows with `Outcome.ERROR`, by row number."""
        return {int(row): str(reason) for row, reason in self._all("SELECT row, reason FROM errors")}

    def makers(self, first: int = 0, stop: int | None = None) -> list[tuple[int, int, str, str]]:
        """Return first row, number, worker's id and host of rows `first` up to `stop`."""
        asked = "SELECT * FROM makers WHERE first + n > ? AND first < ? ORDER BY first"
        return self._all(asked, first, self.count if stop is None else stop)

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
        blocks = self._all(
            """SELECT first, n, cpu_seconds, crc FROM blocks WHERE first < ?
            AND first >= (SELECT coalesce(max(first), 0) FROM blocks WHERE first <= ?) ORDER BY first""",
            *(stop, first),
        )
        reasons = "SELECT row, reason FROM errors WHERE row >= ? AND row < ? ORDER BY row"
        failures = self._all(reasons, first, stop)
        expected: int | None = None
        for number, n, cpu_seconds, crc in blocks:
            ((blob,),) = self._all("SELECT rows FROM blocks WHERE first = ?", number)
            follows = 0 <= number <= first if expected is None else number == expected
            rows = self._block(blob, n) if follows and zlib.crc32(blob) == crc else None
            if rows is None:
                raise self._altered_rows(number, n)
            here = (Failure(row=row - number, reason=reason) for row, reason in failures if row >= number)
            yield JournalSlice(number, rows, cpu_seconds, tuple(f for f in here if f.row < n))
            expected = number + n
        if (first if expected is None else expected) < stop:
            raise damaged_file(self._file, f"rows {expected or first} to {stop - 1} are missing")

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
        with explaining_errors(self._file):
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
