"""Tables, version and identity of a journal in `run.sqlite`."""

import json
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

from qdgrasp_coordinator.storage.atomic_files import damaged_file
from qdgrasp_protocol.errors import DiskFull, FolderError
from qdgrasp_protocol.rows import RowShape

APPLICATION = 0x71646772  # "qdgr"
FORMAT = 1
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
