"""A disk of paper: what a recorder keeps of a job, in memory, and the real books on it.

What was committed survives the recorder's death; a disk may be full for a while, or be replaced by an older
copy.
"""

from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from qdgrasp_coordinator.counts.stretch import Stretch, joined
from qdgrasp_coordinator.folders.journal_format import Identity
from qdgrasp_coordinator.recording.books import Books
from qdgrasp_coordinator.recording.holding import Holding
from qdgrasp_coordinator.recording.ledger import Ledger
from qdgrasp_coordinator.recording.subject import Subject, check_same
from qdgrasp_protocol.errors import DiskFull
from qdgrasp_protocol.rows import Shape
from qdgrasp_protocol.spec import RunSpec, from_toml

FOLDER = Path("paper")


@dataclass
class Paper:
    """A journal on the disk."""

    disk: "Disk"
    run: str
    spec: RunSpec
    scene: str
    shape: Shape
    platform: dict[str, str] = field(default_factory=dict)
    stretches: list[Stretch] = field(default_factory=list)
    epochs: list[int] = field(default_factory=list)
    """Whose each stretch is."""

    @property
    def count(self) -> int:
        return self.stretches[-1].stop if self.stretches else 0

    def append(self, stretch: Stretch, epoch: int, now: float) -> None:
        self.disk.check()
        if stretch.first != self.count:
            raise ValueError(f"row {self.count} is next, got {stretch.first}")
        self.stretches.append(stretch)
        self.epochs.append(epoch)

    def stretch(self, first: int, limit: int) -> Stretch:
        stop = min(first + limit, self.count)
        if first >= stop:
            return Stretch(first, self.shape.empty(0))
        kept = [part for part in self.stretches if part.stop > first and part.first < stop]
        return joined([part.part(first, stop) for part in kept])

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
class Disk:
    """The disk of a job's recorder; also what the real books take for their journals."""

    epoch: int = 0
    is_begun: bool = False
    is_full: bool = False
    was_restored: bool = False
    papers: dict[str, Paper] = field(default_factory=dict)
    holder: object = None
    """Who holds the lock of the folder."""

    def check(self) -> None:
        if self.is_full:
            raise DiskFull("There is no room.")

    def at(self, folder: Path) -> Paper:
        return self.papers[folder.name]

    def begin(self, folder: Path, identity: Identity) -> None:
        self.check()
        spec = from_toml(identity.spec)
        self.papers[folder.name] = Paper(self, folder.name, spec, identity.scene, identity.shape)

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


class PaperFolder:
    """The folder of a run."""

    def __init__(self, disk: Disk, run: str) -> None:
        self.path = FOLDER / run
        self._paper = disk.papers[run]

    @property
    def spec(self) -> RunSpec:
        return self._paper.spec

    def rewrite_spec(self, spec: RunSpec) -> None:
        self._paper.spec = spec

    def add_bundle(self, payload: bytes) -> None:
        """Nobody looks at it."""


class PaperJob:
    """The folder of a job."""

    def __init__(self, disk: Disk) -> None:
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


class PaperHolding(Holding):
    """The real holding, without files."""

    def __init__(self, disk: Disk, job: str) -> None:
        self._disk = disk
        super().__init__(FOLDER, job)

    def begin(self, run: str, spec: RunSpec) -> None:
        self._disk.check()
        self._disk.is_begun = True
        self._look()

    def _look(self) -> None:
        if self._disk.is_begun and self._folder is None:
            self._folder = PaperJob(self._disk)  # type: ignore[assignment]
            self.epoch = max(self.epoch, self._disk.epoch)


class PaperBooks(Books):
    """The real books, on paper."""

    def __init__(self, disk: Disk, job: str) -> None:
        self._disk = disk
        self._holding = PaperHolding(disk, job)
        self._journals = disk  # type: ignore[assignment]
        self._ledgers: dict[str, Ledger] = {}
        self._waiting: dict[str, Ledger] = {}
        self._bare: dict[str, Ledger] = {}
        self._find("run")
        self._platform = self._recorded_platform()

    def _recorded_platform(self) -> dict[str, str]:
        return next((paper.platform for paper in self._disk.papers.values() if paper.platform), {})

    def _check(self, subject: Subject) -> None:
        ledger = self._find(subject.run)
        if ledger is not None:
            check_same(FOLDER, ledger.subject, subject)

    def _open(self, subject: Subject) -> Ledger:
        if subject.run not in self._disk.papers:
            self._disk.begin(FOLDER / subject.run, subject.identity)
        ledger = self._ledger(subject.run)
        ledger.begin_turn(subject.spec, self.epoch)
        return ledger

    def _find(self, run: str) -> Ledger | None:
        if run not in self._ledgers and run in self._disk.papers:
            folder = PaperFolder(self._disk, run)
            self._ledgers[run] = Ledger(folder, self._journals, self.epoch)  # type: ignore[arg-type]
        return self._ledgers.get(run)
