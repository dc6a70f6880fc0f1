"""Records of runs: successes and scenes, over the bus or from folders at hand."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from shlex import quote
from socket import gethostname
from typing import NamedTuple, Protocol

import msgspec

from qdgrasp_assets.scene import Scene, unpack_scene
from qdgrasp_coordinator.metrics.job_status import RunListing, RunListings
from qdgrasp_coordinator.metrics.run_stats import GrowthCurve, count_rows
from qdgrasp_coordinator.report.row_report import RowContextCache
from qdgrasp_coordinator.storage import atomic_files, success_pages
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_coordinator.storage.success_pages import SuccessTable, page_from_message
from qdgrasp_protocol import bundle_transfer, messages
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.errors import FolderError, MessageError, UnknownName
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import SuccessPage
from qdgrasp_protocol.text import printable

COMMANDS = (
    "qdgrasp show {folder} --grasp {number}",
    "qdgrasp render {folder} --grasp {number} -o grasp.png",
)
"""What can be done with one row of a run."""


class JournalId(NamedTuple):
    """Which journal it is: in another one of the same names, the same numbers are of other rows."""

    scene: str
    """sha256 of the scene bundle."""
    began: float
    """When it was begun [s since 1970]."""


class RunLocation(NamedTuple):
    """Where a run lies."""

    folder: str
    """Its path."""
    host: str = ""
    """On which machine; empty: on this one."""

    def commands(self, number: int) -> list[str]:
        """The commands that print all that is known about a row, and draw it, with the machine to run on."""
        folder = quote(printable(self.folder))
        where = f"  # on {printable(self.host)}" if self.host else ""
        return [command.format(folder=folder, number=number) + where for command in COMMANDS]


@dataclass(frozen=True)
class RecordPage:
    """Nominal successes of a run, in journal order."""

    origin: JournalId
    """The journal they are from."""
    found: SuccessTable
    """(n,)."""
    next: int
    """The journal number from which to read on."""
    rows: int
    """How many rows the journal has.

    With `next` there nothing is left to read for now; nor where it does not get on, as successes that lack
    trials are told again.
    """

    def is_last(self, first: int) -> bool:
        """Whether nothing is left to read for now, where this was read from journal number `first` on."""
        return self.next >= self.rows or self.next <= first


class Records(Protocol):
    """Finds and scenes of runs. Its methods may take a while; they may be called from several threads.

    Raises
    ------
    InputError
        From any method: there is no such job or run, or it cannot be read.
    BusError, MessageError
        From any method: nobody answers, or not as agreed.
    """

    def scene(self, job: str, run: str, digest: str) -> Scene:
        """What a run grasps, and with which hand: the scene that `page` told of."""

    def page(self, job: str, run: str, first: int) -> RecordPage:
        """Some successes of a run from journal number `first` on; more by asking again with `next`."""

    def entries(self, job: str) -> RunListings:
        """The runs of a job, finished ones too; those that are not counted yet are left out for now."""

    def curve(self, job: str, run: str) -> GrowthCurve:
        """How the run grew from its beginning on, also where it is over; no points: nobody knows."""

    def place(self, job: str, run: str) -> RunLocation:
        """Where the run lies."""


@dataclass(frozen=True)
class FolderJob:
    """A job in a folder."""

    folder: JobFolder
    named: frozenset[Path] | None = None
    """The folders of those of its runs that are shown; None: all, also those that are begun later."""

    @property
    def runs(self) -> dict[str, RunFolder]:
        """Its runs by their names, which may go anywhere."""
        paths = self.folder.run_paths if self.named is None else sorted(self.named)
        folders = [RunFolder(path) for path in paths if RunFolder.is_run(path)]
        return {printable(folder.run): folder for folder in folders}

    def with_run(self, path: Path) -> "FolderJob":
        """With this one of its runs too."""
        return self if self.named is None else FolderJob(self.folder, self.named | {path})


class FolderIndex:
    """The jobs in folders: runs, campaigns, runs of campaigns, and folders that hold such folders.

    Raises
    ------
    NoFolder, FolderError
        A path is no folder, or there is none in it.
    """

    def __init__(self, paths: Iterable[Path]) -> None:
        found: dict[Path, FolderJob] = {}
        for path in paths:
            for folder, run in _jobs_at(path):
                place = folder.path.resolve()
                if run is None:
                    found[place] = FolderJob(folder)
                else:
                    found[place] = found.get(place, FolderJob(folder, frozenset())).with_run(run)
        self.jobs: dict[str, FolderJob] = {}
        for collected in found.values():
            self.jobs[_free_name(collected.folder.name, self.jobs)] = collected

    def run(self, job: str, run: str) -> RunFolder:
        """The folder of a run.

        Raises
        ------
        UnknownName
            There is no such job, or no such run in it.
        """
        if job not in self.jobs:
            raise UnknownName("job", job, self.jobs)
        runs = self.jobs[job].runs
        if run not in runs:
            raise UnknownName("run", run, runs)
        return runs[run]


def _jobs_at(path: Path) -> Iterator[tuple[JobFolder, Path | None]]:
    """The jobs at a path, and the run that is named where only one is."""
    if JobFolder.is_job(path):
        yield JobFolder(path), None
        return
    if RunFolder.is_run(path):
        yield RunFolder(path).job, path.absolute()
        return
    atomic_files.check_folder(path)
    inside = sorted(each for each in path.glob("[!.]*") if JobFolder.is_job(each))
    if not inside:
        raise FolderError(
            f"{path} holds no run and no campaign, nor does a folder in it: there is no job.json."
        )
    for each in inside:
        yield JobFolder(each), None


def _free_name(name: str, taken: dict[str, FolderJob]) -> str:
    """A name that no other has: of several jobs of one name the second is called name-2."""
    return next(each for n in count(1) if (each := name if n == 1 else f"{name}-{n}") not in taken)


class BusRecords:
    """`Records` over the bus; a scene costs the recorder its answer, and the coordinator nothing."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus

    def scene(self, job: str, run: str, digest: str) -> Scene:
        """Of the bundle that the recorder has."""
        return unpack_scene(
            bundle_transfer.fetch_bundle_from(self._bus, Keys(job).recorded_asset(digest), digest)
        )

    def page(self, job: str, run: str, first: int) -> RecordPage:
        """One answer of the recorder's."""
        payload = self._bus.ask(Keys(job).finds, parameters=f"run={run}&from={first}")
        message = messages.decode(payload, SuccessPage)
        origin = JournalId(message.scene, message.began)
        return RecordPage(origin, page_from_message(message), message.next, message.rows)

    def entries(self, job: str) -> RunListings:
        """All pages of the recorder's list, as far as it has counted."""
        first, uncounted, runs = 0, 0, list[RunListing]()
        while True:
            page = self._entries(job, f"from={first}")
            runs += page.runs
            uncounted += page.uncounted
            if page.next <= first:
                return RunListings(runs=runs, uncounted=uncounted, host=page.host)
            first = page.next

    def curve(self, job: str, run: str) -> GrowthCurve:
        """As far as the recorder has counted the run."""
        return self._entries(job, f"run={run}").curve or GrowthCurve(run=run, points=[])

    def place(self, job: str, run: str) -> RunLocation:
        """As the recorder tells; in a folder DIR for somebody to fill in while it has not counted the run."""
        told = self._entries(job, f"run={run}")
        folders = {entry.run: entry.folder for entry in told.runs}
        return RunLocation(folders.get(run) or "DIR", "" if told.host == gethostname() else told.host)

    def _entries(self, job: str, asked: str) -> RunListings:
        answer = self._bus.ask(Keys(job).entries, parameters=asked)
        try:
            return msgspec.json.decode(answer, type=RunListings)
        except msgspec.DecodeError as error:
            raise MessageError(f"not a list of runs: {error}") from None


class FolderRecords:
    """`Records` of the jobs in a collection."""

    def __init__(self, collection: FolderIndex) -> None:
        self._collection = collection
        self._legends = RowContextCache()

    def scene(self, job: str, run: str, digest: str) -> Scene:
        """Of the bundle in the run's folder."""
        return self._collection.run(job, run).scene()

    def page(self, job: str, run: str, first: int) -> RecordPage:
        """From the journal as it is now."""
        folder = self._collection.run(job, run)
        with folder.journal() as journal:
            origin = JournalId(journal.scene, journal.created if journal.count else 0.0)
            legend = self._legends.get(folder, journal)
            return RecordPage(origin, *success_pages.success_page(journal, first, legend), journal.count)

    def entries(self, job: str) -> RunListings:
        """Counted from the journals as they are now."""
        if job not in self._collection.jobs:
            raise UnknownName("job", job, self._collection.jobs)
        runs = self._collection.jobs[job].runs
        return RunListings(runs=[_entry(name, folder) for name, folder in runs.items()])

    def curve(self, job: str, run: str) -> GrowthCurve:
        """Counted from the journal as it is now."""
        folder = self._collection.run(job, run)
        with folder.journal() as journal:
            return count_rows(folder.spec, () if journal.sources else journal.blocks()).curve(run)

    def place(self, job: str, run: str) -> RunLocation:
        """Its folder, here."""
        return RunLocation(str(self._collection.run(job, run).path.absolute()))


def _entry(name: str, folder: RunFolder) -> RunListing:
    with folder.journal() as journal:
        found = count_rows(folder.spec, journal.blocks())
    return RunListing.of(name, folder.spec, folder.bundle().digest, found)
