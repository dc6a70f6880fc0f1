"""Exhibits: what the view in 3D shows of each run, read once for all browsers."""

import threading
import time
import zlib
from collections import OrderedDict
from collections.abc import Callable, Iterator
from functools import cached_property

import msgspec
import numpy as np

from qdgrasp_coordinator.analysis.hand import Hand, hand
from qdgrasp_coordinator.counts.entry import RunEntries
from qdgrasp_coordinator.monitor.records import Page, Records
from qdgrasp_coordinator.monitor.web import geometry
from qdgrasp_coordinator.monitor.web.voxels import Voxels
from qdgrasp_protocol.errors import BusError, InputError

RUNS = 16
"""So many runs are kept ready; the one that was not looked at for longest gives way."""
FRESH = 0.25
"""Finds that were read so recently are not asked for again [s]."""
PATIENCE = 1.0
"""So long are finds read before an answer is given with those that are there [s]."""
REPLAY = "qdgrasp show {run} --grasp {number}"


class Exhibit:
    """One run in the view; any thread may call it.

    Raises
    ------
    QdgraspError
        From any method, as `Records`.
    """

    def __init__(self, records: Records, job: str, run: str, clock: Callable[[], float]) -> None:
        self._records, self._job, self._run, self._clock = records, job, run, clock
        self._lock = threading.Lock()
        self._origin = zlib.crc32(f"{job}/{run}".encode())
        self._voxels = Voxels(self._origin)
        self._read = -FRESH

    @property
    def stage(self) -> bytes:
        """JSON of `geometry.Stage`."""
        return self._prepared[1]

    def cells(self, first: int) -> bytes:
        """A page of `voxels`, with what was found until now; or until nobody answered any more."""
        with self._lock:
            try:
                self._catch_up()
            except BusError:
                if not self._voxels.rows:
                    raise
            return self._voxels.page(first)

    def grasp(self, number: int) -> bytes:
        """JSON of `geometry.Grasp`."""
        found = self._records.page(self._job, self._run, number).found
        if not len(found) or found["number"][0] != number:
            raise InputError(f"Row {number} of the journal of '{self._run}' is no success; see the voxels.")
        command = REPLAY.format(run=self._records.name(self._job, self._run), number=number)
        return msgspec.json.encode(geometry.grasp(found[0], self._prepared[0], command))

    @cached_property
    def _prepared(self) -> tuple[Hand, bytes]:
        """The hand, and the stage as JSON."""
        scene = self._records.scene(self._job, self._run)
        made = hand(scene.gripper)
        return made, msgspec.json.encode(geometry.stage(scene, made))

    def _catch_up(self) -> None:
        """Read what was found since, for as long as that may take."""
        began = self._clock()
        if began - self._read < FRESH and self._voxels.next >= self._voxels.rows:
            return
        pages = list(self._pages(began + PATIENCE))
        if pages[-1].rows < self._voxels.next:  # another journal, or one that fell back
            self._origin = (self._origin + 1) % (1 << 32)
            self._voxels = Voxels(self._origin)
            pages = list(self._pages(began + PATIENCE))
        self._voxels.insert(np.concatenate([page.found for page in pages]), pages[-1].next, pages[-1].rows)
        self._read = self._clock()

    def _pages(self, until: float) -> Iterator[Page]:
        """What was found since, page by page; at least one."""
        first = self._voxels.next
        while True:
            page = self._records.page(self._job, self._run, first)
            yield page
            first = page.next
            if first >= page.rows or self._clock() > until:
                return


class Exhibits:
    """The `Library` of records.

    Parameters
    ----------
    clock
        Gives the time [s].
    """

    def __init__(self, records: Records, clock: Callable[[], float] = time.monotonic) -> None:
        self._records, self._clock = records, clock
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[str, str], Exhibit] = OrderedDict()

    def runs(self, job: str) -> bytes:
        """JSON of `RunEntries`."""
        return msgspec.json.encode(RunEntries(runs=self._records.entries(job)))

    def scene(self, job: str, run: str) -> bytes:
        """JSON of `geometry.Stage`."""
        return self._of(job, run).stage

    def cells(self, job: str, run: str, since: int) -> bytes:
        """A page of `voxels`."""
        return self._of(job, run).cells(since)

    def grasp(self, job: str, run: str, number: int) -> bytes:
        """JSON of `geometry.Grasp`."""
        return self._of(job, run).grasp(number)

    def _of(self, job: str, run: str) -> Exhibit:
        with self._lock:
            kept = self._kept.pop((job, run), None) or Exhibit(self._records, job, run, self._clock)
            self._kept[job, run] = kept
            if len(self._kept) > RUNS:
                self._kept.popitem(last=False)
            return kept
