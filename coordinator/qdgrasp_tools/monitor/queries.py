"""Answers queries about recorded runs: listings, successes and scenes, from the journals.

Answered in threads of the bus; nothing is written, so that no commit waits for an answer. Listings are
counted bit by bit from the journals. What reads campaigns is loaded when it is asked for: a recorder starts
with a run.
"""

import re
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import lru_cache
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
    to_json,
)
from qdgrasp_coordinator.metrics.run_stats import GrowthCurve, RunCounter
from qdgrasp_coordinator.storage.finished_runs import FinishedRuns
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.outputs import CAMPAIGN, SKIPPED
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_coordinator.storage.success_pages import page_to_message, success_page
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus, Query, answer_chunk
from qdgrasp_protocol.errors import FolderError, InputError, Refused
from qdgrasp_protocol.keys import NAME, Keys, last_chunk, parse_number
from qdgrasp_protocol.spec import RunSpec

COUNTING_SECONDS = 1.0  # seconds for which rows are counted for one answer; it gives what is counted then
LISTED_SECONDS = 3.0  # seconds for which a list of objects is given again
SCENES_KEPT = 8  # Number of scenes kept in memory


class CountedRun:
    """Progress of counting a run."""

    def __init__(self, spec: RunSpec) -> None:
        self.spec = spec
        self.rows = 0  # Number of journal rows that are counted
        self.listing: RunListing | None = None  # At the last complete count; None before the first
        self._counter: RunCounter | None = RunCounter(spec)  # None once it is over: it may hold many cells
        self._curve: GrowthCurve | None = None  # Once it is over

    def curve(self, run: str) -> GrowthCurve | None:
        """Return the curve of the run of that name, as far as it is counted."""
        return self._counter.curve(run) if self._counter else self._curve

    def count(self, journal: Journal, until: float) -> None:
        """Count new rows, until a time of the monotonic clock [s]; a block of them at least."""
        if (counter := self._counter) is None or (self.listing and self.rows == journal.count):
            return
        for block in journal.blocks(self.rows):
            counter.count_block(block)
            self.rows += len(block)
            if time.monotonic() > until:
                break
        if self.rows == journal.count:
            self.listing = RunListing.of(journal.run, journal.scene, counter)
            if counter.finished is not None:
                self._curve, self._counter = counter.curve(journal.run), None


class RunIndex:
    """Counts the runs of a job's folder, there or not; reads only new rows, writes nothing.

    Finished runs of a campaign are not counted: they stand in the campaign's own index. The objects are those
    of the campaign's file; without one, those of the runs that have begun.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._finished = FinishedRuns(path)
        self._counts: dict[Path, CountedRun] = {}
        self._until = 0.0  # When counting for this answer ends
        self._objects: tuple[list[ObjectListing], int] = [], 0
        self._objects_due = 0.0
        self._campaign: tuple[float, Mapping[str, RunSpec]] = 0.0, {}  # by the time of the file's last change

    def one(self, run: str) -> RunListings:
        """Return a run's listing and curve as far as counted; empty if there is no such run."""
        path = JobFolder(self._path).run_path(run)
        with self._answering(), suppress(InputError):
            listing = self._counted(path)
            return replace(_listings([listing]), curve=self._counts[path].curve(run))
        return _listings([])

    def page(self, first: int) -> RunListings:
        """Return the listings from the run with this number on, by name, as far as counted."""
        paths, behind = _run_paths(self._path), first + RUNS_PER_PAGE
        listings: list[RunListing | None] = []
        with self._answering():
            for path in paths[first:behind]:
                with suppress(InputError):  # there may be no journal yet, or no good one
                    listings.append(self._listing(path))
        return replace(_listings(listings), next=behind if behind < len(paths) else 0)

    def objects(self, first: int) -> ObjectListings:
        """Return the objects from this number on, and how many runs are still being counted."""
        with self._answering():
            if time.monotonic() >= self._objects_due:
                self._objects = self._list_objects()
                self._objects_due = time.monotonic() + (0.0 if self._objects[1] else LISTED_SECONDS)
            listings, uncounted = self._objects
        behind = first + OBJECTS_PER_PAGE
        return ObjectListings(
            objects=listings[first:behind], next=behind if behind < len(listings) else 0, uncounted=uncounted
        )

    def paths_of(self, scene: str) -> Iterator[Path]:
        """Yield the folders of runs that have a scene; only unfinished ones are opened."""
        with self._answering():
            pass
        for path in _run_paths(self._path):
            with suppress(FolderError):
                if known := self._finished.find(path):
                    found = known.scene
                else:
                    with Journal.open(path) as journal:
                        found = journal.scene
                if found == scene:
                    yield path

    @contextmanager
    def _answering(self) -> Iterator[None]:
        """Take the lock for one answer, and as much time for counting as there is for it."""
        with self._lock:
            self._finished.refresh()
            self._until = time.monotonic() + COUNTING_SECONDS
            yield

    def _listing(self, path: Path, spec: RunSpec | None = None) -> RunListing | None:
        """Return a run's listing as far as counted; under this `spec`, if it is over."""
        return self._finished.find(path, spec) or self._counted(path)

    def _counted(self, path: Path) -> RunListing | None:
        """Count a run's new rows while there is time."""
        count = self._counts.get(path)
        if time.monotonic() > self._until:
            return count.listing if count else None
        with Journal.open(path) as journal:
            spec = journal.spec
            if count is None or count.spec != spec or count.rows > journal.count:
                count = self._counts[path] = CountedRun(spec)
            try:
                count.count(journal, self._until)
            except FolderError:  # rows before the damage were counted, and would be once more
                del self._counts[path]
                raise
            return count.listing

    def _list_objects(self) -> tuple[list[ObjectListing], int]:
        from qdgrasp_tools.campaign.object_library import read_skip_report
        from qdgrasp_tools.campaign.summaries import list_objects

        paths = {path.name: path for path in _run_paths(self._path)}
        specs, begun, uncounted = self._specs(paths), dict[str, RunListing](), 0
        for name in (name for name in specs if name in paths):
            with suppress(InputError):  # there may be no journal yet, or no good one
                if found := self._listing(paths[name], specs[name]):
                    begun[name] = found
                else:
                    uncounted += 1
        return list_objects(specs, begun, read_skip_report(self._path / SKIPPED)), uncounted

    def _specs(self, begun: Mapping[str, Path]) -> Mapping[str, RunSpec]:
        """Return the runs of the campaign, or those that have begun and whose spec is good, by name."""
        from qdgrasp_tools.campaign.campaign_file import read_campaign

        file = self._path / CAMPAIGN
        if not file.is_file():
            specs = dict[str, RunSpec]()
            for name, path in begun.items():
                with suppress(InputError):
                    specs[name] = RunFolder(path).spec
            return specs
        if self._campaign[0] != (changed := file.stat().st_mtime):
            self._campaign = changed, read_campaign(file, here=False).runs
        return self._campaign[1]


def _run_paths(job: Path) -> list[Path]:
    return JobFolder(job).run_paths if JobFolder.is_job(job) else []


def _listings(listings: list[RunListing | None]) -> RunListings:
    """Make an answer of these listings; None stands for one not counted yet."""
    return RunListings(
        runs=[listing for listing in listings if listing is not None],
        uncounted=listings.count(None),
    )


class QueryServer(ExitStack):
    """Answers queries on a job's folder: runs, objects, finds and scenes (docs/bus.md)."""

    def __init__(self, bus: Bus, job: str, path: Path) -> None:
        super().__init__()
        self._bus = bus
        self._keys = Keys(job)
        self._path = path
        self._index = RunIndex(path)
        self._bundle = lru_cache(SCENES_KEPT)(self._read)  # the bytes of a scene by its digest

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
            return to_json(self._index.objects(_number(query, "from")))
        except InputError as error:
            raise Refused(str(error)) from None

    def finds(self, query: Query) -> bytes:
        """Return successes of the run `run` from journal number `from` on."""
        from qdgrasp_tools.report.run_report import row_context

        run = _parameters(query).get("run", "")
        path = JobFolder(self._path).run_path(run)
        if not NAME.fullmatch(run) or not RunFolder.is_run(path):
            raise Refused(f"this recorder has no run '{run[:64]}'")
        try:
            with Journal.open(path) as journal:
                context = row_context(RunFolder(path), journal)
                page, upto = success_page(journal, _number(query, "from"), context)
                return messages.encode(page_to_message(page, upto, journal, run))
        except InputError as error:
            raise Refused(str(error)) from None

    def scene(self, query: Query) -> bytes:
        """Return one chunk of a scene."""
        digest = last_chunk(query.key)
        return answer_chunk(query, self._bundle(digest), digest)

    def _read(self, digest: str) -> bytes:
        """Return the bytes of a scene, from the folder of any run that has it."""
        for path in self._index.paths_of(digest):
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
