"""Caches what the view in 3D shows of each run, read once for all browsers.

One thread asks for an answer at a time; the others take what is there.
"""

import threading
import time
import zlib
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from copy import copy
from dataclasses import dataclass
from math import inf
from typing import Generic, TypeVar

import msgspec
import numpy as np
from msgspec.structs import replace

from qdgrasp_coordinator.metrics.job_status import RunListings
from qdgrasp_coordinator.metrics.run_stats import GrowthCurve
from qdgrasp_coordinator.monitor.records import JournalId, RecordPage, Records
from qdgrasp_coordinator.monitor.web import scene_data
from qdgrasp_coordinator.monitor.web.scene_data import VoxelPages
from qdgrasp_coordinator.rendering.hand_geometry import HandGeometry, hand_geometry
from qdgrasp_protocol.errors import BusError, InputError, NoReply, QdgraspError

WAIT_SECONDS = 1.0  # So long is waited for whoever asks first [s]
BUSY_MESSAGE = 3.0  # So long is nobody asked who gave no answer [s]

T = TypeVar("T")
K = TypeVar("K", bound=Hashable)


class TtlCache(Generic[T]):
    """The latest answer to a question that may take long; any thread may get it.

    Parameters
    ----------
    ask
        Gives the answer; it is called with the one before, None at first.
    fresh
        How long an answer is good for [s].
    clock
        Gives the time [s].
    """

    def __init__(
        self,
        ask: Callable[[T | None], T],
        fresh: Callable[[T], float],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._ask, self._fresh, self._clock = ask, fresh, clock
        self._asking = threading.Lock()
        self._answer: T | None = None
        self._failure: QdgraspError | None = None
        self._due = float("-inf")

    def get(self) -> T:
        """The answer, asked for anew where it is due; the one before while nobody answers.

        Raises
        ------
        QdgraspError
            There is none: as `ask`, or because another thread waits for it since long.
        """
        if self._is_due and self._asking.acquire(timeout=WAIT_SECONDS if self._answer is None else 0):
            try:
                self._renew()
            finally:
                self._asking.release()
        answer, failure = self._answer, self._failure
        if answer is None or (failure is not None and not isinstance(failure, BusError)):
            raise (failure or NoReply("It is asked for already; try again.")).with_traceback(None)
        return answer

    @property
    def _is_due(self) -> bool:
        return self._clock() >= self._due

    def _renew(self) -> None:
        """Ask, unless another thread did so meanwhile."""
        if not self._is_due:
            return
        try:
            answer = self._ask(self._answer)
        except QdgraspError as error:
            self._failure, self._due = error, self._clock() + BUSY_MESSAGE
        else:
            self._answer, self._failure = answer, None
            self._due = self._clock() + self._fresh(answer)


class LruCache(Generic[K, T]):
    """A few things by name, each made when it is first asked for; what was not asked for longest gives way.

    Parameters
    ----------
    make
        Makes the thing of a name, at once.
    most
        So many are kept.
    """

    def __init__(self, make: Callable[[K], T], most: int) -> None:
        self._make, self._most = make, most
        self._lock = threading.Lock()
        self._kept: OrderedDict[K, T] = OrderedDict()

    def of(self, name: K) -> T:
        """That of a name; any thread may ask."""
        with self._lock:
            self._kept[name] = self._kept.pop(name) if name in self._kept else self._make(name)
            if len(self._kept) > self._most:
                self._kept.popitem(last=False)
            return self._kept[name]


MAX_RUNS = 16  # So many runs are kept ready; the one that was not looked at for longest gives way
MAX_JOBS = 16  # Of so many jobs the runs are kept
MAX_CURVES = 64  # Of so many runs it is kept how they grew
MAX_SCENES = 2  # So many scenes of a run: there is another one where its journal is another
FRESH_SECONDS = 0.25  # Finds that were read so recently are not asked for again [s]
LISTED_SECONDS = 5.0  # Nor is a list of runs, or a curve [s]
SCENE_WAIT_SECONDS = 1.0  # So long are finds read before an answer is given with those that are there [s]


@dataclass(frozen=True)
class JournalReading:
    """What was read of a journal."""

    origin: JournalId
    voxels: VoxelPages

    @property
    def fresh(self) -> float:
        """How long it is good for [s]."""
        return FRESH_SECONDS if self.voxels.is_whole else 0.0

    def leads_to(self, page: RecordPage) -> bool:
        """Whether a page goes on with it; False: it is of another journal, or of one that fell back."""
        return page.origin == self.origin and page.rows >= self.voxels.next

    def with_pages(self, pages: list[RecordPage]) -> "JournalReading":
        """What there is with these pages, which follow."""
        voxels, last = copy(self.voxels), pages[-1]
        before = pages[-2].next if len(pages) > 1 else voxels.next
        found = np.concatenate([page.found for page in pages])
        voxels.insert(found, last.next, is_whole=last.is_last(before))
        return JournalReading(self.origin, voxels)


@dataclass(frozen=True)
class CachedScene:
    """What stands in the view."""

    hand: HandGeometry
    stage: scene_data.BrowserScene


class RunCache:
    """One run in the view; any thread may call it.

    Raises
    ------
    QdgraspError
        From any method, as `Records`.
    """

    def __init__(self, records: Records, job: str, run: str, clock: Callable[[], float]) -> None:
        self._records, self._job, self._run, self._clock = records, job, run, clock
        self._reading = TtlCache(self._read, lambda reading: reading.fresh, clock)
        self._sceneries = LruCache(self._scenery, MAX_SCENES)

    def stage(self) -> bytes:
        """JSON of `geometry.Stage`: that of the journal of which the cells are."""
        reading = self._reading.get()
        stage = self._sceneries.of(reading.origin.scene).get().stage
        return msgspec.json.encode(replace(stage, origin=reading.voxels.origin))

    def cells(self, first: int) -> bytes:
        """A page of `voxels`, with what was found until now; or until nobody answered any more."""
        return self._reading.get().voxels.page(first)

    def grasp(self, number: int) -> bytes:
        """JSON of `geometry.Grasp`."""
        page = self._records.page(self._job, self._run, number)
        if not len(page.found) or page.found["number"][0] != number:
            raise InputError(f"Row {number} of the journal of '{self._run}' is no success; see the voxels.")
        commands = self._records.place(self._job, self._run).commands(number)
        scenery = self._sceneries.of(page.origin.scene).get()
        return msgspec.json.encode(
            scene_data.grasp_view(page.found[0], scenery.hand, scenery.stage, commands)
        )

    def _scenery(self, digest: str) -> TtlCache[CachedScene]:
        return TtlCache(lambda _: self._prepare(digest), lambda _: inf, self._clock)

    def _prepare(self, digest: str) -> CachedScene:
        scene = self._records.scene(self._job, self._run, digest)
        made = hand_geometry(scene.gripper)
        return CachedScene(made, scene_data.browser_scene(scene, made))

    def _read(self, before: JournalReading | None) -> JournalReading:
        """Read what was found since, for as long as that may take."""
        pages = self._pages(before.voxels.next if before else 0)
        if before and before.leads_to(pages[0]):
            return before.with_pages(pages)
        if before:
            pages = self._pages(0)
        return JournalReading(pages[0].origin, VoxelPages(self._number(pages[0].origin, before))).with_pages(
            pages
        )

    def _number(self, origin: JournalId, before: JournalReading | None) -> int:
        """The number of an origin, and another one where its journal fell back."""
        if before and before.origin == origin:
            return (before.voxels.origin + 1) % (1 << 32)
        return zlib.crc32(f"{self._job}/{self._run}/{origin}".encode())

    def _pages(self, first: int) -> list[RecordPage]:
        """What there is of one journal from a row on, page by page; at least one."""
        return list(self._turned(first, self._clock() + SCENE_WAIT_SECONDS))

    def _turned(self, first: int, until: float) -> Iterator[RecordPage]:
        page = self._records.page(self._job, self._run, first)
        origin = page.origin
        while page.origin == origin:
            yield page
            if page.is_last(first) or self._clock() > until:
                return
            first = page.next
            page = self._records.page(self._job, self._run, first)


class RunCaches:
    """The `RunLibrary` of records.

    Parameters
    ----------
    clock
        Gives the time [s].
    """

    def __init__(self, records: Records, clock: Callable[[], float] = time.monotonic) -> None:
        def listed(job: str) -> TtlCache[RunListings]:
            return TtlCache(lambda _: records.entries(job), lambda _: LISTED_SECONDS, clock)

        def exhibit(name: tuple[str, str]) -> RunCache:
            return RunCache(records, *name, clock)

        def grown(name: tuple[str, str]) -> TtlCache[GrowthCurve]:
            return TtlCache(lambda _: records.curve(*name), lambda _: LISTED_SECONDS, clock)

        self._lists = LruCache(listed, MAX_JOBS)
        self._curves = LruCache(grown, MAX_CURVES)
        self._exhibits = LruCache(exhibit, MAX_RUNS)

    def runs(self, job: str) -> bytes:
        """JSON of `RunListings`."""
        return msgspec.json.encode(self._lists.of(job).get())

    def curve(self, job: str, run: str) -> bytes:
        """JSON of `Curve`."""
        return msgspec.json.encode(self._curves.of((job, run)).get())

    def scene(self, job: str, run: str) -> bytes:
        """JSON of `geometry.Stage`."""
        return self._exhibits.of((job, run)).stage()

    def cells(self, job: str, run: str, since: int) -> bytes:
        """A page of `voxels`."""
        return self._exhibits.of((job, run)).cells(since)

    def grasp(self, job: str, run: str, number: int) -> bytes:
        """JSON of `geometry.Grasp`."""
        return self._exhibits.of((job, run)).grasp(number)
