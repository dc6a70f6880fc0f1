"""The register: entries of all runs in a job's folder, counted bit by bit from their journals."""

import socket
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
from msgspec.structs import replace

from qdgrasp_coordinator.campaigns.summary import Summary
from qdgrasp_coordinator.counts.counting import begun, go_on
from qdgrasp_coordinator.counts.curve import Curve, Trail
from qdgrasp_coordinator.counts.entry import PAGE, RunEntries, RunEntry
from qdgrasp_coordinator.counts.figures import from_json, to_json
from qdgrasp_coordinator.counts.tally import Tally
from qdgrasp_coordinator.folders.job_folder import JobFolder
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_coordinator.folders.journal_format import FILE
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.printable import printable
from qdgrasp_protocol.spec import RunSpec

ROWS = 1 << 19
"""So many journal rows are counted for one answer."""
REST = 2.0
"""A file system's clock goes on within this time, even that of an old one [s]."""
Stamp = tuple[tuple[int, int, int], ...]
"""The inode, the size and the time of the last change [ns] of each file of a journal."""


@dataclass
class Count:
    """How far a run is counted."""

    spec: RunSpec
    rows: int = 0
    tally: Tally | None = None
    """None once the run is over: then there is the entry alone, as a tally may hold many cells."""
    entry: RunEntry | None = None
    """As of these rows; None while others were left for the next answer."""
    trail: Trail = field(default_factory=Trail)
    """How it grew; once the run is over that is in `curve`."""
    curve: bytes = b""

    def grown(self, run: str) -> Curve:
        """How the run of that name grew, as far as it is counted."""
        return from_json(self.curve, Curve) if self.curve else self.trail.curve(run)


class Register:
    """Counts the runs of a job; it reads only what is new since the last answer, and writes nothing.

    Parameters
    ----------
    path
        The job's folder, or where it is to be.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._counts: dict[Path, Count] = {}
        self._known: dict[Path, tuple[Stamp, RunEntry]] = {}
        self._left = 0

    def one(self, run: str) -> RunEntries:
        """The entry of a run, and how it grew, as far as it is counted; none where there is no such run."""
        path, entries, curve = JobFolder(self._path).run_path(run), list[RunEntry | None](), None
        with self._lock, suppress(FolderError):
            self._left = ROWS
            entries.append(self._entry(path))
            curve = self._counts[path].grown(run) if path in self._counts else None
        return replace(_answer(entries), curve=curve)

    def page(self, first: int) -> RunEntries:
        """The entries from the run with this number on, by name, as far as they are counted."""
        paths = JobFolder(self._path).run_paths if JobFolder.is_job(self._path) else []
        entries: list[RunEntry | None] = []
        with self._lock:
            self._left = ROWS
            for path in paths[first : first + PAGE]:
                with suppress(FolderError):  # there may be no journal yet, or no good one
                    entries.append(self._entry(path))
        return replace(_answer(entries), next=first + PAGE if first + PAGE < len(paths) else 0)

    def _entry(self, path: Path) -> RunEntry | None:
        """That of a run; a journal that rests since it was counted is not opened again."""
        stamp, now = stamp_of(path), time.time()
        stands, known = self._known.get(path, (None, None))
        if known is not None and stands == stamp:
            return known
        with Journal.open(path) as journal:
            entry = told(journal) if journal.sources else self._counted(path, journal)
            is_whole = path not in self._counts or self._counts[path].rows == journal.count
        entry = entry and replace(entry, folder=printable(str(path.absolute())))
        if entry and is_whole and rests(stamp, now):
            self._known[path] = stamp, entry
        return entry

    def _counted(self, path: Path, journal: Journal) -> RunEntry | None:
        """Count what is new of a run, as far as there is time."""
        spec, rows = journal.spec, journal.count
        count = self._counts.get(path)
        if count is None or count.spec != spec or count.rows > rows:
            count = self._counts[path] = Count(spec, tally=begun(spec))
        if count.tally is not None and (count.rows < rows or count.entry is None):
            self._go_on(count, journal, rows)
        return count.entry

    def _go_on(self, count: Count, journal: Journal, rows: int) -> None:
        found, stop = count.tally, min(rows, count.rows + self._left)
        if found is None:
            return
        for block in journal.kept(count.rows, stop) if count.rows < stop else ():
            go_on(found, count.spec, block, count.trail)
        self._left -= stop - count.rows
        count.rows = stop
        whole = RunEntry.of(journal.run, count.spec, journal.scene, found) if stop == rows else None
        count.entry = whole or count.entry
        if found.finished is not None and whole is not None:
            count.tally, count.curve, count.trail = None, to_json(count.grown(journal.run)), Trail()


def _answer(entries: Sequence[RunEntry | None]) -> RunEntries:
    """These entries; None stands for one that is not counted yet."""
    return RunEntries(
        runs=[entry for entry in entries if entry is not None],
        uncounted=entries.count(None),
        host=socket.gethostname(),
    )


def stamp_of(path: Path) -> Stamp:
    """What changes whenever something is written to the journal in a folder."""
    stamp: list[tuple[int, int, int]] = []
    for name in (FILE, f"{FILE}-wal"):
        with suppress(OSError):  # it is not there, or no longer
            stat = (path / name).stat()
            stamp += [(stat.st_ino, stat.st_size, stat.st_mtime_ns)] if stat.st_size else []
    return tuple(stamp)


def rests(stamp: Stamp, now: float) -> bool:
    """Whether the last change was so long before `now` [s since 1970] that the next gets another stamp."""
    return all(changed / 1e9 < now - REST for _, _, changed in stamp)


def told(journal: Journal) -> RunEntry:
    """The entry of a run whose rows are not all there any more: how its genomes ended is not known."""
    summary = msgspec.structs.asdict(msgspec.json.decode(journal.summary, type=Summary))
    known = dict(_shared(summary)) | {"run": journal.run, "outcomes": {}, "finished": summary["ended"]}
    return msgspec.convert(known, RunEntry)


def _shared(values: dict[str, object]) -> Iterator[tuple[str, object]]:
    """Those of the values that an entry has too."""
    for name in RunEntry.__struct_fields__:
        if name in values:
            yield name, values[name]
