"""Pruning: a finished run without its failures; what all its rows came to stays."""

import sqlite3
import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import msgspec

from qdgrasp_coordinator.campaigns.summary import Summary, summary
from qdgrasp_coordinator.folders import disk
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.job_folder import JobFolder
from qdgrasp_coordinator.folders.journal_format import FILE, Identity, readable
from qdgrasp_coordinator.folders.journal_writer import fitting
from qdgrasp_coordinator.folders.sources import Source
from qdgrasp_coordinator.keeping.ranking import is_reranking
from qdgrasp_coordinator.keeping.reduction import rows_of, sources, write
from qdgrasp_protocol.errors import FolderError

PART = "run.sqlite.part"
PATIENCE = 1.0  # seconds; whoever only looks at a run has its journal open for an instant
INTERVAL = 0.05  # seconds between two tries
PRIMARY = 0xFF
"""The bits of SQLite's error codes that say what went wrong; those above say more of how."""


def prune(folder: RunFolder) -> int:
    """Drop the failures of a finished run; gives the bytes that this freed.

    The journal is replaced as a whole, or left as it was; one that is being read is waited for a little, and
    whoever begins to read it after that reads the old one.

    Raises
    ------
    FolderError, DiskFull
        The run is not finished, was pruned before, is in use or being read, ranks poses by all of their
        trials, or its folder cannot be written.
    """
    with folder.job.supervise(), folder.job.lock():
        return _pruned(folder)


@dataclass(frozen=True)
class Done:
    """What pruning a campaign came to."""

    freed: int
    """Bytes."""
    pruned: int
    """Runs that keep successes alone now, also those that did before."""
    runs: int


def prune_all(job: JobFolder) -> Done:
    """Drop the failures of a campaign's finished runs; raises as `prune` does; unfinished ones stay."""
    freed, pruned = 0, 0
    with job.supervise(), job.lock():
        folders = [RunFolder(path) for path in job.run_paths if RunFolder.is_run(path)]
        for folder in folders:
            with folder.journal() as journal:
                is_reduced = bool(journal.sources)
            if not is_reduced and not summary(folder).complete:
                continue
            freed, pruned = freed + (0 if is_reduced else _pruned(folder)), pruned + 1
    return Done(freed, pruned, len(folders))


def _pruned(folder: RunFolder) -> int:
    """The same, for whoever holds the job's locks."""
    with folder.journal() as journal:
        journal.check_whole()
        shape, run = journal.shape, journal.run
    (source,) = sources(folder)
    _check(folder, source)
    identity = Identity(run, source.spec, source.scene, shape)
    found = msgspec.structs.replace(
        msgspec.convert(source.summary, Summary), reduced="failures: only successes are kept"
    )
    file, part = folder.path / FILE, folder.path / PART
    before = file.stat().st_size
    try:
        _settle(file)
        write(part, identity, found, [(source, rows_of(folder, 0))])
        with disk.writing(folder.path):
            part.replace(file)
            disk.sync(folder.path)
    finally:
        part.unlink(missing_ok=True)
    return before - file.stat().st_size


def _check(folder: RunFolder, source: Source) -> None:
    if not source.summary["complete"]:
        raise FolderError(f"{folder.path} is not finished: what is pruned cannot be gone on with.")
    if is_reranking(folder):
        raise FolderError(f"{folder.path} ranks poses, for which every row is needed.")


def _settle(file: Path) -> None:
    """Have all of a journal in its one file, so that another may take its place.

    Raises
    ------
    FolderError
        It is being read, and that does not end soon.
    """
    deadline = time.monotonic() + PATIENCE
    while not _is_settled(file):
        if time.monotonic() > deadline:
            raise FolderError(
                f"{file} is being read by another process; nothing was changed: prune it when that is done."
            )
        time.sleep(INTERVAL)  # SQLite waits for nobody here


def _is_settled(file: Path) -> bool:
    """Whether nobody else had the file open, so that it could be settled."""
    with readable(file), fitting(file.parent), closing(sqlite3.connect(file)) as database:
        try:
            database.execute("PRAGMA journal_mode = DELETE")
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode & PRIMARY != sqlite3.SQLITE_BUSY:
                raise
            return False
    return True
