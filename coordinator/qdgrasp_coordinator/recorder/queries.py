"""Answers queries about recorded runs: listings, successes and scenes, from the journals.

Answered in threads of the bus; nothing is written, so that no commit waits for an answer. Listings are
counted bit by bit from the journals.
"""

import re
import socket
import threading
import time
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import msgspec
from msgspec.structs import replace

from qdgrasp_coordinator.campaign.summary import RunSummary
from qdgrasp_coordinator.metrics.job_status import RUNS_PER_PAGE, RunListing, RunListings, from_json, to_json
from qdgrasp_coordinator.metrics.run_stats import (
    CurveRecorder,
    GrowthCurve,
    RunCounter,
    count_block,
    new_counter,
)
from qdgrasp_coordinator.report.row_report import RowContextCache
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.journal_schema import FILE
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_coordinator.storage.success_pages import SuccessTable, page_to_message, success_page
from qdgrasp_protocol import bundle_transfer, messages
from qdgrasp_protocol.bus import Bus, Query
from qdgrasp_protocol.errors import FolderError, Refused
from qdgrasp_protocol.keys import NAME, Keys, last_chunk, parse_number
from qdgrasp_protocol.messages import SuccessPage
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.text import printable

ROWS_PER_ANSWER = 1 << 19  # Most journal rows counted for one answer
CLOCK_SECONDS = 2.0  # Longest time-stamp step of a file system, old ones included [s]
FileStamp = tuple[tuple[int, int, int], ...]
"""The inode, the size and the time of the last change [ns] of each file of a journal."""


@dataclass
class CountedRun:
    """Progress of counting a run."""

    spec: RunSpec
    rows: int = 0
    tally: RunCounter | None = None
    """None once the run is over: only the entry is kept, as a tally may hold many cells."""
    entry: RunListing | None = None
    """Entry at the last complete count; None before the first."""
    trail: CurveRecorder = field(default_factory=CurveRecorder)
    """Growth of its counts; once the run is over it is in `curve`."""
    curve: bytes = b""

    def grown(self, run: str) -> GrowthCurve:
        """Return the curve of the run of that name, as far as it is counted."""
        return from_json(self.curve, GrowthCurve) if self.curve else self.trail.curve(run)


class RunIndex:
    """Counts the runs of a job; reads only rows new since the last answer, writes nothing.

    Parameters
    ----------
    path
        The job's folder, or where it is to be.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._counts: dict[Path, CountedRun] = {}
        self._known: dict[Path, tuple[FileStamp, RunListing]] = {}
        self._left = 0

    def one(self, run: str) -> RunListings:
        """Return a run's entry and curve as far as counted; empty if there is no such run."""
        path, entries, curve = JobFolder(self._path).run_path(run), list[RunListing | None](), None
        with self._lock, suppress(FolderError):
            self._left = ROWS_PER_ANSWER
            entries.append(self._entry(path))
            curve = self._counts[path].grown(run) if path in self._counts else None
        return replace(_listings(entries), curve=curve)

    def page(self, first: int) -> RunListings:
        """Return the entries from the run with this number on, by name, as far as counted."""
        paths = JobFolder(self._path).run_paths if JobFolder.is_job(self._path) else []
        entries: list[RunListing | None] = []
        with self._lock:
            self._left = ROWS_PER_ANSWER
            for path in paths[first : first + RUNS_PER_PAGE]:
                with suppress(FolderError):  # there may be no journal yet, or no good one
                    entries.append(self._entry(path))
        return replace(
            _listings(entries), next=first + RUNS_PER_PAGE if first + RUNS_PER_PAGE < len(paths) else 0
        )

    def _entry(self, path: Path) -> RunListing | None:
        """Return a run's entry; a journal unchanged since its count is not opened again."""
        stamp, now = journal_stamp(path), time.time()
        stands, known = self._known.get(path, (None, None))
        if known is not None and stands == stamp:
            return known
        with Journal.open(path) as journal:
            entry = summary_listing(journal) if journal.sources else self._counted(path, journal)
            is_whole = path not in self._counts or self._counts[path].rows == journal.count
        entry = entry and replace(entry, folder=printable(str(path.absolute())))
        if entry and is_whole and has_rested(stamp, now):
            self._known[path] = stamp, entry
        return entry

    def _counted(self, path: Path, journal: Journal) -> RunListing | None:
        """Count a run's new rows, up to the limit of one answer."""
        spec, rows = journal.spec, journal.count
        count = self._counts.get(path)
        if count is None or count.spec != spec or count.rows > rows:
            count = self._counts[path] = CountedRun(spec, tally=new_counter(spec))
        if count.tally is not None and (count.rows < rows or count.entry is None):
            self._go_on(count, journal, rows)
        return count.entry

    def _go_on(self, count: CountedRun, journal: Journal, rows: int) -> None:
        found, stop = count.tally, min(rows, count.rows + self._left)
        if found is None:
            return
        for block in journal.kept(count.rows, stop) if count.rows < stop else ():
            count_block(found, count.spec, block, count.trail)
        self._left -= stop - count.rows
        count.rows = stop
        whole = RunListing.of(journal.run, count.spec, journal.scene, found) if stop == rows else None
        count.entry = whole or count.entry
        if found.finished is not None and whole is not None:
            count.tally, count.curve, count.trail = None, to_json(count.grown(journal.run)), CurveRecorder()


def _listings(entries: Sequence[RunListing | None]) -> RunListings:
    """Make an answer of these entries; None stands for one not counted yet."""
    return RunListings(
        runs=[entry for entry in entries if entry is not None],
        uncounted=entries.count(None),
        host=socket.gethostname(),
    )


def journal_stamp(path: Path) -> FileStamp:
    """Return a stamp that changes when the journal in a folder is written."""
    stamp: list[tuple[int, int, int]] = []
    for name in (FILE, f"{FILE}-wal"):
        with suppress(OSError):  # it is not there, or no longer
            stat = (path / name).stat()
            stamp += [(stat.st_ino, stat.st_size, stat.st_mtime_ns)] if stat.st_size else []
    return tuple(stamp)


def has_rested(stamp: FileStamp, now: float) -> bool:
    """True if the last change was so long before `now` [s since 1970] that a next one shows."""
    return all(changed / 1e9 < now - CLOCK_SECONDS for _, _, changed in stamp)


def summary_listing(journal: Journal) -> RunListing:
    """Return a pruned or merged run's entry, from its summary; outcomes are not known."""
    summary = msgspec.structs.asdict(msgspec.json.decode(journal.summary, type=RunSummary))
    known = dict(_shared_fields(summary)) | {"run": journal.run, "outcomes": {}, "finished": summary["ended"]}
    return msgspec.convert(known, RunListing)


def _shared_fields(values: dict[str, object]) -> Iterator[tuple[str, object]]:
    """Those of the values that an entry has too."""
    for name in RunListing.__struct_fields__:
        if name in values:
            yield name, values[name]


SCENES_KEPT = 8  # Number of scenes kept in memory


class QueryServer:
    """Answers `rec/runs`, `rec/finds` and `rec/asset` while its context lasts (docs/bus.md).

    Parameters
    ----------
    path
        The job's folder, or where it is to be.
    """

    def __init__(self, bus: Bus, job: str, path: Path) -> None:
        self._bus = bus
        self._keys = Keys(job)
        self._path = path
        self._register = RunIndex(path)
        self._legends = RowContextCache()
        self._lock = threading.Lock()
        self._scenes: OrderedDict[str, bytes] = OrderedDict()  # by digest, as they were asked for
        self._homes: dict[str, Path] = {}  # where scenes were seen
        self._doors = ExitStack()

    def __enter__(self) -> Self:
        for pattern, answer in (
            (self._keys.entries, self.entries),
            (self._keys.finds, self.finds),
            (self._keys.recorded_asset(), self.scene),
        ):
            self._doors.enter_context(self._bus.answer(pattern, answer))
        return self

    def __exit__(self, *_: object) -> None:
        self._doors.close()

    def entries(self, query: Query) -> bytes:
        """Return the runs from number `from` on, or the run `run` alone with its curve.

        Raises
        ------
        Refused
            `run` is not a run's name.
        """
        if run := _parameters(query).get("run"):
            if not NAME.fullmatch(run):
                raise Refused(f"this recorder has no run '{run[:64]}'")
            return to_json(self._register.one(run))
        return to_json(self._register.page(_number(query, "from")))

    def finds(self, query: Query) -> bytes:
        """Successes of the run `run` from journal number `from` on.

        Raises
        ------
        Refused
            There is no such run, or it cannot be read.
        """
        run = _parameters(query).get("run", "")
        path = JobFolder(self._path).run_path(run)
        if not NAME.fullmatch(run) or not RunFolder.is_run(path):
            raise Refused(f"this recorder has no run '{run[:64]}'")
        try:
            with Journal.open(path) as journal:
                self._homes[journal.scene] = path
                legend = self._legends.get(RunFolder(path), journal)
                return messages.encode(
                    _page_message(journal, run, *success_page(journal, _number(query, "from"), legend))
                )
        except FolderError as error:
            raise Refused(str(error)) from None

    def scene(self, query: Query) -> bytes:
        """One chunk of a scene.

        Raises
        ------
        Refused
            No run here has this scene.
        """
        digest = last_chunk(query.key)
        return bundle_transfer.answer_chunk(query, self._bundle(digest), digest)

    def _bundle(self, digest: str) -> bytes:
        """The bytes of a scene; those that were asked for last are kept."""
        with self._lock:
            payload = self._scenes.pop(digest, None) or self._read(digest)
            self._scenes[digest] = payload
            if len(self._scenes) > SCENES_KEPT:
                self._scenes.popitem(last=False)
            return payload

    def _run_paths(self) -> list[Path]:
        return JobFolder(self._path).run_paths if JobFolder.is_job(self._path) else []

    def _read(self, digest: str) -> bytes:
        """The bytes of a scene, from the folder of any run that has it."""
        seen = [self._homes[digest]] if digest in self._homes else []
        for path in seen + self._run_paths():
            with suppress(FolderError):
                with Journal.open(path) as journal:
                    is_its = journal.scene == digest
                if is_its and (bundle := RunFolder(path).bundle()).digest == digest:
                    return bundle.payload
        raise Refused(f"no run here has the scene {digest[:12]}")


def _page_message(journal: Journal, run: str, finds: SuccessTable, upto: int) -> SuccessPage:
    """Pack finds of a journal into a message."""
    joints, began = journal.shape.joints, journal.created
    return page_to_message(
        finds, upto, run=run, scene=journal.scene, began=began, rows=journal.count, joints=joints
    )


def _parameters(query: Query) -> dict[str, str]:
    """Return the parameters behind the `?`, by name."""
    pairs = (part.partition("=") for part in re.split("[&;]", query.parameters))
    return {name: value for name, _, value in pairs}


def _number(query: Query, name: str) -> int:
    """Return a numeric parameter; 0 where it is missing.

    Raises
    ------
    Refused
        It is not a number.
    """
    text = _parameters(query).get(name, "0")
    found = parse_number(text)
    if found is None:
        raise Refused(f"'{text[:20]}' is no number: {name}")
    return found
