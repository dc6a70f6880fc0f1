"""Records of jobs whose folders are at hand, finished or going on."""

from collections.abc import Iterable
from pathlib import Path

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.counts.entry import RunEntries, RunEntry
from qdgrasp_coordinator.counts.tally import tally
from qdgrasp_coordinator.folders import journal_finds
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.job_folder import JobFolder
from qdgrasp_coordinator.monitor.records import Origin, Page, Place
from qdgrasp_protocol.errors import UnknownName


class FolderRecords:
    """`Records` of the jobs in these folders.

    Raises
    ------
    FolderError
        A folder holds no job.
    """

    def __init__(self, paths: Iterable[Path]) -> None:
        folders = [JobFolder.open(path) for path in paths]
        self._jobs = {folder.name: folder for folder in folders}

    @property
    def runs(self) -> dict[str, list[str]]:
        """The names of each job's runs."""
        return {job: [RunFolder(path).run for path in self._jobs[job].run_paths] for job in self._jobs}

    def scene(self, job: str, run: str, digest: str) -> Scene:
        """Of the bundle in the run's folder."""
        return self._folder(job, run).scene()

    def page(self, job: str, run: str, first: int) -> Page:
        """From the journal as it is now."""
        with self._folder(job, run).journal() as journal:
            origin = Origin(journal.scene, journal.created)
            return Page(origin, *journal_finds.page(journal, first), journal.count)

    def entries(self, job: str) -> RunEntries:
        """Counted from the journals as they are now."""
        return RunEntries(runs=[_entry(self._folder(job, run)) for run in self.runs.get(job, [])])

    def place(self, job: str, run: str) -> Place:
        """Its folder, here."""
        return Place(str(self._folder(job, run).path.absolute()))

    def _folder(self, job: str, run: str) -> RunFolder:
        runs = self.runs
        if job not in runs:
            raise UnknownName("job", job, runs)
        if run not in runs[job]:
            raise UnknownName("run", run, runs[job])
        return RunFolder.open(self._jobs[job].run_path(run))


def _entry(folder: RunFolder) -> RunEntry:
    with folder.journal() as journal:
        found = tally(folder.spec, journal.blocks())
    return RunEntry.of(folder.run, folder.spec, folder.bundle().digest, found)
