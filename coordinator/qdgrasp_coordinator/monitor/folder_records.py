"""Records of jobs whose folders are at hand, finished or going on."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.counts.entry import RunEntry
from qdgrasp_coordinator.counts.finds import Found, found, layout, limit
from qdgrasp_coordinator.counts.tally import successful, tally
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.job_folder import JobFolder
from qdgrasp_coordinator.monitor.records import Page
from qdgrasp_protocol.errors import UnknownName
from qdgrasp_protocol.rows import Rows

SCANNED = 1 << 16
"""So many journal rows are read for one page."""


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

    def scene(self, job: str, run: str) -> Scene:
        """Of the bundle in the run's folder."""
        return self._folder(job, run).scene()

    def page(self, job: str, run: str, first: int) -> Page:
        """From the journal as it is now."""
        with self._folder(job, run).journal() as journal:
            count, joints = journal.count, journal.shape.joints
            stop, most = min(count, first + SCANNED), limit(joints)
            finds = _found(journal.kept(first, stop) if first < stop else (), first, joints)
        if len(finds) > most:
            return Page(finds[:most], int(finds["number"][most]), count)
        return Page(finds, max(first, stop), count)

    def entries(self, job: str) -> list[RunEntry]:
        """Counted from the journals as they are now."""
        return [_entry(self._folder(job, run)) for run in self.runs.get(job, [])]

    def name(self, job: str, run: str) -> str:
        """The path of its folder."""
        return str(self._folder(job, run).path)

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


def _found(blocks: Iterable[Rows], first: int, joints: int) -> Found:
    """The successes among consecutive rows, of which the first has the number `first`."""
    kept = [np.zeros(0, layout(joints))]
    for rows in blocks:
        here = np.flatnonzero(successful(rows))
        kept.append(found(rows[here], first + here, joints))
        first += len(rows)
    return np.concatenate(kept)
