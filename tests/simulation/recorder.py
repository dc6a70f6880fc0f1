"""A simulated recorder: the real recorder and store, on a disk in memory that outlives it."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random

from tests.fakes.messages import put
from tests.simulation.network import Network, Question, World
from tests.simulation.process import Busy, Listen, Process, Steps
from tests.simulation.worker import JOB, KEYS

from qdgrasp_coordinator.recorder.recorder import Recorder
from qdgrasp_coordinator.recorder.recorder_service import LONGEST_WAIT
from qdgrasp_coordinator.recorder.run_writer import RunWriter, check_same_run
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.journal import JournalIdentity, JournalSlice, join_slices
from qdgrasp_coordinator.storage.journal_writer import NO_PLATFORM
from qdgrasp_protocol.bus import Channel, Sample
from qdgrasp_protocol.errors import DiskFull, NoReply, Refused
from qdgrasp_protocol.messages import Recorded
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec

FOLDER = Path("memory")


@dataclass
class MemoryFile:
    """A journal on the disk."""

    disk: "MemoryDisk"
    identity: JournalIdentity
    platform: dict[str, str] = field(default_factory=dict)
    slices: list[JournalSlice] = field(default_factory=list)
    epochs: list[int] = field(default_factory=list)
    """The epoch of each slice."""

    @property
    def count(self) -> int:
        return self.slices[-1].stop if self.slices else 0

    def append(
        self, part: JournalSlice, epoch: int, now: float, platform: Mapping[str, str] = NO_PLATFORM
    ) -> None:
        self.disk.check()
        if part.first != self.count:
            raise ValueError(f"row {self.count} is next, got {part.first}")
        self.slices.append(part)
        self.epochs.append(epoch)
        self.platform = dict(platform) or self.platform

    def slice(self, first: int, limit: int) -> JournalSlice:
        stop = min(first + limit, self.count)
        if first >= stop:
            return JournalSlice(first, self.identity.shape.empty(0))
        kept = [part for part in self.slices if part.stop > first and part.first < stop]
        return join_slices([part.part(first, stop) for part in kept])

    def blocks(self) -> Iterator[Rows]:
        for part in self.slices:
            yield part.rows

    @property
    def journal(self) -> bytes:
        """All rows."""
        return b"".join(part.rows.tobytes() for part in self.slices)

    def begin_epoch(self, epoch: int, now: float) -> None:
        self.disk.check()

    def set_spec(self, spec: RunSpec) -> None:
        self.identity = replace(self.identity, spec=spec)

    def cut(self, count: int) -> None:
        """Become an older copy of itself."""
        self.slices = [part.part(0, count) for part in self.slices if part.first < count]
        self.epochs = self.epochs[: len(self.slices)]


@dataclass
class MemoryDisk:
    """The disk of a job's recorder; also what a recorder takes for its open journals."""

    epoch: int = 0
    is_begun: bool = False
    is_full: bool = False
    was_restored: bool = False
    files: dict[str, MemoryFile] = field(default_factory=dict)
    holder: object = None
    """The process that holds the lock of the folder."""

    def check(self) -> None:
        if self.is_full:
            raise DiskFull("There is no room.")

    def at(self, folder: Path) -> MemoryFile:
        return self.files[folder.name]

    def begin(self, folder: Path, identity: JournalIdentity) -> None:
        self.check()
        self.files[folder.name] = MemoryFile(self, identity)

    def close(self, folder: Path) -> None:
        """Do nothing: what is committed is on the disk."""

    def counts(self) -> dict[str, int]:
        """Number of rows on it of each run."""
        return {run: file.count for run, file in self.files.items()}

    def cut(self, counts: dict[str, int]) -> None:
        """Lose the rows that were committed behind these numbers."""
        for run, file in self.files.items():
            file.cut(counts.get(run, 0))

    def make_room(self) -> None:
        """End the lack of room."""
        self.is_full = False

    def restore(self, chance: Random) -> None:
        """Become an older copy of itself, with the epoch of its time."""
        share = chance.random()
        self.cut({run: int(share * count) for run, count in self.counts().items()})
        epochs = [file.epochs[-1] for file in self.files.values() if file.epochs]
        self.epoch = min(self.epoch, max(epochs, default=1))
        self.was_restored = True


class MemoryRunFolder:
    """The folder of a run."""

    def __init__(self, disk: MemoryDisk, run: str) -> None:
        self.path = FOLDER / run
        self._file = disk.files[run]

    @property
    def spec(self) -> RunSpec:
        return self._file.identity.spec

    def rewrite_spec(self, spec: RunSpec) -> None:
        self._file.set_spec(spec)

    def add_bundle(self, payload: bytes) -> None:
        """Do nothing: the scene is not read."""


class MemoryJobFolder(JobFolder):
    """The folder of a job."""

    def __init__(self, disk: MemoryDisk) -> None:
        super().__init__(FOLDER)
        self._disk = disk

    @property
    def epoch(self) -> int:
        return self._disk.epoch

    identity = ""

    def set_epoch(self, epoch: int) -> None:
        self._disk.check()
        self._disk.epoch = epoch

    @property
    def is_campaign(self) -> bool:
        return "run" not in self._disk.files


class MemoryRecorder(Recorder):
    """The real recorder, with its folder and journals in memory."""

    def __init__(self, disk: MemoryDisk, job: str, disk_wait: float) -> None:
        self._memory = disk
        super().__init__(FOLDER, job, disk_wait, disk)  # type: ignore[arg-type]

    def _begin_folder(self, runs: list[JournalIdentity]) -> None:
        self._memory.check()
        self._memory.is_begun = True
        self._lock_existing()

    def _lock_existing(self) -> None:
        if self._memory.is_begun and not self._is_begun:
            self.folder = MemoryJobFolder(self._memory)
            self._is_begun = True
            self.epoch = max(self.epoch, self._memory.epoch)

    def _recorded_platform(self) -> dict[str, str]:
        return next((file.platform for file in self._memory.files.values() if file.platform), {})

    def _check_run(self, run: JournalIdentity) -> None:
        writer = self._find(run.run)
        if writer is not None:
            check_same_run(FOLDER, writer.identity, run)

    def _open(self, run: JournalIdentity) -> RunWriter:
        if run.run not in self._memory.files:
            self._memory.begin(FOLDER / run.run, run)
        writer = self._writer(run.run)
        writer.begin_epoch(run.spec, self.epoch)
        return writer

    def _find(self, run: str) -> RunWriter | None:
        if run not in self.writers and run in self._memory.files:
            folder = MemoryRunFolder(self._memory, run)
            self.writers[run] = RunWriter(folder, self._journals, self.epoch)  # type: ignore[arg-type]
        return self.writers.get(run)


PATIENCE = 60.0
"""Longest wait for a full disk [s]."""


class SimulatedRecorder(Process):
    """A recorder process on a disk, when no other process writes on it.

    Its commits take `latency` seconds on average; `opened` is called once it has the lock, `reports` with
    each report.
    """

    def __init__(
        self,
        world: World,
        network: Network,
        name: str,
        disk: MemoryDisk,
        latency: float,
        opened: Callable[[Recorder], None],
        reports: Callable[[Recorded], None],
    ) -> None:
        self._disk = disk
        self._latency = latency
        self._opened = opened
        self._reports = reports
        self._before: dict[str, int] | None = None
        self.recorder: Recorder | None = None
        super().__init__(world, network, name)

    def steps(self) -> Steps:
        """Wait for the lock of the folder, then record."""
        while self._disk.holder is not None:
            yield Busy(1.0)
        self._disk.holder = self
        self.recorder = MemoryRecorder(self._disk, JOB, PATIENCE)
        self._opened(self.recorder)
        self.network.subscribe(self.session, KEYS.outcome())
        self.network.answer(self.session, KEYS.open)
        self.network.answer(self.session, KEYS.log)
        self.network.token(self.session, KEYS.recorder_token(self.name.replace(" ", "")))
        while True:
            yield Listen(max(0.0, min(self.recorder.deadline - self.now, LONGEST_WAIT)))
            yield from self._step(self.recorder)

    def hear(self, event: object) -> None:
        """Answer a query at once when its sender does not wait in between; see `Network.ask_now`."""
        if isinstance(event, Question) and self.recorder is not None and self.is_running:
            self.world.touched.append(self)
            event.reply(self._answer(event, self.recorder))
        elif not isinstance(event, Question):
            super().hear(event)

    def end(self, *, flushed: bool = True) -> None:
        """Die; a commit that was under way may not be on the disk."""
        if self._before is not None and not self.is_over and self.world.chance.random() < 0.5:
            self.note("a commit is lost")
            self._disk.cut(self._before)
        if self._disk.holder is self:
            self._disk.holder = None
        super().end(flushed=flushed)

    def _answer(self, asked: Question, recorder: Recorder) -> bytes | Exception:
        if self._before is not None:
            return NoReply("it is busy")
        try:
            return recorder.answer(asked.query, self.now)
        except (NoReply, Refused) as reason:
            return reason
        except DiskFull:
            self.world.later(0.0, self.end)
            return NoReply("its disk is full")

    def _step(self, recorder: Recorder) -> Steps:
        """Process what came, commit what is due, and report it once it is on the disk."""
        for event in self.events():
            if isinstance(event, Sample):
                recorder.take(event, self.now)
        before = self._disk.counts()
        try:
            reports = recorder.step(self.now)
        except DiskFull:
            self.note("gives a full disk up")
            return
        if self._disk.counts() != before:
            self._before = before
            yield Busy(self.world.exponential(self._latency))
            self._before = None
        for report in reports:
            self._reports(report)
            put(self.bus, KEYS.recorded, report, Channel.CONTROL)
