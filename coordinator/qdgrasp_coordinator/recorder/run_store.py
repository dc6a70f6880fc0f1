"""The runs of a job on disk, each with a writer, of one epoch and one platform.

What is not known of a run is found in its folder, so a recorder that was started again goes on with any
run.
"""

from contextlib import ExitStack, suppress
from math import inf
from pathlib import Path

from qdgrasp_coordinator.recorder.run_writer import Arrival, RunIdentity, RunWriter, check_same_run
from qdgrasp_coordinator.storage.job_folder import RUN, JobFolder
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.journal_schema import FILE
from qdgrasp_coordinator.storage.journal_slice import slice_to_message
from qdgrasp_coordinator.storage.journal_writer import OpenJournals
from qdgrasp_coordinator.storage.outputs import OutFolder
from qdgrasp_coordinator.storage.run_folder import RunFolder, platform_differences
from qdgrasp_protocol.errors import FolderError, Refused, TookOver
from qdgrasp_protocol.messages import Log, Open, Opened, Platform, Recordable
from qdgrasp_protocol.spec import RunSpec

JOB_KINDS = ("a run of its own", "a campaign")


class LockedJobFolder:
    """A job's folder, there or to be created; a context manager that holds its lock.

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
        """Epoch of the coordinator whose rows are taken; `store_epoch` writes it."""
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
        """Create the job's folder if it is missing, for this run alone or among others.

        Raises
        ------
        FolderError, DiskFull
            It cannot be created.
        """
        if self._folder is not None:
            return
        if run == RUN:
            self._hold(RunFolder.create(self.path, spec, None, job=self._job).job)
        else:
            self._hold(JobFolder.create(self.path, self._job))

    def store_epoch(self) -> None:
        """Write the epoch if the folder has a lower one, as a restored copy may."""
        if self._folder is not None and self._folder.epoch < self.epoch:
            self._folder.set_epoch(self.epoch)

    @property
    def identity(self) -> str:
        """Id that tells the job from others of its name; empty: unknown."""
        return self._folder.identity if self._folder else ""

    def run_folder(self, run: str, spec: RunSpec) -> RunFolder:
        """Return the folder of a run, created if missing."""
        job = JobFolder(self.path)
        path = job.run_path(run)
        return RunFolder(path) if RunFolder.is_run(path) else RunFolder.add(job, run, spec, None)

    def run_path(self, run: str) -> Path:
        """Return the path of a run's folder, there or not."""
        return JobFolder(self.path).run_path(run)

    @property
    def run_paths(self) -> list[Path]:
        """The folders of all runs that are there."""
        return self._folder.run_paths if self._folder else []

    def __enter__(self) -> "LockedJobFolder":
        return self

    def __exit__(self, *_: object) -> None:
        self._held.close()

    def _look(self) -> None:
        """Lock the job that is in the folder, if there is one."""
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
                f"{self.path} holds {JOB_KINDS[self._folder.is_campaign]}, the coordinator opens "
                f"{JOB_KINDS[is_campaign]}; name another folder"
            )


OPEN_JOURNALS = 64  # Most journals open at once, of three files each; reopening costs a few commits
MOST_PAGE_ITEMS = 1 << 18  # Numbers in the widest column of a page: 1 MB, the most that a message may have


class RunStore:
    """A job's runs as recorded; a context manager that holds the lock of the job's folder.

    Parameters
    ----------
    path
        The job's folder, or where it is to be: a run's own where the run is named `RUN_EVALUATIONS`, else a
        campaign's.
    open_journals
        Most journals open at once.

    Raises
    ------
    FolderError
        The folder is another job's, in use, holds other files, or cannot be read.
    """

    def __init__(self, path: Path, job: str, open_journals: int = OPEN_JOURNALS) -> None:
        with ExitStack() as held:
            self._holding = held.enter_context(LockedJobFolder(path, job))
            self._journals = held.enter_context(OpenJournals(open_journals))
            self._ledgers: dict[str, RunWriter] = {}
            self._waiting: dict[str, RunWriter] = {}
            self._bare: dict[str, RunWriter] = {}
            self._find(RUN)
            self._platform = self._recorded_platform()
            self._held = held.pop_all()

    @property
    def epoch(self) -> int:
        """Epoch of the coordinator whose rows are taken."""
        return self._holding.epoch

    @property
    def runs(self) -> list[str]:
        """The runs that are known; others may be in the folder."""
        return list(self._ledgers)

    def open(self, asked: Open) -> Opened:
        """Open runs for a coordinator, all or none; missing folders and journals are created.

        Raises
        ------
        Refused
            The coordinator was replaced, or a run is not the one that its folder holds, or was recorded on
            another platform.
        FolderError, DiskFull
            Something cannot be written.
        InputError
            A spec is not valid, or its run is to end before what is recorded of it.
        """
        self._holding.check(asked)
        subjects = [RunIdentity.of(run) for run in asked.runs]
        for subject in subjects:
            self._check(subject)
        goes_on = 0 < asked.epoch == self.epoch
        known = self._platform if goes_on else self._recorded_platform()
        platform = self._common_platform(known, asked)
        self._holding.begin(subjects[0].run, subjects[0].spec)
        if not goes_on:
            self._begin_turn(asked.epoch or self.epoch + 1)
        self._holding.store_epoch()
        self._platform = platform
        durable = [self._open(subject).intake.durable for subject in subjects]
        identity = self._holding.identity
        return Opened(epoch=self.epoch, durable=durable, platform=platform, identity=identity)

    def take(self, message: Recordable, now: float) -> Arrival:
        """Queue rows for their commit.

        Raises
        ------
        MessageError
            They do not have their run's shape.
        Refused
            The run was never opened.
        """
        ledger = self._ledger(message.run)
        if message.epoch < self.epoch:
            return Arrival.STALE
        arrival = ledger.take(message, now)
        self._holding.epoch = message.epoch
        if arrival is Arrival.TAKEN:
            self._waiting[message.run] = ledger
        return arrival

    def set_platform(self, message: Platform) -> None:
        """Set the platform of rows to come; a journal gets it before its next rows."""
        if message.epoch >= self.epoch and message.platform:
            self._platform = message.platform

    @property
    def deadline(self) -> float:
        """When the next rows are to be committed; infinite where none wait."""
        return min((ledger.intake.deadline for ledger in self._waiting.values()), default=inf)

    def due(self, now: float) -> list[str]:
        """The runs whose waiting rows are to be committed by now."""
        return [run for run, ledger in self._waiting.items() if ledger.intake.deadline <= now]

    def commit(self, run: str) -> None:
        """Make a run's waiting rows durable.

        Raises
        ------
        DiskFull
            There is no room; they go on waiting.
        """
        self._holding.store_epoch()
        self._ledgers[run].commit(self._platform)
        self._waiting.pop(run, None)

    def durable(self, run: str) -> int:
        """Return the number of a known run's rows on disk."""
        return self._ledgers[run].intake.durable

    def page(self, asked: Log) -> Recordable:
        """Return recorded rows of a run as a message.

        Raises
        ------
        Refused
            The run was never opened.
        """
        ledger = self._ledger(asked.run)
        shape = ledger.subject.shape
        limit = min(asked.limit, MOST_PAGE_ITEMS // max(shape.genes, shape.joints, shape.descriptors, 7))
        return slice_to_message(ledger.page(asked.first, limit), asked.run, self.epoch, shape)

    @property
    def missing_scenes(self) -> list[str]:
        """The digests of scenes whose bundles are not in the folders of their runs yet."""
        return sorted({ledger.subject.scene for ledger in self._bare.values()})

    def add_scene(self, digest: str, payload: bytes) -> None:
        """Store a scene's bundle where it is missing."""
        for run, ledger in list(self._bare.items()):
            if ledger.subject.scene == digest:
                ledger.add_scene(payload)
                del self._bare[run]

    def __enter__(self) -> "RunStore":
        return self

    def __exit__(self, *_: object) -> None:
        self._held.close()

    def _check(self, subject: RunIdentity) -> None:
        """Check that a run's folder holds a beginning of this run, or nothing."""
        path = self._holding.run_path(subject.run)
        ledger = self._find(subject.run)
        if ledger is not None:
            check_same_run(path, ledger.subject, subject)
            ledger.check_end(subject.spec)
        elif RunFolder.is_run(path):
            check_same_run(path, subject.begun_in(RunFolder(path)), subject)
        else:
            OutFolder(path).check()

    def _common_platform(self, platform: dict[str, str], asked: Open) -> dict[str, str]:
        """Return the platform of the job with these runs."""
        for run in asked.runs:
            ledger = self._find(run.run)
            recorded = ledger.platform if ledger else {}
            if platform and recorded and (differing := platform_differences(platform, recorded)):
                raise Refused(
                    f"run '{run.run}' was recorded on another platform than the job's rows: {differing}"
                )
            platform = platform or recorded
        return platform

    def _recorded_platform(self) -> dict[str, str]:
        """The platform of any run in the folder that has rows: all of them have the same."""
        return next(filter(None, map(_platform_of, self._holding.run_paths)), {})

    def _begin_turn(self, epoch: int) -> None:
        """Begin an epoch: rows of the one before are committed as far as there is room."""
        for run in list(self._waiting):
            with suppress(FolderError):
                self.commit(run)
        for ledger in self._ledgers.values():
            ledger.forget_waiting(epoch)
        self._waiting.clear()
        self._holding.epoch = epoch

    def _open(self, subject: RunIdentity) -> RunWriter:
        """Open a checked run in the present epoch."""
        folder = self._holding.run_folder(subject.run, subject.spec)
        if not (folder.path / FILE).is_file():
            self._journals.begin(folder.path, subject.identity)
        ledger = self._ledger(subject.run)
        ledger.begin_turn(subject.spec, self.epoch)
        return ledger

    def _ledger(self, run: str) -> RunWriter:
        ledger = self._find(run)
        if ledger is None:
            raise Refused(f"{self._holding.path} holds no journal of run '{run}': it was not opened")
        return ledger

    def _find(self, run: str) -> RunWriter | None:
        """Return a run's writer; None: it has no journal."""
        path = self._holding.run_path(run)
        if run not in self._ledgers and (path / FILE).is_file():
            self._ledgers[run] = ledger = RunWriter(RunFolder(path), self._journals, self.epoch)
            if not RunFolder(path).has_bundle():
                self._bare[run] = ledger
        return self._ledgers.get(run)


def _platform_of(path: Path) -> dict[str, str]:
    """Return the platform of a run's rows; empty if no rows can be read."""
    with suppress(FolderError), Journal.open(path) as journal:
        return journal.platform
    return {}
