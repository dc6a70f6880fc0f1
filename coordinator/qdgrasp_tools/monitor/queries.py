"""Answers queries about recorded runs: listings, successes and scenes, from the journals.

Answered in threads of the bus; nothing is written, so that no commit waits for an answer. Listings are
counted bit by bit from the journals.
"""

import re
import socket
import threading
import time
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Self

from msgspec.structs import replace

from qdgrasp_coordinator.metrics.job_status import (
    OBJECTS_PER_PAGE,
    RUNS_PER_PAGE,
    ObjectListing,
    ObjectListings,
    RunListing,
    RunListings,
    from_json,
    to_json,
)
from qdgrasp_coordinator.metrics.run_stats import GrowthCurve, RunCounter, RunTotals
from qdgrasp_coordinator.storage.finished_runs import FinishedRuns
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.outputs import CAMPAIGN, SKIPPED, SPEC
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_coordinator.storage.success_pages import page_to_message, success_page
from qdgrasp_protocol import bundle_transfer, messages
from qdgrasp_protocol.bus import Bus, Query
from qdgrasp_protocol.errors import FolderError, InputError, Refused
from qdgrasp_protocol.keys import NAME, Keys, last_chunk, parse_number
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.text import printable
from qdgrasp_tools.campaign.campaign_file import read_campaign
from qdgrasp_tools.campaign.object_library import read_skip_report
from qdgrasp_tools.campaign.object_table import ObjectRun, list_objects
from qdgrasp_tools.report.row_report import RowContextCache

ROWS_PER_ANSWER = 1 << 19  # Most journal rows counted for one answer
FileStamp = tuple[tuple[int, int, int], ...]
"""The inode, the size and the time of the last change [ns] of each of some files."""


@dataclass
class CountedRun:
    """Progress of counting a run."""

    spec: RunSpec
    counter: RunCounter | None
    """None once the run is over: only the listing is kept, as a counter may hold many cells."""
    rows: int = 0
    """Number of journal rows that are counted."""
    listing: RunListing | None = None
    """Listing at the last complete count; None before the first."""
    curve: bytes = b""
    """The curve as JSON, once the run is over."""

    def curve_of(self, run: str) -> GrowthCurve:
        """Return the curve of the run of that name, as far as it is counted."""
        return self.counter.curve(run) if self.counter else from_json(self.curve, GrowthCurve)

    def count(self, journal: Journal, most: int) -> int:
        """Count at most so many new rows; returns their number."""
        if self.counter is None or (self.rows == journal.count and self.listing is not None):
            return 0
        first, last = self.rows, min(journal.count, self.rows + most)
        if first < last:
            for block in journal.blocks(first, last):
                self.counter.count_block(block, self.spec)
        self.rows = last
        if self.rows == journal.count:
            self.listing = RunListing.of(journal.run, self.spec, journal.scene, self.counter)
            if self.counter.finished is not None:
                self.curve, self.counter = to_json(self.counter.curve(journal.run)), None
        return self.rows - first


class RunIndex:
    """Counts the runs of a job's folder, there or not; reads only new rows, writes nothing.

    Finished runs of a campaign are not counted: they stand in the campaign's own index.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._finished = FinishedRuns(path)
        self._counts: dict[Path, CountedRun] = {}
        self._rows_left = 0

    def one(self, run: str) -> RunListings:
        """Return a run's listing and curve as far as counted; empty if there is no such run."""
        path, listings, curve = JobFolder(self._path).run_path(run), list[RunListing | None](), None
        with self._lock, suppress(InputError):
            self._rows_left = ROWS_PER_ANSWER
            listings.append(self._listing(path))
            curve = self._counts[path].curve_of(run) if path in self._counts else None
        return replace(_listings(listings), curve=curve)

    def page(self, first: int) -> RunListings:
        """Return the listings from the run with this number on, by name, as far as counted."""
        paths, behind = _run_paths(self._path), first + RUNS_PER_PAGE
        listings: list[RunListing | None] = []
        with self._lock:
            self._rows_left = ROWS_PER_ANSWER
            self._finished.refresh()
            for path in paths[first:behind]:
                if (known := self._finished.find(path)) is not None:
                    listings.append(_with_folder(known, path))
                    continue
                with suppress(InputError):  # there may be no journal yet, or no good one
                    listings.append(self._listing(path))
        return replace(_listings(listings), next=behind if behind < len(paths) else 0)

    def paths_of(self, scene: str) -> Iterator[Path]:
        """Yield the folders of runs that have a scene; only unfinished ones are opened."""
        with self._lock:
            self._finished.refresh()
        for path in _run_paths(self._path):
            with suppress(FolderError):
                if known := self._finished.find(path):
                    found = known.scene
                else:
                    with Journal.open(path) as journal:
                        found = journal.scene
                if found == scene:
                    yield path

    def _listing(self, path: Path) -> RunListing | None:
        """Return a run's listing, with the rows that are new counted."""
        with Journal.open(path) as journal:
            listing = self._counted(path, journal)
        return listing and _with_folder(listing, path)

    def _counted(self, path: Path, journal: Journal) -> RunListing | None:
        """Count a run's new rows, up to the limit of one answer."""
        spec, count = journal.spec, self._counts.get(path)
        if count is None or count.spec != spec or count.rows > journal.count:
            count = self._counts[path] = CountedRun(spec, RunCounter.of(spec))
        try:
            self._rows_left -= count.count(journal, self._rows_left)
        except FolderError:  # rows before the damage were counted, and would be once more
            del self._counts[path]
            raise
        return count.listing


def _with_folder(listing: RunListing, path: Path) -> RunListing:
    return replace(listing, folder=printable(str(path.absolute())))


def _run_paths(job: Path) -> list[Path]:
    return JobFolder(job).run_paths if JobFolder.is_job(job) else []


def _listings(listings: Sequence[RunListing | None]) -> RunListings:
    """Make an answer of these listings; None stands for one not counted yet."""
    return RunListings(
        runs=[listing for listing in listings if listing is not None],
        uncounted=listings.count(None),
        host=socket.gethostname(),
    )


def file_stamp(path: Path, *names: str) -> FileStamp:
    """Return a stamp that changes when a file of these names in a folder is written."""
    stamp: list[tuple[int, int, int]] = []
    for name in names:
        with suppress(OSError):  # it is not there, or no longer
            stat = (path / name).stat()
            stamp += [(stat.st_ino, stat.st_size, stat.st_mtime_ns)] if stat.st_size else []
    return tuple(stamp)


SCENES_KEPT = 8  # Number of scenes kept in memory
HOMES_KEPT = 256  # Number of scenes of which the folder is remembered
LISTED_SECONDS = 3.0  # seconds for which a list of objects is given again
LISTING_SECONDS = 2.0  # seconds for which runs are counted before a list is given without the others


class ObjectIndex:
    """Lists the objects of a job's folder with their figures; writes nothing.

    The objects are those of the campaign's file; without one, those of the runs that have begun. The counts
    of a run that is finished are read once: from the index of such runs, else from its journal, bit by bit.
    """

    def __init__(self, path: Path, runs: RunIndex) -> None:
        self._path = path
        self._runs = runs
        self._index = FinishedRuns(path)
        self._lock = threading.Lock()
        self._asked: tuple[FileStamp, Mapping[str, RunSpec]] = (), {}
        self._stamps: dict[str, FileStamp] = {}  # of the specs of runs, where there is no campaign's file
        self._totals: dict[str, RunTotals] = {}
        self._finished: set[str] = set()
        self._listings: list[ObjectListing] = []
        self._uncounted = 0
        self._due = 0.0

    def page(self, first: int) -> ObjectListings:
        """Return the objects from this number on, and how many runs are still being counted."""
        with self._lock:
            if time.monotonic() >= self._due:
                self._listings, self._uncounted = self._list()
                self._due = time.monotonic() + (0.0 if self._uncounted else LISTED_SECONDS)
            listings, uncounted = self._listings, self._uncounted
        behind = first + OBJECTS_PER_PAGE
        return ObjectListings(
            objects=listings[first:behind], next=behind if behind < len(listings) else 0, uncounted=uncounted
        )

    def _list(self) -> tuple[list[ObjectListing], int]:
        self._index.refresh()
        begun = {path.name: path for path in _run_paths(self._path)}
        specs, uncounted = self._specs(begun), 0
        until = time.monotonic() + LISTING_SECONDS
        unfinished = [name for name in specs if name in begun and name not in self._finished]
        for name in sorted(unfinished, key=lambda name: name in self._totals):  # unknown ones first
            if time.monotonic() > until:
                uncounted += 1
            else:
                with suppress(InputError):  # there may be no journal yet, or no good one
                    uncounted += self._count(name, begun[name], specs[name])
        runs = [
            ObjectRun(name, spec, self._totals.get(name), name in self._finished)
            for name, spec in specs.items()
        ]
        return list_objects(runs, read_skip_report(self._path / SKIPPED)), uncounted

    def _count(self, name: str, path: Path, spec: RunSpec) -> int:
        """Count a run; returns 1 where there is more to count than in one go."""
        if name not in self._totals and (known := self._index.find(path, spec)):
            self._totals[name] = known.totals
            self._finished.add(name)
            return 0
        found = self._runs.one(name)
        for listing in found.runs:
            self._totals[name] = listing.totals
            if listing.finished:
                self._finished.add(name)
        return found.uncounted

    def _specs(self, begun: Mapping[str, Path]) -> Mapping[str, RunSpec]:
        """Return the runs of the campaign, or those that have begun and whose spec is good, by name."""
        file = self._path / CAMPAIGN
        if not file.is_file():
            found = dict(self._asked[1])
            for name, path in begun.items():
                stamp = file_stamp(path, SPEC)
                if self._stamps.get(name) != stamp:  # it is new, or goes on to another end
                    with suppress(InputError):
                        found[name], self._stamps[name] = RunFolder(path).spec, stamp
                    self._finished.discard(name)
                    self._totals.pop(name, None)
            self._asked = (), {name: found[name] for name in begun if name in found}
            return self._asked[1]
        if self._asked[0] != (stamp := file_stamp(self._path, CAMPAIGN)):
            self._asked = stamp, read_campaign(file, here=False).runs
            self._finished, self._totals = set(), {}  # runs may have got other ends
        return self._asked[1]


class QueryServer(ExitStack):
    """Answers queries on a job's folder: runs, objects, finds and scenes (docs/bus.md)."""

    def __init__(self, bus: Bus, job: str, path: Path) -> None:
        super().__init__()
        self._bus = bus
        self._keys = Keys(job)
        self._path = path
        self._index = RunIndex(path)
        self._objects = ObjectIndex(path, self._index)
        self._contexts = RowContextCache()
        self._lock = threading.Lock()
        self._scenes: OrderedDict[str, bytes] = OrderedDict()  # by digest, in the order of their queries
        self._homes: dict[str, Path] = {}  # run folders in which scenes were seen

    def __enter__(self) -> Self:
        for pattern, answer in (
            (self._keys.entries, self.entries),
            (self._keys.objects, self.objects),
            (self._keys.finds, self.finds),
            (self._keys.recorded_asset(), self.scene),
        ):
            self.enter_context(self._bus.answer(pattern, answer))
        return self

    def entries(self, query: Query) -> bytes:
        """Return the runs from number `from` on, or the run `run` alone with its curve."""
        if run := _parameters(query).get("run"):
            if not NAME.fullmatch(run):
                raise Refused(f"this recorder has no run '{run[:64]}'")
            return to_json(self._index.one(run))
        return to_json(self._index.page(_number(query, "from")))

    def objects(self, query: Query) -> bytes:
        """Return the objects from number `from` on."""
        try:
            return to_json(self._objects.page(_number(query, "from")))
        except InputError as error:
            raise Refused(str(error)) from None

    def finds(self, query: Query) -> bytes:
        """Return successes of the run `run` from journal number `from` on."""
        run = _parameters(query).get("run", "")
        path = JobFolder(self._path).run_path(run)
        if not NAME.fullmatch(run) or not RunFolder.is_run(path):
            raise Refused(f"this recorder has no run '{run[:64]}'")
        try:
            with Journal.open(path) as journal:
                self._note_home(journal.scene, path)
                context = self._contexts.get(RunFolder(path), journal)
                page, upto = success_page(journal, _number(query, "from"), context)
                return messages.encode(page_to_message(page, upto, journal, run))
        except InputError as error:
            raise Refused(str(error)) from None

    def _note_home(self, scene: str, path: Path) -> None:
        with self._lock:
            self._homes[scene] = path
            if len(self._homes) > HOMES_KEPT:
                del self._homes[next(iter(self._homes))]

    def scene(self, query: Query) -> bytes:
        """Return one chunk of a scene."""
        digest = last_chunk(query.key)
        return bundle_transfer.answer_chunk(query, self._bundle(digest), digest)

    def _bundle(self, digest: str) -> bytes:
        """Return the bytes of a scene; the latest ones are kept in memory."""
        with self._lock:
            payload = self._scenes.pop(digest, None) or self._read(digest)
            self._scenes[digest] = payload
            if len(self._scenes) > SCENES_KEPT:
                self._scenes.popitem(last=False)
            return payload

    def _read(self, digest: str) -> bytes:
        """Return the bytes of a scene, from the folder of any run that has it."""
        seen = [self._homes[digest]] if digest in self._homes else []
        for path in chain(seen, self._index.paths_of(digest)):
            with suppress(FolderError):
                if (bundle := RunFolder(path).bundle()).digest == digest:
                    return bundle.payload
        raise Refused(f"no run here has the scene {digest[:12]}")


def _parameters(query: Query) -> dict[str, str]:
    pairs = (part.partition("=") for part in re.split("[&;]", query.parameters))
    return {name: value for name, _, value in pairs}


def _number(query: Query, name: str) -> int:
    text = _parameters(query).get(name, "0")
    found = parse_number(text)
    if found is None:
        raise Refused(f"'{text[:20]}' is no number: {name}")
    return found
