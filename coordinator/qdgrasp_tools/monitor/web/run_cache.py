"""Caches of the runs in the view in 3D, read once for all browsers.

One thread at a time queries an answer; the others take the one before.
"""

import threading
import time
import zlib
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from math import inf
from typing import Generic, TypeVar

import msgspec
import numpy as np

from qdgrasp_assets.grippers.hand_geometry import HandGeometry, hand_geometry
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics.grasp_quality import recorded_margins
from qdgrasp_coordinator.metrics.job_status import ObjectListings, RunListings
from qdgrasp_coordinator.storage.success_pages import SuccessTable
from qdgrasp_protocol.errors import BusError, InputError, NoReply, QdgraspError
from qdgrasp_tools.monitor.records import BusRecords, JournalId, RecordPage, Records
from qdgrasp_tools.monitor.web.scene_data import VoxelPages, browser_scene, grasp_view
from qdgrasp_tools.rendering.views import hand_picture

WAIT_SECONDS = 1.0  # A thread waits so long for the first answer to another one's query [s]
BUSY_SECONDS = 3.0  # After a query without an answer the next one waits so long [s]
MAX_RUNS = 16  # Runs that are kept, as are the following; the longest unused gives way
MAX_JOBS = 16  # Jobs whose lists of runs are kept
MAX_CURVES = 64  # Runs whose curves are kept
MAX_GRASP_PICTURES = 64  # Pictures of grasps of a run that are kept, of some 10 kB
GRASP_PIXELS = 132, 108  # Width and height of one
FIRST_VIEW = -121.8, 26.2  # Azimuth and elevation from which the page looks at first [deg]
MAX_SCENES = 2  # Scenes of a run: another journal may have another one
FRESH_SECONDS = 0.25  # Successes are not read again for so long [s]
LISTED_SECONDS = 5.0  # Nor are lists of runs or objects, and curves [s]
SCENE_WAIT_SECONDS = 1.0  # Successes are read for so long before an answer is given with those that came [s]

T = TypeVar("T")


class TtlCache(Generic[T]):
    """The latest answer to a query that may take long; any thread may get it.

    `query` is called with the answer before, None at first; `fresh` gives the time for which an answer is
    good [s], and `clock` the time [s].
    """

    def __init__(
        self,
        query: Callable[[T | None], T],
        fresh: Callable[[T], float],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._query, self._fresh, self._clock = query, fresh, clock
        self._lock = threading.Lock()
        self._answer: T | None = None
        self._failure: QdgraspError | None = None
        self._due = -inf

    def get(self) -> T:
        """Return the answer, renewed where it is due; the one before while there is no new one.

        Without any, raise what `query` raised, or `NoReply` while another thread waits for it for long.
        """
        if self._is_due and self._lock.acquire(timeout=WAIT_SECONDS if self._answer is None else 0):
            try:
                if self._is_due:  # no other thread has queried meanwhile
                    self._renew()
            finally:
                self._lock.release()
        answer, failure = self._answer, self._failure
        if answer is None or (failure is not None and not isinstance(failure, BusError)):
            raise (failure or NoReply("It is asked for already; try again.")).with_traceback(None)
        return answer

    @property
    def _is_due(self) -> bool:
        return self._clock() >= self._due

    def _renew(self) -> None:
        try:
            answer = self._query(self._answer)
        except QdgraspError as error:
            self._failure, self._due = error, self._clock() + BUSY_SECONDS
        else:
            self._answer, self._failure = answer, None
            self._due = self._clock() + self._fresh(answer)


@dataclass(frozen=True)
class JournalReading:
    """The part of a journal that has been read."""

    origin: JournalId
    voxels: VoxelPages

    def with_pages(self, pages: list[RecordPage]) -> "JournalReading":
        """Return this with the pages that follow."""
        voxels, last = copy(self.voxels), pages[-1]
        before = pages[-2].next if len(pages) > 1 else voxels.next
        found = np.concatenate([page.found for page in pages])
        voxels.insert(found, last.next, is_whole=last.is_last(before))
        return JournalReading(self.origin, voxels)


@dataclass(frozen=True)
class LoadedScene:
    """A scene, and values that are made of it once."""

    scene: Scene
    hand: HandGeometry
    shown: dict[str, object]
    """All that the page shows of it before the first success (`browser_scene`)."""


class RunCache:
    """One run in the view; any thread may call it. Its methods raise as those of `BusRecords`."""

    def __init__(self, records: Records, job: str, run: str, clock: Callable[[], float]) -> None:
        self._records, self._job, self._run, self._clock = records, job, run, clock
        self._reading = TtlCache(self._read, lambda one: FRESH_SECONDS if one.voxels.is_whole else 0.0, clock)
        self._scenes = lru_cache(MAX_SCENES)(self._load_scene)
        self._pictures = lru_cache(MAX_GRASP_PICTURES)(self._draw)

    def scene(self) -> bytes:
        """Return JSON of the scene of the journal that the cells are from, with their `origin`."""
        reading = self._reading.get()
        shown = self._scenes(reading.origin.scene).shown
        return msgspec.json.encode(shown | {"origin": reading.voxels.origin})

    def cells(self, first: int) -> bytes:
        """Return a page of voxels from the serial `first` on, with the successes read until now."""
        return self._reading.get().voxels.page(first)

    def grasp(self, number: int) -> bytes:
        """Return JSON of the `grasp_view` of a journal row."""
        found, origin = self._success(number)
        loaded = self._scenes(origin.scene)
        (margin,) = recorded_margins(found, loaded.scene.object)
        return msgspec.json.encode(grasp_view(found[0], loaded.scene, loaded.hand, margin))

    def picture(self, number: int) -> bytes:
        """Return a picture of a journal row, the hand as it settled: PNG with a transparent ground."""
        return self._pictures(number, self._reading.get().origin)

    def _success(self, number: int) -> tuple[SuccessTable, JournalId]:
        """Read the success in a journal row: (1,), and the journal."""
        page = self._records.page(self._job, self._run, number)
        if not len(page.found) or page.found["number"][0] != number:
            raise InputError(f"Row {number} of the journal of '{self._run}' is no success; see the voxels.")
        return page.found[:1], page.origin

    def _draw(self, number: int, _journal: JournalId) -> bytes:
        """Draw the hand of a row of a journal from where the page looks at first."""
        found, origin = self._success(number)
        scene = self._scenes(origin.scene).scene
        return hand_picture(scene, found, GRASP_PIXELS, FIRST_VIEW)

    def _load_scene(self, digest: str) -> LoadedScene:
        scene = self._records.scene(self._job, self._run, digest)
        hand = hand_geometry(scene.gripper)
        return LoadedScene(scene, hand, browser_scene(scene, hand))

    def _read(self, before: JournalReading | None) -> JournalReading:
        """Read the successes since then; all of them where the journal is another, or fell back."""
        pages = self._pages(before.voxels.next if before else 0)
        if before:
            if pages[0].origin == before.origin and pages[0].rows >= before.voxels.next:
                return before.with_pages(pages)
            pages = self._pages(0)
        origin = pages[0].origin
        if before and before.origin == origin:  # the same journal, read anew: its number must be another
            number = (before.voxels.origin + 1) % (1 << 32)
        else:
            number = zlib.crc32(f"{self._job}/{self._run}/{origin}".encode())
        voxels = VoxelPages(number)
        return JournalReading(origin, voxels).with_pages(pages)

    def _pages(self, first: int) -> list[RecordPage]:
        """Read pages of one journal from a row on, at least one, for `SCENE_WAIT_SECONDS` at most."""
        until = self._clock() + SCENE_WAIT_SECONDS
        pages = [self._records.page(self._job, self._run, first)]
        while not (pages[-1].is_last(first) or self._clock() > until):
            first = pages[-1].next
            page = self._records.page(self._job, self._run, first)
            if page.origin != pages[0].origin:
                break
            pages.append(page)
        return pages


def run_caches(
    records: Records, clock: Callable[[], float] = time.monotonic
) -> Callable[[str, str], RunCache]:
    """Return a function that gives the cache of a run of a job; `clock` gives the time [s]."""
    return lru_cache(MAX_RUNS)(lambda job, run: RunCache(records, job, run, clock))


class JobCaches:
    """Caches of runs, and of lists of runs and objects.

    The methods may take a while; any thread may call them. They raise a `QdgraspError` where there is no such
    job, run or grasp, or no answer.
    """

    def __init__(self, records: BusRecords, clock: Callable[[], float] = time.monotonic) -> None:
        self.run = run_caches(records, clock)

        def kept(
            most: int, query: Callable[..., T], fresh: Callable[[T], float] = lambda _: LISTED_SECONDS
        ) -> Callable[..., TtlCache[T]]:
            return lru_cache(most)(lambda *key: TtlCache(lambda _: query(*key), fresh, clock))

        self._listings = kept(MAX_JOBS, records.entries)
        self._curves = kept(MAX_CURVES, records.curve)
        self._objects = kept(
            MAX_JOBS, records.objects, lambda found: 0 if found.uncounted else LISTED_SECONDS
        )

    def runs(self, job: str) -> bytes:
        """Return the runs of a job, finished ones too: JSON of `RunListings`."""
        return msgspec.json.encode(self._listings(job).get())

    def curve(self, job: str, run: str) -> bytes:
        """Return the growth of a run, also of one that is over: JSON of `GrowthCurve`."""
        return msgspec.json.encode(self._curves(job, run).get())

    def objects(self, job: str) -> ObjectListings:
        """Return all objects of a job, with their counts."""
        return self._objects(job).get()

    def object_runs(self, job: str, file: str) -> bytes:
        """Return the runs of one object that have begun, finished ones too: JSON of `RunListings`."""
        names = next((each.names for each in self.objects(job).objects if each.file == file), [])
        runs = [run for run in self._listings(job).get().runs if run.run in names]
        return msgspec.json.encode(RunListings(runs=runs))
