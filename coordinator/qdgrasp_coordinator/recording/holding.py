"""A job's folder while its recorder holds it: the lock, the epoch, and which runs may be in it."""

from contextlib import ExitStack
from pathlib import Path

from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.job_folder import RUN, JobFolder
from qdgrasp_coordinator.folders.outputs import OutFolder
from qdgrasp_protocol.errors import FolderError, Refused, TookOver
from qdgrasp_protocol.messages import Open
from qdgrasp_protocol.spec import RunSpec

KINDS = ("a run of its own", "a campaign")


class Holding:
    """The folder of a job, or where it is to be; a context manager that holds its lock from its beginning on.

    Raises
    ------
    FolderError
        The folder is another job's, in use, holds other files, or cannot be read.
    """

    def __init__(self, path: Path, job: str) -> None:
        self.path = path
        self._job = job
        self._held = ExitStack()
        self._folder: JobFolder | None = None
        self.epoch = 0
        """Of the coordinator whose rows are taken; `store_epoch` brings it to the disk."""
        self._look()

    def check(self, asked: Open) -> None:
        """Check that these runs may be opened here, now, and at once.

        Raises
        ------
        Refused
            They may not.
        """
        runs = [run.run for run in asked.runs]
        if asked.job != self._job:
            raise Refused(f"this recorder keeps the runs of job '{self._job}', not of '{asked.job}'")
        if 0 < asked.epoch < self.epoch:
            raise TookOver.refusal(asked.epoch, self.epoch)
        if not runs or len(set(runs)) < len(runs):
            raise Refused(f"expected different runs to open, got {runs}")
        if RUN in runs and len(runs) > 1:
            raise Refused(f"'{RUN}' is the name of a run of its own, which has no others beside it")
        self._check_kind(RUN not in runs)

    def begin(self, run: str, spec: RunSpec) -> None:
        """Begin the job's folder where there is none, for this run among others or alone.

        Raises
        ------
        FolderError, DiskFull
            It cannot be made.
        """
        if self._folder is not None:
            return
        if run == RUN:
            self._hold(RunFolder.create(self.path, spec, None, job=self._job).job)
        else:
            self._hold(JobFolder.create(self.path, self._job))

    def store_epoch(self) -> None:
        """Bring the epoch to the disk unless it is there; the folder may be a copy from before."""
        if self._folder is not None and self._folder.epoch < self.epoch:
            self._folder.set_epoch(self.epoch)

    @property
    def identity(self) -> str:
        """What tells the job from others of its name; empty: not known."""
        return self._folder.identity if self._folder else ""

    def run_folder(self, run: str, spec: RunSpec) -> RunFolder:
        """The folder of a run, begun where there is none."""
        job = JobFolder(self.path)
        path = job.run_path(run)
        return RunFolder(path) if RunFolder.is_run(path) else RunFolder.add(job, run, spec, None)

    def run_path(self, run: str) -> Path:
        """Where the folder of a run is, or is to be."""
        return JobFolder(self.path).run_path(run)

    @property
    def run_paths(self) -> list[Path]:
        """The folders of all runs that are there."""
        return self._folder.run_paths if self._folder else []

    def __enter__(self) -> "Holding":
        return self

    def __exit__(self, *_: object) -> None:
        self._held.close()

    def _look(self) -> None:
        """Take hold of the job that is in the folder, if one is."""
        if not JobFolder.is_job(self.path):
            OutFolder(self.path).check()
            return
        folder = JobFolder(self.path)
        if folder.name != self._job:
            raise FolderError(
                f"{self.path} is of job '{folder.name}', not '{self._job}'; say --job {folder.name}."
            )
        self._hold(folder)

    def _hold(self, folder: JobFolder) -> None:
        self._held.enter_context(folder.lock())
        self._folder = folder
        self.epoch = max(self.epoch, folder.epoch)

    def _check_kind(self, is_campaign: bool) -> None:
        """Check that a run of its own and a campaign's runs are not mixed in one folder."""
        if self._folder is not None and self._folder.is_campaign != is_campaign:
            raise Refused(
                f"{self.path} holds {KINDS[self._folder.is_campaign]}, the coordinator opens "
                f"{KINDS[is_campaign]}; name another folder"
            )
