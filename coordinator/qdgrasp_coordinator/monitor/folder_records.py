"""Records of jobs whose folders are at hand, finished or going on."""

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.analysis.legends import Legends
from qdgrasp_coordinator.counts.counting import tally
from qdgrasp_coordinator.counts.curve import Curve, Trail
from qdgrasp_coordinator.counts.entry import RunEntries, RunEntry
from qdgrasp_coordinator.folders import journal_finds
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.monitor.collection import Collection
from qdgrasp_coordinator.monitor.records import JournalId, Page, Place
from qdgrasp_protocol.errors import UnknownName


class FolderRecords:
    """`Records` of the jobs in a collection."""

    def __init__(self, collection: Collection) -> None:
        self._collection = collection
        self._legends = Legends()

    def scene(self, job: str, run: str, digest: str) -> Scene:
        """Of the bundle in the run's folder."""
        return self._collection.run(job, run).scene()

    def page(self, job: str, run: str, first: int) -> Page:
        """From the journal as it is now."""
        folder = self._collection.run(job, run)
        with folder.journal() as journal:
            origin = JournalId(journal.scene, journal.created if journal.count else 0.0)
            legend = self._legends.of(folder, journal)
            return Page(origin, *journal_finds.page(journal, first, legend), journal.count)

    def entries(self, job: str) -> RunEntries:
        """Counted from the journals as they are now."""
        if job not in self._collection.jobs:
            raise UnknownName("job", job, self._collection.jobs)
        runs = self._collection.jobs[job].runs
        return RunEntries(runs=[_entry(name, folder) for name, folder in runs.items()])

    def curve(self, job: str, run: str) -> Curve:
        """Counted from the journal as it is now."""
        folder, trail = self._collection.run(job, run), Trail()
        with folder.journal() as journal:
            if not journal.sources:
                tally(folder.spec, journal.blocks(), trail)
        return trail.curve(run)

    def place(self, job: str, run: str) -> Place:
        """Its folder, here."""
        return Place(str(self._collection.run(job, run).path.absolute()))


def _entry(name: str, folder: RunFolder) -> RunEntry:
    with folder.journal() as journal:
        found = tally(folder.spec, journal.blocks())
    return RunEntry.of(name, folder.spec, folder.bundle().digest, found)
