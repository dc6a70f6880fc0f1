"""The books of a job: a ledger for each of its runs, all of one epoch and one platform.

What is not known of a run is found in its folder, so a recorder that was started again goes on with any run.
"""

from contextlib import ExitStack, suppress
from math import inf
from pathlib import Path

from qdgrasp_coordinator.counts.stretch import to_message
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.job_folder import RUN
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_coordinator.folders.journal_format import FILE
from qdgrasp_coordinator.folders.journals import Journals
from qdgrasp_coordinator.folders.outputs import OutFolder
from qdgrasp_coordinator.folders.platforms import differences
from qdgrasp_coordinator.recording.holding import Holding
from qdgrasp_coordinator.recording.intake import Arrival
from qdgrasp_coordinator.recording.ledger import Ledger
from qdgrasp_coordinator.recording.subject import Subject, check_same
from qdgrasp_protocol.errors import FolderError, Refused
from qdgrasp_protocol.messages import Log, Open, Opened, Platform, Recordable

OPEN_JOURNALS = 64
"""The most journals that are open at once, of three files each; opening one again costs a few commits."""
PAGE_ITEMS = 1 << 18
"""Numbers in the widest column of a page: 1 MB, the most that a message may have."""


class Books:
    """What a recorder keeps of a job; a context manager that holds the lock of the job's folder.

    Parameters
    ----------
    path
        The job's folder, or where it is to be: a run's own where the run is named `RUN`, else a campaign's.
    open_journals
        How many journals may be open at once.

    Raises
    ------
    FolderError
        The folder is another job's, in use, holds other files, or cannot be read.
    """

    def __init__(self, path: Path, job: str, open_journals: int = OPEN_JOURNALS) -> None:
        with ExitStack() as held:
            self._holding = held.enter_context(Holding(path, job))
            self._journals = held.enter_context(Journals(open_journals))
            self._ledgers: dict[str, Ledger] = {}
            self._waiting: dict[str, Ledger] = {}
            self._bare: dict[str, Ledger] = {}
            self._find(RUN)
            self._platform = self._recorded_platform()
            self._held = held.pop_all()

    @property
    def epoch(self) -> int:
        """Of the coordinator whose rows are taken."""
        return self._holding.epoch

    @property
    def runs(self) -> list[str]:
        """The runs that are known; others may be in the folder."""
        return list(self._ledgers)

    def open(self, asked: Open) -> Opened:
        """Open runs for a coordinator, all or none; what is not there of their folders is begun.

        Raises
        ------
        Refused
            The coordinator was replaced, or a run is not the one that its folder holds, or was recorded on
            another platform.
        FolderError, DiskFull
            Something cannot be written.
        InputError
            A spec is none, or its run is to end before what is recorded of it.
        """
        self._holding.check(asked)
        subjects = [Subject.of(run) for run in asked.runs]
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
        """Let rows wait for their commit.

        Raises
        ------
        MessageError
            They are not of their run's shape.
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
        """Note the platform of the rows to come; a journal that has another gets it before its next rows."""
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
        """How many rows of a known run are on the disk."""
        return self._ledgers[run].intake.durable

    def page(self, asked: Log) -> Recordable:
        """Recorded rows of a run, as they travel.

        Raises
        ------
        Refused
            The run was never opened.
        """
        ledger = self._ledger(asked.run)
        shape = ledger.subject.shape
        limit = min(asked.limit, PAGE_ITEMS // max(shape.genes, shape.joints, shape.descriptors, 7))
        return to_message(ledger.page(asked.first, limit), asked.run, self.epoch, shape)

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

    def __enter__(self) -> "Books":
        return self

    def __exit__(self, *_: object) -> None:
        self._held.close()

    def _check(self, subject: Subject) -> None:
        """Check that a run's folder holds a beginning of this run, or nothing."""
        path = self._holding.run_path(subject.run)
        ledger = self._find(subject.run)
        if ledger is not None:
            check_same(path, ledger.subject, subject)
            ledger.check_end(subject.spec)
        elif RunFolder.is_run(path):
            check_same(path, subject.begun_in(RunFolder(path)), subject)
        else:
            OutFolder(path).check()

    def _common_platform(self, platform: dict[str, str], asked: Open) -> dict[str, str]:
        """The platform of the job with these runs in it."""
        for run in asked.runs:
            ledger = self._find(run.run)
            recorded = ledger.platform if ledger else {}
            if platform and recorded and (differing := differences(platform, recorded)):
                raise Refused(
                    f"run '{run.run}' was recorded on another platform than the job's rows: {differing}"
                )
            platform = platform or recorded
        return platform

    def _recorded_platform(self) -> dict[str, str]:
        """The platform of any run in the folder that has rows: all of them have the same."""
        return next(filter(None, map(_platform, self._holding.run_paths)), {})

    def _begin_turn(self, epoch: int) -> None:
        """Begin a coordinator's turn: rows of the one before are committed as far as there is room."""
        for run in list(self._waiting):
            with suppress(FolderError):
                self.commit(run)
        for ledger in self._ledgers.values():
            ledger.forget_waiting(epoch)
        self._waiting.clear()
        self._holding.epoch = epoch

    def _open(self, subject: Subject) -> Ledger:
        """The ledger of a run that was checked, in this turn."""
        folder = self._holding.run_folder(subject.run, subject.spec)
        if not (folder.path / FILE).is_file():
            self._journals.begin(folder.path, subject.identity)
        ledger = self._ledger(subject.run)
        ledger.begin_turn(subject.spec, self.epoch)
        return ledger

    def _ledger(self, run: str) -> Ledger:
        ledger = self._find(run)
        if ledger is None:
            raise Refused(f"{self._holding.path} holds no journal of run '{run}': it was not opened")
        return ledger

    def _find(self, run: str) -> Ledger | None:
        """The ledger of a run; None where it has no journal."""
        path = self._holding.run_path(run)
        if run not in self._ledgers and (path / FILE).is_file():
            self._ledgers[run] = ledger = Ledger(RunFolder(path), self._journals, self.epoch)
            if not RunFolder(path).has_bundle():
                self._bare[run] = ledger
        return self._ledgers.get(run)


def _platform(path: Path) -> dict[str, str]:
    """The platform of a run's rows; empty where there are none to read."""
    with suppress(FolderError), Journal.open(path) as journal:
        return journal.platform
    return {}
