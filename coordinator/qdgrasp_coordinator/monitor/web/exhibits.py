"""Exhibits: what the view in 3D shows of each run, read once for all browsers."""

import time
import zlib
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass
from math import inf

import msgspec
import numpy as np
from msgspec.structs import replace

from qdgrasp_coordinator.analysis.hand import Hand, hand
from qdgrasp_coordinator.counts.curve import Curve
from qdgrasp_coordinator.counts.entry import RunEntries
from qdgrasp_coordinator.monitor.records import JournalId, Page, Records
from qdgrasp_coordinator.monitor.web import geometry
from qdgrasp_coordinator.monitor.web.kept import Kept, Shelf
from qdgrasp_coordinator.monitor.web.voxels import Voxels
from qdgrasp_protocol.errors import InputError

RUNS = 16
"""So many runs are kept ready; the one that was not looked at for longest gives way."""
JOBS = 16
"""Of so many jobs the runs are kept."""
CURVES = 64
"""Of so many runs it is kept how they grew."""
SCENES = 2
"""So many scenes of a run: there is another one where its journal is another."""
FRESH = 0.25
"""Finds that were read so recently are not asked for again [s]."""
LISTED = 5.0
"""Nor is a list of runs, or a curve [s]."""
PATIENCE = 1.0
"""So long are finds read before an answer is given with those that are there [s]."""


@dataclass(frozen=True)
class Reading:
    """What was read of a journal."""

    origin: JournalId
    voxels: Voxels

    @property
    def fresh(self) -> float:
        """How long it is good for [s]."""
        return FRESH if self.voxels.is_whole else 0.0

    def leads_to(self, page: Page) -> bool:
        """Whether a page goes on with it; False: it is of another journal, or of one that fell back."""
        return page.origin == self.origin and page.rows >= self.voxels.next

    def with_pages(self, pages: list[Page]) -> "Reading":
        """What there is with these pages, which follow."""
        voxels, last = copy(self.voxels), pages[-1]
        before = pages[-2].next if len(pages) > 1 else voxels.next
        found = np.concatenate([page.found for page in pages])
        voxels.insert(found, last.next, is_whole=last.is_last(before))
        return Reading(self.origin, voxels)


@dataclass(frozen=True)
class Scenery:
    """What stands in the view."""

    hand: Hand
    stage: geometry.Stage


class Exhibit:
    """One run in the view; any thread may call it.

    Raises
    ------
    QdgraspError
        From any method, as `Records`.
    """

    def __init__(self, records: Records, job: str, run: str, clock: Callable[[], float]) -> None:
        self._records, self._job, self._run, self._clock = records, job, run, clock
        self._reading = Kept(self._read, lambda reading: reading.fresh, clock)
        self._sceneries = Shelf(self._scenery, SCENES)

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
        return msgspec.json.encode(geometry.grasp(page.found[0], scenery.hand, scenery.stage, commands))

    def _scenery(self, digest: str) -> Kept[Scenery]:
        return Kept(lambda _: self._prepare(digest), lambda _: inf, self._clock)

    def _prepare(self, digest: str) -> Scenery:
        scene = self._records.scene(self._job, self._run, digest)
        made = hand(scene.gripper)
        return Scenery(made, geometry.stage(scene, made))

    def _read(self, before: Reading | None) -> Reading:
        """Read what was found since, for as long as that may take."""
        pages = self._pages(before.voxels.next if before else 0)
        if before and before.leads_to(pages[0]):
            return before.with_pages(pages)
        if before:
            pages = self._pages(0)
        return Reading(pages[0].origin, Voxels(self._number(pages[0].origin, before))).with_pages(pages)

    def _number(self, origin: JournalId, before: Reading | None) -> int:
        """The number of an origin, and another one where its journal fell back."""
        if before and before.origin == origin:
            return (before.voxels.origin + 1) % (1 << 32)
        return zlib.crc32(f"{self._job}/{self._run}/{origin}".encode())

    def _pages(self, first: int) -> list[Page]:
        """What there is of one journal from a row on, page by page; at least one."""
        return list(self._turned(first, self._clock() + PATIENCE))

    def _turned(self, first: int, until: float) -> Iterator[Page]:
        page = self._records.page(self._job, self._run, first)
        origin = page.origin
        while page.origin == origin:
            yield page
            if page.is_last(first) or self._clock() > until:
                return
            first = page.next
            page = self._records.page(self._job, self._run, first)


class Exhibits:
    """The `Library` of records.

    Parameters
    ----------
    clock
        Gives the time [s].
    """

    def __init__(self, records: Records, clock: Callable[[], float] = time.monotonic) -> None:
        def listed(job: str) -> Kept[RunEntries]:
            return Kept(lambda _: records.entries(job), lambda _: LISTED, clock)

        def exhibit(name: tuple[str, str]) -> Exhibit:
            return Exhibit(records, *name, clock)

        def grown(name: tuple[str, str]) -> Kept[Curve]:
            return Kept(lambda _: records.curve(*name), lambda _: LISTED, clock)

        self._lists = Shelf(listed, JOBS)
        self._curves = Shelf(grown, CURVES)
        self._exhibits = Shelf(exhibit, RUNS)

    def runs(self, job: str) -> bytes:
        """JSON of `RunEntries`."""
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
