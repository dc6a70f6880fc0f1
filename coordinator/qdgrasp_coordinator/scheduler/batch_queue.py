"""Batches: rows that wait for a worker, how many make a batch, and which run is next."""

import secrets
from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from math import ceil, inf, sqrt

from qdgrasp_coordinator.scheduler.pipeline import Generation
from qdgrasp_protocol.build_messages import ShapeTask
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import DEVICE_ENGINE


@dataclass(frozen=True)
class RunRef:
    """A run, as far as its batches name it."""

    run: str
    scene: str
    """The scene bundle's sha256."""
    prior: str
    engine: str | None = None
    """The physics engine; None: Bullet."""

    @property
    def needs_device(self) -> bool:
        """True if only workers with a device evaluate it."""
        return self.engine == DEVICE_ENGINE


@dataclass(eq=False, kw_only=True)
class Task:
    """A batch of rows or a build of a shape, which is leased to a worker."""

    id: bytes
    """16 bytes: random ones of the epoch and a counter, not used again in the job."""
    attempts: int = 0
    """Leases of it so far."""
    leased_at: float = inf
    """When it was leased first."""
    holders: dict[str, float] = field(default_factory=dict)
    """Workers that hold it, and when they were leased it; none: it waits."""
    leased: set[str] = field(default_factory=set)
    """All workers that were ever leased it."""


@dataclass(eq=False, kw_only=True)
class ShapeBuild(Task):
    """A shape that one worker is to build; a worker that holds one gets nothing else."""

    task: ShapeTask


@dataclass(eq=False, kw_only=True)
class Batch(Task):
    """Rows of one generation of one run that are leased together."""

    run: RunRef
    rows: Generation
    tried_by: tuple[str, ...] = ()
    """Workers whose simulator failed on this row, which is alone then: another one is to evaluate it."""
    failed_at: float = inf
    """When a worker failed first on this row."""
    may_be_shared: bool = True
    """A failure of it may have a reason that all rows share, as of its latest lease."""

    def __len__(self) -> int:
        return len(self.rows)


@dataclass(eq=False, kw_only=True)
class Probe(Batch):
    """Rows that were evaluated before, and are again: their results settle nothing."""


@dataclass(eq=False, kw_only=True)
class Audit(Probe):
    """Rows of the one worker in `tried_by`, which a trusted one evaluates again."""

    recorded: Rows
    """(n,): what that worker made of them."""
    answer: Rows | None = None
    """What a trusted worker made of them: it is to be confirmed; None: nothing yet."""


BATCH_SECONDS = 0.25  # Target duration of a batch [s]
LEAST_SECONDS = 0.02  # Shortest batch that is cut to share the end of a generation [s]
HANDLING_SECONDS = 50e-6  # Time of the coordinator's one thread per batch [s]
FIRST_ROWS = 4  # Rows in a batch while nothing is known about their cost
MOST_ROWS = 512
_MEMORY = 0.9


class BatchSizer:
    """Size of one run's batches: `fixed` rows; None: measured."""

    def __init__(self, fixed: int | None = None) -> None:
        self._fixed = fixed
        self._seconds = 0.0
        self._rows = 0.0

    @property
    def seconds_per_row(self) -> float | None:
        """CPU seconds that a row costs, the latest batches counting most; None before the first."""
        return self._seconds / self._rows if self._rows else None

    def measure(self, rows: int, cpu_seconds: float) -> None:
        """Record the cost of a batch."""
        self._seconds = _MEMORY * self._seconds + cpu_seconds
        self._rows = _MEMORY * self._rows + rows

    @property
    def full_size(self) -> int:
        """Rows of a batch that is not cut shorter to share the end of a generation."""
        return self._fixed or _rows_within(BATCH_SECONDS, self.seconds_per_row or FIRST_COST)

    def next_size(self, remaining: int, workers: int, runs: int = 1) -> int:
        """Return the number of rows of the next batch.

        The workers share the `remaining` rows of the generation, and as many of the other `runs` under way.
        Each gets at most its part of half of them, so that all are done at about the same time.
        """
        if self._fixed is not None:
            return min(self._fixed, remaining)
        cost = self.seconds_per_row
        wanted = FIRST_ROWS if cost is None else _rows_within(BATCH_SECONDS, cost)
        least = 1 if cost is None else self._least(remaining * runs, workers, cost)
        share = ceil(remaining * runs / (2 * max(workers, 1)))
        return min(remaining, max(least, min(wanted, share)))

    def _least(self, rows: int, workers: int, cost: float) -> int:
        """Return the fewest rows worth a batch: handling all must not outlast evaluating them."""
        handling = HANDLING_SECONDS / max(cost, 1e-9)
        worth = min(sqrt(rows * handling), workers * handling)
        return max(_rows_within(LEAST_SECONDS, cost), min(MOST_ROWS, int(worth)))


def _rows_within(seconds: float, cost: float) -> int:
    """Rows that fit into a time, 1 to `MOST_ROWS`."""
    return max(1, min(MOST_ROWS, int(seconds / max(cost, 1e-9))))


FIRST_COST = 0.01  # Expected cost of a row before one of its run was measured [CPU s]
SCENE_SLACK = 5.0  # CPU seconds that a run may be ahead of others on workers that hold its scene


class BatchQueue:
    """Cuts rows into batches, and takes batches back that are to be leased again."""

    def __init__(self, batch_size: int | None) -> None:
        self._prefix = secrets.token_bytes(8)
        self._batch_size = batch_size
        self._runs: dict[str, _RunBatches] = {}
        self._again: dict[bytes, Batch] = {}
        """Rows that failed, for other workers than those that had them, and audits, by their batch's id."""
        self._rows = 0
        """Number of waiting rows of all runs."""
        self._cut = 0
        self._served = 0.0

    def __bool__(self) -> bool:
        """True if rows wait that any worker may have."""
        return any(self._runs.values())

    @property
    def audits(self) -> list[Audit]:
        """Audits that wait for a trusted worker."""
        return [batch for batch in self._again.values() if isinstance(batch, Audit)]

    @property
    def tried(self) -> list[Batch]:
        """Rows that wait for other workers than those that had them, and audits."""
        return list(self._again.values())

    @property
    def seconds(self) -> float:
        """Expected cost of the waiting rows [CPU s]."""
        return sum(len(rows) * (rows.sizer.seconds_per_row or FIRST_COST) for rows in self._runs.values())

    @property
    def batches(self) -> int:
        """Number of batches of about `BATCH_SECONDS` that the waiting rows make."""
        waiting = sum(ceil(len(rows) / rows.sizer.full_size) for rows in self._runs.values())
        return waiting + sum(not isinstance(batch, Probe) for batch in self._again.values())

    def submit(self, run: RunRef, generation: Generation) -> None:
        """Take rows of one generation that were never leased."""
        waiting = self._runs.setdefault(run.run, _RunBatches(run, BatchSizer(self._batch_size)))
        if not waiting:
            waiting.served = max(waiting.served, self._served)
        waiting.uncut.append(generation)
        self._rows += len(generation)

    def withdraw(self, run: str, *, audits: bool) -> None:
        """Forget a run, and its `audits` if asked to."""
        again = (
            one
            for one in self._again.values()
            if one.run.run != run or (isinstance(one, Probe) and not audits)
        )
        self._again = {batch.id: batch for batch in again}
        if (gone := self._runs.pop(run, None)) is not None:
            self._rows -= len(gone)

    def next_run(self, scenes: Collection[str], has_device: bool = False) -> str | None:
        """Return the run served least, or within the slack one whose scene is held; None: no rows.

        A worker that has a device takes runs that need one first, and others do not take them. Of runs that
        were served equally, the eldest is first.
        """
        waiting = [rows for rows in self._runs.values() if rows and not rows.run.needs_device]
        if has_device:
            waiting = [rows for rows in self._runs.values() if rows and rows.run.needs_device] or waiting
        least = min(waiting, key=lambda rows: rows.served, default=None)
        if least is None:
            return None
        held = [rows for rows in waiting if rows.run.scene in scenes]
        least_held = min(held, key=lambda rows: rows.served, default=least)
        return (least_held if least_held.served <= least.served + SCENE_SLACK else least).run.run

    def pop(self, run: str, workers: int, at_once: int = 0) -> Batch:
        """Return the next batch of a waiting run: one queued again, or a new one.

        `workers` share the rows of a generation, and where there are other runs all that wait, or would if
        every run had as many; a device takes all of a generation, as many as it evaluates `at_once`.
        """
        waiting = self._runs[run]
        if waiting.again:
            batch = waiting.again.pop(next(iter(waiting.again)))
        else:
            rows = waiting.uncut.popleft()
            if waiting.run.needs_device and self._batch_size is None:
                n = min(at_once, len(rows))
            else:
                runs = len(self._runs)
                shared = max(runs, self._rows // len(rows)) if runs > 1 else 1
                n = waiting.sizer.next_size(len(rows), workers, shared)
            if n < len(rows):
                waiting.uncut.appendleft(rows[n:])
            batch = Batch(id=self.new_id(), run=waiting.run, rows=rows[:n])
        self._rows -= len(batch)
        self._served = waiting.served
        waiting.served += len(batch) * (waiting.sizer.seconds_per_row or 0.0)
        return batch

    def pop_tried(self, may_have: Callable[[Batch], bool]) -> Batch | None:
        """Return the first batch for other workers than those that had it which this one may have."""
        found = next((batch for batch in self._again.values() if may_have(batch)), None)
        if found is not None:
            del self._again[found.id]
        return found

    def requeue(self, batch: Batch) -> None:
        """Have a batch leased again, before anything new of its run."""
        if batch.tried_by or isinstance(batch, Probe):
            self._again[batch.id] = batch
            return
        waiting = self._runs[batch.run.run]
        if batch.id not in waiting.again:
            self._rows += len(batch)
        waiting.again[batch.id] = batch

    def requeue_row(self, batch: Batch, place: int, wid: str, now: float) -> None:
        """Queue a row that failed on a worker for another one, as a batch of its own."""
        again = type(batch)(id=self.new_id(), run=batch.run, rows=batch.rows[place : place + 1])
        again.tried_by, again.failed_at = (*batch.tried_by, wid), min(batch.failed_at, now)
        self.requeue(again)

    def remove(self, batch: Batch) -> None:
        """Forget a batch that was queued again, if it still waits."""
        self._again.pop(batch.id, None)
        if (waiting := self._runs.get(batch.run.run)) is not None and batch.id in waiting.again:
            del waiting.again[batch.id]
            self._rows -= len(batch)

    def measure(self, batch: Batch, cpu_seconds: float) -> None:
        """Record the cost of a batch."""
        self._runs[batch.run.run].sizer.measure(len(batch), cpu_seconds)

    def new_id(self) -> bytes:
        """Return an id that stays unique if an epoch recurs, as after a disk was restored."""
        self._cut += 1
        return self._prefix + self._cut.to_bytes(8)


@dataclass(eq=False)
class _RunBatches:
    """Waiting rows of a run."""

    run: RunRef
    sizer: BatchSizer
    uncut: deque[Generation] = field(default_factory=deque)
    """Rows that were never leased, of a generation each."""
    again: dict[bytes, Batch] = field(default_factory=dict)
    """Batches that are to be leased again, by id."""
    served: float = 0.0
    """CPU seconds leased so far; raised to the others' level when the run waits again."""

    def __len__(self) -> int:
        return sum(map(len, self.uncut)) + sum(map(len, self.again.values()))

    def __bool__(self) -> bool:
        return bool(self.uncut or self.again)
