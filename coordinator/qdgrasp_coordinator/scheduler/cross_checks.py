"""Cross-checks: a second worker evaluates some rows too, and a third decides what differs.

Rule 14 of docs/bus.md as plain state. Evaluation is pure, so two workers that answer differently are not both
right. Results wait here while they are in doubt: those of a worker that no other has confirmed yet,
those of rows that are being checked, and those of workers that answered differently.
"""

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from qdgrasp_coordinator.scheduler.batch_queue import Batch, RunRef, SettleReply, WorkerName
from qdgrasp_coordinator.scheduler.pipeline import Generation
from qdgrasp_coordinator.scheduler.worker import names_of
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.text import counted

CHECKED_SHARE = 0.01  # Share of the rows that are checked unless another is asked for
MOST_FAILED = 3  # Workers whose simulator may fail on a check before it ends
CHECKED_ROWS = 4  # Rows of a check; that of a worker's first answer has half as many


@dataclass(frozen=True)
class HeldResult:
    """Settled rows that are not recorded yet."""

    worker: WorkerName
    run: RunRef
    reply: SettleReply
    rows: Rows
    """With keys, genomes and results."""
    check: bytes | None
    """The id of their own check; None: they have none."""


@dataclass(eq=False)
class Check:
    """Rows that several workers evaluate."""

    run: RunRef
    rows: Generation
    answers: dict[WorkerName, bytes]
    """The answer of each worker, as the bytes of the rows."""
    is_first: bool = False
    """True: it is to confirm a worker, which then needs no other."""
    failed_on: tuple[WorkerName, ...] = ()
    """Workers whose simulator failed on the rows."""

    @property
    def is_disputed(self) -> bool:
        """True if workers answered differently."""
        return len(self.answers) > 1

    @property
    def tried_by(self) -> tuple[WorkerName, ...]:
        """The workers that have answered, and those that failed."""
        return (*self.answers, *self.failed_on)


@dataclass(frozen=True)
class CheckVerdict:
    """The end of a check."""

    run: str
    rows: int
    """Rows that were checked."""
    right: tuple[WorkerName, ...]
    """Workers that agree."""
    wrong: tuple[WorkerName, ...] = ()
    """Workers that answered otherwise."""

    def words(self, wrong: WorkerName) -> str:
        """Return a sentence for people about a worker that was wrong."""
        return (
            f"Worker {names_of([wrong])} answered {counted(self.rows, 'row')} of '{self.run}' other than "
            f"{names_of(self.right)}: it is excluded, and what is not recorded done again."
        )


@dataclass
class CheckCounts:
    """Rows of a run that a second worker has evaluated."""

    checked: int = 0
    differing: int = 0
    """Of these, rows answered by workers that were excluded."""


class CrossChecks:
    """The checks of an epoch, of a `share` of the rows, and the results that wait for them."""

    def __init__(self, share: float) -> None:
        self.excluded: set[str] = set()
        """Ids of workers that answered other than two others."""
        self._share = share
        self._confirmed: set[str] = set()
        """Ids of workers that another one has agreed with."""
        self._checks: dict[bytes, Check] = {}
        self._disputing: set[WorkerName] = set()
        """Workers that answered a check differently which is not decided."""
        self.held: list[HeldResult] = []
        """The results that wait, in the order in which they came."""

    @property
    def are_open(self) -> bool:
        """True if there are checks that have not ended."""
        return bool(self._checks)

    @property
    def disputes(self) -> Iterator[Check]:
        """Checks to which workers answered differently, and which are not decided."""
        return (check for check in self._checks.values() if check.is_disputed)

    def rows_to_check(self, batch: Batch) -> int:
        """Return how many rows of a batch are checked, 0 of most: a hash chooses the share."""
        place = f"{batch.run.run} {batch.rows.number} {batch.rows.indices[0]} {batch.rows.trials[0]}"
        rows = min(CHECKED_ROWS, len(batch))
        return rows if zlib.crc32(place.encode()) < self._share * len(batch) / rows * 2**32 else 0

    def unchecked(self) -> list[HeldResult]:
        """Return a held result of each unconfirmed worker of which no check has begun."""
        checked = {next(iter(check.answers)) for check in self._checks.values()}
        waiting = {
            result.worker: result
            for result in reversed(self.held)
            if result.worker.wid not in self._confirmed and result.worker not in checked
        }
        return list(waiting.values())

    def open(self, name: bytes, check: Check) -> None:
        """Begin a check that a worker has answered."""
        self._checks[name] = check

    def find(self, name: bytes) -> Check | None:
        """Return a check that is not decided; None: there is no such check."""
        return self._checks.get(name)

    def must_wait(self, worker: WorkerName) -> bool:
        """Return whether the results of a worker are held: it is not confirmed, or in a dispute."""
        return bool(self._share) and (worker.wid not in self._confirmed or worker in self._disputing)

    def hold(self, result: HeldResult) -> None:
        """Keep a result while it is in doubt."""
        self.held.append(result)

    def answer(self, name: bytes, worker: WorkerName, content: bytes) -> CheckVerdict | None:
        """Add an answer to a check; returns the end of the check, or None: another answer is needed."""
        check = self._checks[name]
        right = tuple(other for other, known in check.answers.items() if known == content)
        check.answers[worker] = content
        self._disputing |= set(check.answers)
        return self.decide(name, (*right, worker)) if right else None

    def decide(self, name: bytes, right: tuple[WorkerName, ...]) -> CheckVerdict:
        """End a check in favour of workers; all others that answered it are excluded."""
        check = self._end(name)
        wrong = tuple(worker for worker in check.answers if worker not in right)
        self._confirmed |= {worker.wid for worker in right}
        self._exclude(wrong)
        return CheckVerdict(check.run.run, len(check.rows), right, wrong)

    def _exclude(self, workers: tuple[WorkerName, ...]) -> None:
        """Have no answers of workers count, neither in the checks that are open."""
        self.excluded |= {worker.wid for worker in workers}
        self._confirmed -= self.excluded
        for name, check in list(self._checks.items()):
            for worker in set(workers) & check.answers.keys():
                del check.answers[worker]
            if not check.answers:
                del self._checks[name]
        self._find_disputing()

    def _find_disputing(self) -> None:
        self._disputing = {worker for check in self.disputes for worker in check.answers}

    def _end(self, name: bytes) -> Check:
        check = self._checks.pop(name)
        self._find_disputing()
        return check

    def end_hopeless(
        self, has_other: Callable[[tuple[WorkerName, ...]], bool], is_here: Callable[[WorkerName], bool]
    ) -> Iterator[tuple[bytes, CheckVerdict | None]]:
        """End checks that no other worker can decide, and yield their ids and ends.

        One with a single answer ends without a verdict; where the simulators of others failed on its rows,
        its worker counts as confirmed. A dispute waits for a worker, unless all but one of
        those that disagree have left: then that one is taken to be right.
        """
        for name, check in list(self._checks.items()):
            has_ended = name not in self._checks
            if has_ended or (has_other(check.tried_by) and len(check.failed_on) < MOST_FAILED):
                continue
            here = tuple(filter(is_here, check.answers))
            if not check.is_disputed:
                self._end(name)
                self._confirmed |= {worker.wid for worker in check.answers if check.failed_on}
                yield name, None
            elif len(here) == 1:
                yield name, self.decide(name, here)

    def take_needless(self) -> list[bytes]:
        """Forget checks of first results of workers that are confirmed by now; returns their ids."""
        needless = [
            name
            for name, check in self._checks.items()
            if check.is_first
            and not check.is_disputed
            and self._confirmed.issuperset(worker.wid for worker in check.answers)
        ]
        for name in needless:
            del self._checks[name]
        return needless

    def doubt(self, wid: str) -> None:
        """Have a worker confirmed again before its results count."""
        self._confirmed.discard(wid)

    def take_released(self, has_other: Callable[[tuple[WorkerName, ...]], bool]) -> list[HeldResult]:
        """Return the results that are not in doubt any more; they are held no longer."""
        released, held = list[HeldResult](), list[HeldResult]()
        for result in self.held:
            is_checked = result.check in self._checks or result.worker in self._disputing
            waits = is_checked or (self.must_wait(result.worker) and has_other((result.worker,)))
            (held if waits else released).append(result)
        self.held = held
        return released

    def take_excluded(self) -> list[HeldResult]:
        """Return the results of excluded workers, which do not count; they are held no longer."""
        dropped = [result for result in self.held if result.worker.wid in self.excluded]
        self.held = [result for result in self.held if result.worker.wid not in self.excluded]
        return dropped

    def withdraw(self, run: str) -> None:
        """Forget the checks and results of a run."""
        for name in [name for name, check in self._checks.items() if check.run.run == run]:
            self._end(name)
        self.held = [result for result in self.held if result.run.run != run]
