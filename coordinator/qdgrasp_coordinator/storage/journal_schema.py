"""Tables, version and identity of a journal in `run.sqlite`; sources of a reduced one."""

import json
import re
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct

from qdgrasp_coordinator.storage.atomic_files import damaged_file
from qdgrasp_protocol.errors import DiskFull, FolderError
from qdgrasp_protocol.rows import RowShape
from qdgrasp_protocol.spec import RunSpec, from_toml
from qdgrasp_protocol.text import counted, printable


class JournalSource(Struct, frozen=True, kw_only=True):
    """A run of which a journal keeps the successes."""

    run: str
    """The name of the folder it lay in."""
    spec: str
    """Its full spec as TOML."""
    scene: str
    """sha256 of the scene bundle."""
    digest: str
    """The sha256 over all of its rows, before any was left out."""
    package: str
    """The version of this package that began it."""
    platform: dict[str, str]
    """Platform that its rows were made on."""
    summary: dict[str, Any]
    """Its figures, as `info --json` prints them."""
    kept: Annotated[int, Meta(ge=0)]
    """Number of its rows that are kept."""

    @property
    def asked(self) -> RunSpec:
        """Its spec."""
        return from_toml(self.spec, self.run)

    @property
    def words(self) -> str:
        """One line for a person."""
        done = counted(self.summary["evaluations"], "evaluation")
        return f"{self.run}: {self.asked.method}, seed {self.asked.seed}, {done}, {self.digest[:12]}"


APPLICATION = 0x71646772  # "qdgr"
FORMAT = 3
REDUCED = 4  # The format of a journal that keeps successes alone (`reduced_journal`)
OLD_FORMAT, OLD_REDUCED = 1, 2  # The same of version 0.1.0, with blocks of rows as they are
UNREADABLE = {sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM, sqlite3.SQLITE_BUSY, sqlite3.SQLITE_NOMEM}
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
CREATE TABLE successes (       -- every success ever found, fitness 0 included
    row INTEGER PRIMARY KEY,
    generation INTEGER NOT NULL, "index" INTEGER NOT NULL, trial INTEGER NOT NULL,
    outcome INTEGER NOT NULL, fitness REAL NOT NULL,
    x REAL NOT NULL, y REAL NOT NULL, z REAL NOT NULL,                        -- base_to_object [m]
    qx REAL NOT NULL, qy REAL NOT NULL, qz REAL NOT NULL, qw REAL NOT NULL,
    cell_x INTEGER NOT NULL, cell_y INTEGER NOT NULL, cell_z INTEGER NOT NULL, -- of the descriptor, 1 cm
    nu REAL NOT NULL, contacts INTEGER NOT NULL, penetration REAL NOT NULL
) STRICT;
CREATE INDEX successes_by_cell ON successes (cell_x, cell_y, cell_z, fitness);
CREATE INDEX successes_by_fitness ON successes (fitness);
CREATE TABLE errors (row INTEGER PRIMARY KEY, reason TEXT NOT NULL) STRICT;
"""
SOURCES = "CREATE TABLE sources (number INTEGER PRIMARY KEY, source TEXT NOT NULL) STRICT"
"""The table that a reduced journal has besides."""
LARGEST_VALUE = 1 << 27  # Bytes of a value in a file that is read, deflated or not


@dataclass(frozen=True)
class JournalIdentity:
    """The run that a journal belongs to: its name, spec, scene and row shape."""

    run: str
    spec: str
    """The full spec as TOML."""
    scene: str
    """sha256 of the scene bundle."""
    shape: RowShape


def create_tables(database: sqlite3.Connection, identity: JournalIdentity) -> None:
    """Create the tables of a run's journal in an empty database."""
    meta = {
        "run": identity.run,
        "spec": identity.spec,
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


def check_tables(database: sqlite3.Connection, file: Path) -> None:
    """Raise `FolderError` unless a file has the tables of a journal and nothing else.

    A view in the place of a table, a generated column or a trigger would have readers and writers carry out
    what another one wrote there.
    """
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_VALUE)
    database.execute("PRAGMA trusted_schema = OFF")
    found = _schema(database, limit=len(_known_schema()) + 1)
    strange = found.items() - _known_schema().items()
    missing = _known_schema().keys() - found.keys() - {("table", "sources")}
    for kind, name in sorted(key for key, _ in strange):
        raise damaged_file(file, f"its {printable(kind, 20)} '{printable(name, 40)}' is none of a journal")
    for kind, name in sorted(missing):
        raise damaged_file(file, f"it has no {kind} '{name}'")


@cache
def _known_schema() -> dict[tuple[str, str], str]:
    with closing(sqlite3.connect(":memory:")) as database:
        database.executescript(f"{SCHEMA};{SOURCES}")
        return _schema(database)


def _schema(database: sqlite3.Connection, limit: int = 100) -> dict[tuple[str, str], str]:
    """Return the statements that made a database, by kind and name, without comments."""
    found = database.execute("SELECT type, name, sql FROM sqlite_schema LIMIT ?", (limit,)).fetchall()
    return {
        (str(kind), str(name)): " ".join(re.sub(r"--.*", "", str(statement)).split())
        for kind, name, statement in found
        if not str(name).startswith("sqlite_stat")  # of ANALYZE
    }


@contextmanager
def explaining_read_errors(file: Path) -> Iterator[None]:
    """Turn SQLite's errors about a file that cannot be read into `FolderError` or `DiskFull`."""
    try:
        yield
    except sqlite3.ProgrammingError:
        raise  # the module's own word on how it is used, such as after the end: the file is as it was
    except sqlite3.DatabaseError as error:
        code = getattr(error, "sqlite_errorcode", None)  # text that is not UTF-8 has none
        if code == sqlite3.SQLITE_NOTADB:
            raise FolderError(f"{file} is not a journal of qdgrasp.") from None
        if code in NO_ROOM:
            raise DiskFull(f"There is no room in {file.parent} to read {file.name}: {error}.") from None
        if code in UNREADABLE:
            raise FolderError(f"{file} cannot be read: {error}.") from None
        raise damaged_file(file, str(error)) from None
