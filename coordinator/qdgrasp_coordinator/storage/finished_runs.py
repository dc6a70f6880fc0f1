"""The index of a campaign's finished runs, in one file (docs/run-folder.md).

A line says what a run's journal was counted to and by which mark of its files; a line whose mark does not
fit is passed over, and the run is counted anew. So the file may be lost, cut or copied at any time. Lines
are added in one write each, by any process, and need no wait for the disk: a journal is on the disk before
its line is written.
"""

import hashlib
import os
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

import msgspec
from msgspec import Struct

from qdgrasp_coordinator.metrics.job_status import RunListing
from qdgrasp_coordinator.storage.outputs import FINISHED, JOURNAL, SPEC
from qdgrasp_protocol.spec import RunSpec

MARKED = (SPEC, JOURNAL, f"{JOURNAL}-wal")
"""The files of a run that its mark depends on."""
DIGITS = 32  # Characters of digests and marks
COUNTED_BY = " ".join([version("qdgrasp"), *RunListing.__struct_fields__]).encode()


class FinishedRun(Struct, frozen=True, kw_only=True):
    """A line of the index."""

    run: str
    """The name of its folder."""
    spec: str
    """Digest of the spec under which the run is finished, goals included."""
    files: str
    """Mark of the run's files as they were counted, and of who counted them."""
    engine: str | None = None
    """The physics engine of its rows; None: Bullet."""
    listing: RunListing


def _spec_digest(spec: RunSpec) -> str:
    return hashlib.sha256(msgspec.msgpack.encode(spec)).hexdigest()[:DIGITS]


def _files_mark(path: Path) -> str:
    """Return the mark of a run's files: a copy that keeps the times of files keeps it."""
    total, folder = hashlib.sha256(COUNTED_BY), str(path)
    for name in MARKED:
        with suppress(OSError):  # it is not there, or no longer
            stat = os.stat(f"{folder}/{name}")  # noqa: PTH116  # a path to join costs more than the look
            if stat.st_size:
                total.update(f" {name} {stat.st_size} {stat.st_mtime_ns}".encode())
    return total.hexdigest()[:DIGITS]


class FinishedRuns:
    """The index in a campaign's folder as of the last `refresh`."""

    def __init__(self, campaign: Path) -> None:
        self._file = campaign / FINISHED
        self._mark: tuple[int, ...] = ()
        self._runs: dict[str, FinishedRun] = {}

    def refresh(self) -> None:
        """Read the file again if it has changed since the last time."""
        with suppress(OSError):
            stat = self._file.stat()
            if (mark := (stat.st_ino, stat.st_size, stat.st_mtime_ns)) == self._mark:
                return
            self._mark, self._runs = mark, {}
            for line in self._file.read_bytes().splitlines():
                with suppress(ValueError, RecursionError):  # a line that was cut off
                    found = msgspec.json.decode(line, type=FinishedRun)
                    self._runs[found.run] = found

    def find(self, path: Path, spec: RunSpec | None = None) -> RunListing | None:
        """Return the listing of the run in a folder if it is finished; None: that is not known.

        With a `spec`: if it is finished under that spec.
        """
        known = self._runs.get(path.name)
        if known is None or (spec is not None and known.spec != _spec_digest(spec)):
            return None
        return known.listing if known.files == _files_mark(path) else None

    def engines(self) -> dict[str, str | None]:
        """Return the engines of the runs that are in the index, by run."""
        return {name: known.engine for name, known in self._runs.items()}

    def add(self, path: Path, spec: RunSpec, listing: RunListing) -> None:
        """Add the run in a folder; a disk that cannot take the line is no error."""
        line = FinishedRun(
            run=path.name,
            spec=_spec_digest(spec),
            files=_files_mark(path),
            engine=spec.engine,
            listing=listing,
        )
        with suppress(OSError), self._file.open("ab", buffering=0) as file:
            file.write(b"\n" + msgspec.json.encode(line) + b"\n")  # it ends a line that was cut off
