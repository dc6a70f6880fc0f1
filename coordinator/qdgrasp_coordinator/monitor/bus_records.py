"""Records of jobs that go on: what their recorders answer."""

from socket import gethostname

import msgspec

from qdgrasp_assets.scene import Scene, unpack_scene
from qdgrasp_coordinator.counts.curve import Curve
from qdgrasp_coordinator.counts.entry import RunEntries, RunEntry
from qdgrasp_coordinator.counts.finds import from_message
from qdgrasp_coordinator.monitor.records import JournalId, Page, Place
from qdgrasp_protocol import chunks, codec
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Finds


class BusRecords:
    """`Records` over the bus; a scene costs the recorder its answer, and the coordinator nothing."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus

    def scene(self, job: str, run: str, digest: str) -> Scene:
        """Of the bundle that the recorder has."""
        return unpack_scene(chunks.gather(self._bus, Keys(job).recorded_asset(digest), digest))

    def page(self, job: str, run: str, first: int) -> Page:
        """One answer of the recorder's."""
        payload = self._bus.ask(Keys(job).finds, parameters=f"run={run}&from={first}")
        message = codec.decode(payload, Finds)
        origin = JournalId(message.scene, message.began)
        return Page(origin, from_message(message), message.next, message.rows)

    def entries(self, job: str) -> RunEntries:
        """All pages of the recorder's list, as far as it has counted."""
        first, uncounted, runs = 0, 0, list[RunEntry]()
        while True:
            page = self._entries(job, f"from={first}")
            runs += page.runs
            uncounted += page.uncounted
            if page.next <= first:
                return RunEntries(runs=runs, uncounted=uncounted, host=page.host)
            first = page.next

    def curve(self, job: str, run: str) -> Curve:
        """As far as the recorder has counted the run."""
        return self._entries(job, f"run={run}").curve or Curve(run=run, points=[])

    def place(self, job: str, run: str) -> Place:
        """As the recorder tells; in a folder DIR for somebody to fill in while it has not counted the run."""
        told = self._entries(job, f"run={run}")
        folders = {entry.run: entry.folder for entry in told.runs}
        return Place(folders.get(run) or "DIR", "" if told.host == gethostname() else told.host)

    def _entries(self, job: str, asked: str) -> RunEntries:
        answer = self._bus.ask(Keys(job).entries, parameters=asked)
        try:
            return msgspec.json.decode(answer, type=RunEntries)
        except msgspec.DecodeError as error:
            raise MessageError(f"not a list of runs: {error}") from None
