"""The register: entries of all runs in a job's folder, counted bit by bit from their journals."""

import socket
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec
from msgspec.structs import replace

from qdgrasp_coordinator.campaigns.summary import Summary
from qdgrasp_coordinator.counts.entry import PAGE, RunEntries, RunEntry
from qdgrasp_coordinator.counts.tally import Tally, begun, go_on
from qdgrasp_coordinator.folders.job_folder import JobFolder
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.spec import RunSpec

ROWS = 1 << 19
"""So many journal rows are counted for one answer."""


@dataclass
class Count:
    """How far a run is counted."""

    spec: RunSpec
    rows: int = 0
    tally: Tally | None = None
    """None once the run is over: then there is the entry alone, as a tally may hold many cells."""
    entry: RunEntry | None = None
    """As of these rows; None while others were left for the next answer."""


class Register:
    """Counts the runs of a job; it reads only what is new since the last answer, and writes nothing.

    Parameters
    ----------
    path
        The job's folder, or where it is to be.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._counts: dict[Path, Count] = {}
        self._left = 0

    def page(self, first: int) -> RunEntries:
        """The entries from the run with this number on, by name, as far as they are counted."""
        paths = JobFolder(self._path).run_paths if JobFolder.is_job(self._path) else []
        here = paths[first : first + PAGE]
        self._left = ROWS
        entries: list[RunEntry | None] = []
        for path in here:
            with (
                suppress(FolderError),
                Journal.open(path) as journal,
            ):  # there may be none yet, or no good one
                entry = told(journal) if journal.sources else self._counted(path, journal)
                entries.append(entry and replace(entry, folder=str(path.absolute())))
        return RunEntries(
            runs=[entry for entry in entries if entry is not None],
            next=first + PAGE if first + PAGE < len(paths) else 0,
            uncounted=entries.count(None),
            host=socket.gethostname(),
        )

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
            go_on(found, count.spec, block)
        self._left -= stop - count.rows
        count.rows = stop
        whole = RunEntry.of(journal.run, count.spec, journal.scene, found) if stop == rows else None
        count.entry = whole or count.entry
        if found.finished is not None and whole is not None:
            count.tally = None


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
