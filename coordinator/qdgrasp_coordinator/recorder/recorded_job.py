"""The locked folder of a job, and the identities of the runs that a coordinator opens in it."""

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from qdgrasp_coordinator.storage.job_folder import RUN, JobFolder
from qdgrasp_coordinator.storage.journal import JournalIdentity
from qdgrasp_coordinator.storage.outputs import OutFolder
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import FolderError, Refused, TookOver
from qdgrasp_protocol.messages import Open, OpenRun
from qdgrasp_protocol.rows import RowShape
from qdgrasp_protocol.spec import RunSpec, differences, from_toml, to_toml

JOB_KINDS = ("a run of its own", "a campaign")


class LockedJobFolder(ExitStack):
    """A job's folder, there or to be created; a context manager that holds its lock.

    A `FolderError` says that it is another job's, in use, holds other files, or cannot be read.
    """

    def __init__(self, path: Path, job: str) -> None:
        super().__init__()
        self.job = job
        self.folder = JobFolder(path)
        self.epoch = 0  # Epoch of the coordinator whose rows are taken; `store_epoch` writes it
        self.is_begun = False
        self._lock_existing()

    def check(self, asked: Open) -> None:
        """Refuse runs that may not be opened here, now, and at once."""
        runs = [run.run for run in asked.runs]
        if asked.job != self.job:
            raise Refused(f"this recorder keeps the runs of job '{self.job}', not of '{asked.job}'")
        if 0 < asked.epoch < self.epoch:
            raise TookOver.refusal(asked.epoch, self.epoch)
        if len(set(runs)) < len(runs):
            raise Refused(f"expected different runs to open, got {runs}")
        if not runs and asked.epoch:
            raise Refused("expected runs to open in an epoch that has begun, got none")
        if RUN in runs and len(runs) > 1:
            raise Refused(f"'{RUN}' is the name of a run of its own, which has no others beside it")
        is_campaign = RUN not in runs
        if self.is_begun and self.folder.is_campaign != is_campaign:
            raise Refused(
                f"{self.folder.path} holds {JOB_KINDS[not is_campaign]}, the coordinator opens "
                f"{JOB_KINDS[is_campaign]}; name another folder"
            )

    def begin(self, first: "RunIdentity | None") -> None:
        """Create the job's folder if it is missing, for this run alone or among others.

        None: for a campaign of which no run is opened yet.
        """
        if self.is_begun:
            return
        if first is not None and first.run == RUN:
            RunFolder.create(self.folder.path, first.spec, None, job=self.job)
        else:
            JobFolder.create(self.folder.path, self.job)
        self._take_lock()

    def store_epoch(self) -> None:
        """Write the epoch if the folder has a lower one, as a restored copy may."""
        if self.is_begun and self.folder.epoch < self.epoch:
            self.folder.set_epoch(self.epoch)

    @property
    def run_paths(self) -> list[Path]:
        """The folders of all runs that are there."""
        return self.folder.run_paths if self.is_begun else []

    def _lock_existing(self) -> None:
        folder = self.folder
        if not JobFolder.is_job(folder.path):
            OutFolder(folder.path).check()
            return
        if folder.name != self.job:
            raise FolderError(
                f"{folder.path} is of job '{folder.name}', not '{self.job}'; say --job {folder.name}."
            )
        self._take_lock()

    def _take_lock(self) -> None:
        self.enter_context(self.folder.lock())
        self.is_begun = True
        self.epoch = max(self.epoch, self.folder.epoch)


@dataclass(frozen=True)
class RunIdentity:
    """A run, as a coordinator opens it or as a folder holds it."""

    run: str
    spec: RunSpec
    scene: str
    """sha256 of the scene bundle."""
    shape: RowShape

    @classmethod
    def of(cls, asked: OpenRun) -> Self:
        """Return the run that a coordinator opens; an `InputError` says what is wrong with its spec."""
        spec = from_toml(asked.spec.decode(errors="replace"), "the coordinator's spec")
        shape = RowShape(asked.genes, asked.joints, asked.descriptors, asked.contact_slots)
        return cls(asked.run, spec, asked.scene, shape)

    @property
    def for_journal(self) -> JournalIdentity:
        """The same for a new journal."""
        return JournalIdentity(self.run, to_toml(self.spec), self.scene, self.shape)


def check_same_run(path: Path, held: RunIdentity, asked: RunIdentity) -> None:
    """Refuse a run that is not the one in a folder; budget and stop criteria may differ."""
    if differ := differences(held.spec, asked.spec):
        raise Refused(f"{path} holds a run of another spec: {', '.join(differ)} differ; name another folder")
    if asked.scene != held.scene:
        raise Refused(
            f"{path} holds a run of scene {held.scene[:12]}, the coordinator has {asked.scene[:12]}"
        )
    if (asked.run, asked.shape) != (held.run, held.shape):
        raise Refused(f"{path} holds run '{held.run}' with rows of {held.shape}")
