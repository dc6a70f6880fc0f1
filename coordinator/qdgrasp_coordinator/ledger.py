"""A run while it is recorded: its folder, its journal, and the rows that wait for their commit."""

import time
from contextlib import ExitStack, suppress
from pathlib import Path

import msgspec

from qdgrasp_coordinator.folder import RunFolder
from qdgrasp_coordinator.intake import Intake, Verdict
from qdgrasp_coordinator.journal_format import FILE, Identity
from qdgrasp_coordinator.journal_writer import JournalWriter
from qdgrasp_coordinator.stretch import Stretch, from_message
from qdgrasp_protocol.errors import FolderError, Refused
from qdgrasp_protocol.messages import OpenRun, Recordable
from qdgrasp_protocol.rows import Shape
from qdgrasp_protocol.spec import RunSpec, from_toml, to_toml


class Ledger:
    """The one writer of a run's folder; a context manager that holds the folder's lock.

    Raises
    ------
    FolderError
        The folder is another job's, in use, holds other files, or cannot be read.
    """

    def __init__(self, path: Path, job: str) -> None:
        self._path = path
        self._job = job
        self._held = ExitStack()
        self._folder: RunFolder | None = None
        self._journal: JournalWriter | None = None
        self._platform: dict[str, str] = {}
        self._written: dict[str, str] = {}
        self.intake = Intake(0, 0)
        """The rows that wait."""
        self._find()

    @property
    def is_open(self) -> bool:
        """A journal is there to be added to."""
        return self._journal is not None

    @property
    def journal(self) -> JournalWriter:
        """The journal.

        Raises
        ------
        Refused
            The run was not opened yet.
        """
        if self._journal is None:
            raise Refused(f"{self._path} holds no journal yet: the run was not opened")
        return self._journal

    def open(self, asked: OpenRun) -> int:
        """Open the run for a coordinator, and begin its folder and journal where there are none.

        Returns
        -------
        epoch
            The coordinator's, stored on the disk.

        Raises
        ------
        Refused
            The folder holds a run of another spec or scene.
        FolderError, DiskFull
            Something cannot be written.
        InputError
            The spec is none.
        """
        spec = from_toml(asked.spec.decode(errors="replace"), "the coordinator's spec")
        with suppress(FolderError):
            self.commit()  # rows of the coordinator before, as far as there is room
        folder = self._folder or self._enter(RunFolder.create(self._path, spec, None, job=self._job))
        self._check_same(folder, spec, asked)
        journal = self._journal or self._begin(asked)
        if journal.spec != spec:
            journal.set_spec(to_toml(spec))
        if folder.spec != spec:
            folder.rewrite_spec(spec)
        epoch = folder.job.epoch + 1
        folder.job.set_epoch(epoch)
        journal.begin_turn(epoch, time.time())
        self.intake = Intake(epoch, journal.count)
        self._platform, self._written = {}, {}
        return epoch

    def take(self, message: Recordable, now: float) -> Verdict:
        """Let rows wait for their commit.

        Raises
        ------
        MessageError
            They are not of this run's shape.
        Refused
            The run was not opened.
        """
        return self.intake.offer(message.epoch, from_message(message, self.journal.shape), now)

    def set_platform(self, platform: dict[str, str]) -> None:
        """Note the platform of the rows to come; written before the next of them, if it is new."""
        if platform != self._written:
            self._platform = platform

    def commit(self) -> None:
        """Make the waiting rows durable.

        Raises
        ------
        DiskFull
            There is no room; they go on waiting.
        """
        group = self.intake.group
        if self._folder is None or self._journal is None or group is None:
            return
        if self._folder.job.epoch < self.intake.epoch:  # the folder is a copy from before that coordinator
            self._folder.job.set_epoch(self.intake.epoch)
        if self._platform:
            self._journal.set_platform(self._platform)
            self._written, self._platform = self._platform, {}
        self._journal.append(group, self.intake.epoch, time.time())
        self.intake.committed()

    def page(self, first: int, limit: int) -> Stretch:
        """Recorded rows from number `first` on."""
        return self.journal.stretch(first, limit)

    @property
    def missing_scene(self) -> str | None:
        """The digest of the scene if its bundle is not in the folder yet."""
        if self._journal is None or self._folder is None or self._folder.has_bundle():
            return None
        return self._journal.scene

    def add_scene(self, payload: bytes) -> None:
        """Store the scene's bundle."""
        if self._folder is not None:
            self._folder.add_bundle(payload)

    def __enter__(self) -> "Ledger":
        return self

    def __exit__(self, *_: object) -> None:
        self._held.close()

    def _find(self) -> None:
        """Go on with the run that is in the folder, if one is."""
        if not RunFolder.is_run(self._path):
            RunFolder.check_free(self._path)
            return
        folder = RunFolder.open(self._path)
        if folder.job.name != self._job:
            raise FolderError(
                f"{self._path} is of job '{folder.job.name}', not '{self._job}'; say --job {folder.job.name}."
            )
        self._enter(folder)
        if (self._path / FILE).exists():
            journal = self._write(JournalWriter.open(self._path))
            self.intake = Intake(folder.job.epoch, journal.count)

    def _enter(self, folder: RunFolder) -> RunFolder:
        self._held.enter_context(folder.job.lock())
        self._folder = folder
        return folder

    def _begin(self, asked: OpenRun) -> JournalWriter:
        identity = Identity(asked.run, asked.spec.decode(), asked.scene, _shape(asked))
        return self._write(JournalWriter.create(self._path, identity))

    def _write(self, journal: JournalWriter) -> JournalWriter:
        self._journal = self._held.enter_context(journal)
        return journal

    def _check_same(self, folder: RunFolder, spec: RunSpec, asked: OpenRun) -> None:
        """Check that the coordinator carries out the run that is in the folder, with any budget."""
        journal = self._journal
        recorded = journal.spec if journal else folder.spec
        known = msgspec.structs.asdict(msgspec.structs.replace(recorded, evaluations=spec.evaluations))
        differ = [name for name, value in msgspec.structs.asdict(spec).items() if known[name] != value]
        if differ:
            raise Refused(
                f"{self._path} holds a run of another spec: {', '.join(differ)} differ; name another folder"
            )
        scene = journal.scene if journal else folder.bundle().digest if folder.has_bundle() else asked.scene
        if asked.scene != scene:
            raise Refused(
                f"{self._path} holds a run of scene {scene[:12]}, the coordinator has {asked.scene[:12]}"
            )
        if journal and (journal.run, journal.shape) != (asked.run, _shape(asked)):
            raise Refused(f"{self._path} holds run '{journal.run}' with rows of {journal.shape}")


def _shape(asked: OpenRun) -> Shape:
    return Shape(asked.genes, asked.joints, asked.descriptors)
