"""Records of runs: successes and scenes, over the bus or from folders at hand."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import NamedTuple, TypeAlias, TypeVar

from qdgrasp_assets.scene import Scene, unpack_scene
from qdgrasp_coordinator.metrics.job_status import ObjectListings, RunListings, from_json
from qdgrasp_coordinator.metrics.run_stats import GrowthCurve
from qdgrasp_coordinator.storage import outputs, success_pages
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_coordinator.storage.success_pages import SuccessTable, page_from_message
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus, fetch_bundle
from qdgrasp_protocol.errors import FolderError, UnknownName
from qdgrasp_protocol.keys import NAME, Keys
from qdgrasp_protocol.messages import SuccessPage
from qdgrasp_protocol.text import printable
from qdgrasp_tools.report.run_report import row_context


class JournalId(NamedTuple):
    """Identity of a journal: in another one of the same job and run, numbers are of other rows."""

    scene: str  # sha256 of the scene bundle
    began: float  # Time of its beginning [s since 1970]


@dataclass(frozen=True)
class RecordPage:
    """Nominal successes of a run, in journal order."""

    origin: JournalId
    found: SuccessTable  # (n,)
    next: int  # The journal number from which to read on
    rows: int  # Number of rows in the journal

    def is_last(self, first: int) -> bool:
        """Return whether nothing is left to read for now, if this was read from number `first` on.

        A page also does not get on where successes lack trials: these are read again.
        """
        return self.next >= self.rows or self.next <= first


@dataclass(frozen=True)
class FolderJob:
    """A job in a folder."""

    folder: JobFolder
    only: Path | None = None  # Folder of the run that is shown; None: all, also those that begin later

    @property
    def runs(self) -> dict[str, RunFolder]:
        """Its runs by their names, printable."""
        paths = self.folder.run_paths if self.only is None else [self.only]
        folders = [RunFolder(path) for path in paths if RunFolder.is_run(path)]
        return {printable(folder.run): folder for folder in folders}

    def run(self, name: str) -> RunFolder:
        """Return the folder of a run, or raise `UnknownName`."""
        if self.only is None and NAME.fullmatch(name) and RunFolder.is_run(self.folder.run_path(name)):
            return RunFolder(self.folder.run_path(name))  # without a look at thousands of others
        if name not in (runs := self.runs):
            raise UnknownName("run", name, runs)
        return runs[name]


class FolderIndex:
    """The jobs in folders: runs, campaigns, runs of campaigns, and folders of such folders.

    A path that is no folder, or holds no job, raises a `FolderError`.
    """

    def __init__(self, paths: Iterable[Path]) -> None:
        self.jobs: dict[str, FolderJob] = {}
        for path in paths:
            for job in _jobs_at(path):
                self.jobs[_free_name(job.folder.name, self.jobs)] = job

    def run(self, job: str, run: str) -> RunFolder:
        """Return the folder of a run, or raise `UnknownName`."""
        if job not in self.jobs:
            raise UnknownName("job", job, self.jobs)
        return self.jobs[job].run(run)


def _jobs_at(path: Path) -> list[FolderJob]:
    """Return the jobs at a path; of a run of a campaign that run alone."""
    if JobFolder.is_job(path):
        return [FolderJob(JobFolder(path))]
    if RunFolder.is_run(path):
        return [FolderJob(RunFolder(path).job, path.absolute())]
    outputs.check_folder(path)
    inside = sorted(each for each in path.glob("[!.]*") if JobFolder.is_job(each))
    if not inside:
        raise FolderError(
            f"{path} holds no run and no campaign, nor does a folder in it: there is no job.json."
        )
    return [FolderJob(JobFolder(each)) for each in inside]


def _free_name(name: str, taken: dict[str, FolderJob]) -> str:
    """Return a free name: of several jobs of one name the second is called name-2."""
    return next(each for n in count(1) if (each := name if n == 1 else f"{name}-{n}") not in taken)


Listings = TypeVar("Listings", RunListings, ObjectListings)


class BusRecords:
    """Records over the bus: answers of the recorder; the coordinator is not involved.

    The methods may take a while; any thread may call them. They raise `InputError` where there is no such job
    or run, or it cannot be read, and `BusError` or `MessageError` where there is no answer, or not as agreed.
    """

    def __init__(self, bus: Bus) -> None:
        self._bus = bus

    def scene(self, job: str, run: str, digest: str) -> Scene:
        """Unpack the bundle that the recorder has."""
        return unpack_scene(fetch_bundle(self._bus, Keys(job).recorded_asset(digest)))

    def page(self, job: str, run: str, first: int) -> RecordPage:
        """Return one answer of the recorder."""
        payload = self._bus.ask(Keys(job).finds, parameters=f"run={run}&from={first}")
        message = messages.decode(payload, SuccessPage)
        origin = JournalId(message.scene, message.began)
        return RecordPage(origin, page_from_message(message), message.next, message.rows)

    def entries(self, job: str) -> RunListings:
        """Read all pages of the recorder's list, as far as it has counted."""
        pages = list(self._pages(Keys(job).entries, RunListings))
        runs = [run for page in pages for run in page.runs]
        return RunListings(runs=runs, uncounted=sum(page.uncounted for page in pages))

    def objects(self, job: str) -> ObjectListings:
        """Read all pages of the recorder's table."""
        pages = list(self._pages(Keys(job).objects, ObjectListings))
        objects = [one for page in pages for one in page.objects]
        return ObjectListings(objects=objects, uncounted=pages[-1].uncounted)

    def curve(self, job: str, run: str) -> GrowthCurve:
        """Return the curve as far as the recorder has counted the run."""
        answer = self._bus.ask(Keys(job).entries, parameters=f"run={run}")
        return from_json(answer, RunListings).curve or GrowthCurve(run=run, points=[])

    def _pages(self, key: str, kind: type[Listings]) -> Iterator[Listings]:
        """Ask for one page after the other."""
        first, following = -1, 0
        while following > first:
            first = following
            page = from_json(self._bus.ask(key, parameters=f"from={first}"), kind)
            following = page.next
            yield page


class FolderRecords:
    """Records of the jobs in folders, read from their journals as they are now."""

    def __init__(self, index: FolderIndex) -> None:
        self._index = index

    def scene(self, job: str, run: str, digest: str) -> Scene:
        """Unpack the bundle in the run's folder."""
        return self._index.run(job, run).scene()

    def page(self, job: str, run: str, first: int) -> RecordPage:
        """Read one page from the journal."""
        folder = self._index.run(job, run)
        with folder.journal() as journal:
            origin = JournalId(journal.scene, journal.created if journal.count else 0.0)
            context = row_context(folder, journal)
            return RecordPage(origin, *success_pages.success_page(journal, first, context), journal.count)


Records: TypeAlias = BusRecords | FolderRecords
"""Successes and scenes of runs."""
