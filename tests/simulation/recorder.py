"""A simulated recorder: the real recorder and store, on a disk in memory that outlives it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from tests.simulation.network import Asked, Network, World
from tests.simulation.process import Busy, Life, Listen, Process
from tests.simulation.worker import JOB, KEYS

from qdgrasp_coordinator.recorder.recorder import Recorder
from qdgrasp_coordinator.recorder.recorder_service import LONGEST_WAIT
from qdgrasp_coordinator.recorder.run_store import LockedJobFolder, RunStore
from qdgrasp_coordinator.recorder.run_writer import RunIdentity, RunWriter, check_same_run
from qdgrasp_coordinator.storage.journal_schema import JournalIdentity
from qdgrasp_coordinator.storage.journal_slice import JournalSlice, join_slices
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Channel, Sample
from qdgrasp_protocol.errors import DiskFull, NoReply, Refused
from qdgrasp_protocol.messages import Recorded
from qdgrasp_protocol.rows import RowShape
from qdgrasp_protocol.spec import RunSpec, from_toml

FOLDER = Path("paper")


@dataclass
class MemoryFile:
    """A journal on the disk."""

    disk: "MemoryDisk"
    run: str
    spec: RunSpec
    scene: str
    shape: RowShape
    platform: dict[str, str] = field(default_factory=dict)
    stretches: list[JournalSlice] = field(default_factory=list)
    epochs: list[int] = field(default_factory=list)
    """Whose each stretch is."""

    @property
    def count(self) -> int:
        return self.stretches[-1].stop if self.stretches else 0

    def append(self, stretch: JournalSlice, epoch: int, now: float) -> None:
        self.disk.check()
        if stretch.first != self.count:
            raise ValueError(f"row {self.count} is next, got {stretch.first}")
        self.stretches.append(stretch)
        self.epochs.append(epoch)

    def stretch(self, first: int, limit: int) -> JournalSlice:
        stop = min(first + limit, self.count)
        if first >= stop:
            return JournalSlice(first, self.shape.empty(0))
        kept = [part for part in self.stretches if part.stop > first and part.first < stop]
        return join_slices([part.part(first, stop) for part in kept])

    @property
    def journal(self) -> bytes:
        """All rows."""
        return b"".join(stretch.rows.tobytes() for stretch in self.stretches)

    def begin_turn(self, epoch: int, now: float) -> None:
        self.disk.check()

    def set_platform(self, platform: dict[str, str]) -> None:
        self.disk.check()
        self.platform = platform

    def set_spec(self, toml: str) -> None:
        self.spec = from_toml(toml)

    def cut(self, count: int) -> None:
        """Be an older copy of itself."""
        self.stretches = [part.part(0, count) for part in self.stretches if part.first < count]
        self.epochs = self.epochs[: len(self.stretches)]


@dataclass
class MemoryDisk:
    """The disk of a job's recorder; also what the real books take for their journals."""

    epoch: int = 0
    is_begun: bool = False
    is_full: bool = False
    was_restored: bool = False
    papers: dict[str, MemoryFile] = field(default_factory=dict)
    holder: object = None
    """Who holds the lock of the folder."""

    def check(self) -> None:
        if self.is_full:
            raise DiskFull("There is no room.")

    def at(self, folder: Path) -> MemoryFile:
        return self.papers[folder.name]

    def begin(self, folder: Path, identity: JournalIdentity) -> None:
        self.check()
        spec = from_toml(identity.spec)
        self.papers[folder.name] = MemoryFile(self, folder.name, spec, identity.scene, identity.shape)

    def counts(self) -> dict[str, int]:
        """How many rows are on it of each run."""
        return {run: paper.count for run, paper in self.papers.items()}

    def cut(self, counts: dict[str, int]) -> None:
        """Lose what was committed behind these numbers."""
        for run, paper in self.papers.items():
            paper.cut(counts.get(run, 0))

    def make_room(self) -> None:
        """Have room again."""
        self.is_full = False

    def restore(self, chance: Random) -> None:
        """Be an older copy of itself, with the epoch of its time."""
        share = chance.random()
        self.cut({run: int(share * count) for run, count in self.counts().items()})
        epochs = [paper.epochs[-1] for paper in self.papers.values() if paper.epochs]
        self.epoch = min(self.epoch, max(epochs, default=1))
        self.was_restored = True


class MemoryRunFolder:
    """The folder of a run."""

    def __init__(self, disk: MemoryDisk, run: str) -> None:
        self.path = FOLDER / run
        self._paper = disk.papers[run]

    @property
    def spec(self) -> RunSpec:
        return self._paper.spec

    def rewrite_spec(self, spec: RunSpec) -> None:
        self._paper.spec = spec

    def add_bundle(self, payload: bytes) -> None:
        """Nobody looks at it."""


class MemoryJobFolder:
    """The folder of a job."""

    def __init__(self, disk: MemoryDisk) -> None:
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
        return "run" not in self._disk.papers

    run_paths = ()


class MemoryLockedFolder(LockedJobFolder):
    """The real holding, without files."""

    def __init__(self, disk: MemoryDisk, job: str) -> None:
        self._disk = disk
        super().__init__(FOLDER, job)

    def begin(self, run: str, spec: RunSpec) -> None:
        self._disk.check()
        self._disk.is_begun = True
        self._look()

    def _look(self) -> None:
        if self._disk.is_begun and self._folder is None:
            self._folder = MemoryJobFolder(self._disk)  # type: ignore[assignment]
            self.epoch = max(self.epoch, self._disk.epoch)


class MemoryRunStore(RunStore):
    """The real books, on paper."""

    def __init__(self, disk: MemoryDisk, job: str) -> None:
        self._disk = disk
        self._holding = MemoryLockedFolder(disk, job)
        self._journals = disk  # type: ignore[assignment]
        self._ledgers: dict[str, RunWriter] = {}
        self._waiting: dict[str, RunWriter] = {}
        self._bare: dict[str, RunWriter] = {}
        self._find("run")
        self._platform = self._recorded_platform()

    def _recorded_platform(self) -> dict[str, str]:
        return next((paper.platform for paper in self._disk.papers.values() if paper.platform), {})

    def _check(self, subject: RunIdentity) -> None:
        ledger = self._find(subject.run)
        if ledger is not None:
            check_same_run(FOLDER, ledger.subject, subject)

    def _open(self, subject: RunIdentity) -> RunWriter:
        if subject.run not in self._disk.papers:
            self._disk.begin(FOLDER / subject.run, subject.identity)
        ledger = self._ledger(subject.run)
        ledger.begin_turn(subject.spec, self.epoch)
        return ledger

    def _find(self, run: str) -> RunWriter | None:
        if run not in self._ledgers and run in self._disk.papers:
            folder = MemoryRunFolder(self._disk, run)
            self._ledgers[run] = RunWriter(folder, self._journals, self.epoch)  # type: ignore[arg-type]
        return self._ledgers.get(run)


PATIENCE = 60.0
"""How long a full disk is waited for [s]."""


class SimulatedRecorder(Process):
    """A recorder process.

    Parameters
    ----------
    disk
        What it writes on, when nobody else does.
    latency
        The mean time of a commit [s].
    opened
        Told when it keeps the books.
    reports
        Told of each report.
    """

    def __init__(
        self,
        world: World,
        network: Network,
        name: str,
        disk: MemoryDisk,
        latency: float,
        opened: Callable[[MemoryRunStore], None],
        reports: Callable[[Recorded], None],
    ) -> None:
        self._disk = disk
        self._latency = latency
        self._opened = opened
        self._reports = reports
        self._before: dict[str, int] | None = None
        self.scribe: Recorder | None = None
        self.books: MemoryRunStore | None = None
        super().__init__(world, network, name)

    def life(self) -> Life:
        """Wait for the lock of the folder, then record."""
        while self._disk.holder is not None:
            yield Busy(1.0)
        self._disk.holder = self
        self.books = MemoryRunStore(self._disk, JOB)
        self._opened(self.books)
        self.scribe = Recorder(self.books, JOB, FOLDER, PATIENCE, self.now)
        self.network.subscribe(self.session, KEYS.outcome())
        self.network.answer(self.session, KEYS.open)
        self.network.answer(self.session, KEYS.log)
        self.network.token(self.session, KEYS.recorder_token(self.name.replace(" ", "")))
        while True:
            yield Listen(max(0.0, min(self.scribe.deadline - self.now, LONGEST_WAIT)))
            yield from self._step(self.scribe)

    def hear(self, event: object) -> None:
        """Answer a question at once where nobody waits for it in between; see `Network.ask_now`."""
        if isinstance(event, Asked) and self.scribe is not None and self.is_running:
            self.world.touched.append(self)
            event.reply(self._answer(event, self.scribe))
        elif not isinstance(event, Asked):
            super().hear(event)

    def end(self, *, flushed: bool = True) -> None:
        """Die; a commit that was under way may not be on the disk."""
        if self._before is not None and not self.is_over and self.world.chance.random() < 0.5:
            self.note("a commit is lost")
            self._disk.cut(self._before)
        if self._disk.holder is self:
            self._disk.holder = None
        super().end(flushed=flushed)

    def _answer(self, asked: Asked, scribe: Recorder) -> bytes | Exception:
        if self._before is not None:
            return NoReply("it is busy")
        try:
            return scribe.answer(asked.query, self.now)
        except (NoReply, Refused) as reason:
            return reason
        except DiskFull:
            self.world.later(0.0, self.end)
            return NoReply("its disk is full")

    def _step(self, scribe: Recorder) -> Life:
        """Hear what came, commit what is due, and say so once it is on the disk."""
        for event in self.events():
            if isinstance(event, Sample):
                scribe.take(event, self.now)
        before = self._disk.counts()
        try:
            reports = scribe.step(self.now)
        except DiskFull:
            self.note("gives a full disk up")
            return
        if self._disk.counts() != before:
            self._before = before
            yield Busy(self.world.exponential(self._latency))
            self._before = None
        for report in reports:
            self._put(report)

    def _put(self, report: Recorded) -> None:
        self._reports(report)
        encoding = messages.encoding(Recorded)
        self.network.put(self.session, KEYS.recorded, messages.encode(report), encoding, Channel.CONTROL)
