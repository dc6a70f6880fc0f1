"""The collection: jobs whose folders are at hand, by names that tell them apart."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from qdgrasp_coordinator.folders import disk
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.job_folder import JobFolder
from qdgrasp_protocol.errors import FolderError, UnknownName
from qdgrasp_protocol.printable import printable


@dataclass(frozen=True)
class Collected:
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

    def with_run(self, path: Path) -> "Collected":
        """With this one of its runs too."""
        return self if self.named is None else Collected(self.folder, self.named | {path})


class Collection:
    """The jobs in folders: runs, campaigns, runs of campaigns, and folders that hold such folders.

    Raises
    ------
    NoFolder, FolderError
        A path is no folder, or there is none in it.
    """

    def __init__(self, paths: Iterable[Path]) -> None:
        found: dict[Path, Collected] = {}
        for path in paths:
            for folder, run in _found(path):
                place = folder.path.resolve()
                if run is None:
                    found[place] = Collected(folder)
                else:
                    found[place] = found.get(place, Collected(folder, frozenset())).with_run(run)
        self.jobs: dict[str, Collected] = {}
        for collected in found.values():
            self.jobs[_free(collected.folder.name, self.jobs)] = collected

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


def _found(path: Path) -> Iterator[tuple[JobFolder, Path | None]]:
    """The jobs at a path, and the run that is named where only one is."""
    if JobFolder.is_job(path):
        yield JobFolder(path), None
        return
    if RunFolder.is_run(path):
        yield RunFolder(path).job, path.absolute()
        return
    disk.check_folder(path)
    inside = sorted(each for each in path.glob("[!.]*") if JobFolder.is_job(each))
    if not inside:
        raise FolderError(
            f"{path} holds no run and no campaign, nor does a folder in it: there is no job.json."
        )
    for each in inside:
        yield JobFolder(each), None


def _free(name: str, taken: dict[str, Collected]) -> str:
    """A name that no other has: of several jobs of one name the second is called name-2."""
    return next(each for n in count(1) if (each := name if n == 1 else f"{name}-{n}") not in taken)
