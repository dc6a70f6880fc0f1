"""Batches: rows that wait for a worker, how many make a batch, and which run is next."""

import secrets
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field
from enum import Enum
from math import ceil, sqrt

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.arrays import take_rows
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Failure, Result, Work, shorten
from qdgrasp_protocol.rows import RESULT, Genomes, Outcome, Rows, RowShape, unpack

GREATEST_OUTCOME = int(max(Outcome))


@dataclass(frozen=True, eq=False)
class Batch:
    """Rows of one generation of one run that are leased together."""

    id: bytes
    """16 bytes: random ones of the epoch and a counter, not used again in the job."""
    run: str
    scene: str
    """The scene bundle's sha256."""
    prior: str
    generation: int
    indices: NDArray[np.uint32]
    """(n,)."""
    trials: NDArray[np.uint16]
    """(n,)."""
    genomes: Genomes
    """(n, d)."""
    failed: int = 0
    """Failures of the simulator on it; such a row is alone in its batch."""

    def __len__(self) -> int:
        return len(self.indices)

    def part(self, batch_id: bytes, places: slice, failed: int = 0) -> "Batch":
        """Some of its rows as another batch."""
        return Batch(
            batch_id,
            self.run,
            self.scene,
            self.prior,
            self.generation,
            self.indices[places],
            self.trials[places],
            self.genomes[places],
            failed,
        )


@dataclass(frozen=True)
class Lease:
    """A batch leased to a worker."""

    wid: str
    join: int
    """The worker's join number; the worker drops what it was sent for an older one."""
    attempt: int
    """Counts the leases of this batch, from 1."""
    batch: Batch

    def work(self, epoch: int) -> Work:
        """Return the message to the worker."""
        batch = self.batch
        return Work(
            epoch=epoch,
            run=batch.run,
            scene=batch.scene,
            prior=batch.prior,
            generation=batch.generation,
            batch=batch.id,
            attempt=self.attempt,
            join=self.join,
            n=len(batch),
            genes=batch.genomes.shape[1],
            columns={
                "index": batch.indices.astype("<u4").tobytes(),
                "trial": batch.trials.astype("<u2").tobytes(),
                "genome": batch.genomes.astype("<f4").tobytes(),
            },
        )


class Settlement(Enum):
    """Kinds of results."""

    FRESH = "fresh"
    """The first of its batch: it is taken, all others are dropped."""
    DUPLICATE = "duplicate"
    """Its sender has already settled this batch."""
    LATE = "late"
    """Another worker has already settled this batch."""
    UNKNOWN = "unknown"
    """No such batch is known, or no longer."""
    FOREIGN = "foreign"
    """Of another epoch, or from a worker that was never leased this batch."""


@dataclass(frozen=True)
class SettleReply:
    """The answer to a result; the defaults are those of one that is dropped."""

    kind: Settlement
    rows: Rows | None = None
    """Settled rows with keys, genomes and results, in the order of the batch; None unless fresh."""
    cpu_seconds: float = 0.0
    """Cost of the batch [CPU s]."""
    failures: tuple[Failure, ...] = ()
    """Reasons of final failures, by place in `rows`, which hold `Outcome.ERROR` and zeros."""
    superseded: str | None = None
    """Another holder of the batch, which is to drop it; its credit is free already."""


def complete_rows(rows: Rows, batch: Batch, failed: Collection[int]) -> Rows:
    """Return result rows with the batch's keys and genomes; failed rows hold zeros."""
    rows = take_rows(rows, np.s_[:])
    if failed:
        rows[list(failed)] = np.zeros((), dtype=rows.dtype)
    rows["generation"] = batch.generation
    rows["index"] = batch.indices
    rows["trial"] = batch.trials
    rows["genome"] = batch.genomes
    return rows


def read_result(result: Result, shape: RowShape) -> tuple[Result, Rows]:
    """Return a result and its rows; if these cannot be read, all count as failed."""
    if len(result.failures) == result.n:
        return result, shape.empty(result.n)
    try:
        return result, _unpack_result(result, shape)
    except MessageError as error:
        failures = [Failure(row=row, reason=shorten(str(error))) for row in range(result.n)]
        return msgspec.structs.replace(result, failures=failures), shape.empty(result.n)


def _unpack_result(result: Result, shape: RowShape) -> Rows:
    rows = unpack(shape.empty(result.n), RESULT, result.columns, shape)
    greatest = int(rows["outcome"].max())
    if greatest > GREATEST_OUTCOME:
        raise MessageError(f"column 'outcome' holds {greatest}, and outcomes end with {GREATEST_OUTCOME}")
    return rows


BATCH_SECONDS = 0.25  # Target duration of a batch [s]
LEAST_SECONDS = 0.02  # Shortest batch that is cut to share the end of a generation [s]
HANDLING_SECONDS = 50e-6  # Time of the coordinator's one thread per batch [s]
FIRST_ROWS = 4  # Rows in a batch while nothing is known about their cost
MOST_ROWS = 512
_MEMORY = 0.9


class BatchSizer:
    """The size of one run's batches.

    Parameters
    ----------
    fixed
        Rows in a batch; None: measured.
    """

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

    def rows(self, remaining: int, workers: int, runs: int = 1) -> int:
        """Rows in the next batch.

        Parameters
        ----------
        remaining
            Rows of the generation that are not leased; at least 1.
        workers
            Workers that share these and as many rows of the other runs: none is to get more than its part of
            half of them, so that all of them are done at about the same time.
        runs
            How many runs are under way; at least 1.
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
    """Cuts rows into batches, and takes batches back that are to be leased again.

    Parameters
    ----------
    batch_size
        Rows in a batch; None: measured.
    """

    def __init__(self, batch_size: int | None) -> None:
        self._turn = secrets.token_bytes(8)
        self._batch_size = batch_size
        self._queues: dict[str, _RunBatches] = {}
        self._cut = 0
        self._served = 0.0

    def __bool__(self) -> bool:
        """True if rows wait."""
        return any(self._queues.values())

    @property
    def seconds(self) -> float:
        """Expected cost of the waiting rows [CPU s]."""
        return sum(len(queue) * (queue.pace.seconds_per_row or FIRST_COST) for queue in self._queues.values())

    def submit(self, chunk: Batch) -> None:
        """Take rows of one generation that were never leased."""
        queue = self._queues.setdefault(chunk.run, _RunBatches(BatchSizer(self._batch_size)))
        if not queue:
            queue.served = max(queue.served, self._served)
        queue.chunks.append(chunk)

    def withdraw(self, run: str) -> None:
        """Forget a run."""
        self._queues.pop(run, None)

    def turn(self, scenes: Collection[str]) -> str | None:
        """Return the run served least, or within the slack one with a held scene; None: no rows.

        Parameters
        ----------
        scenes
            Those that the worker holds.
        """
        least = at_hand = None
        for run, queue in self._queues.items():
            if queue and (least is None or queue.served < least[0]):
                least = (queue.served, run)
            if queue and queue.scene in scenes and (at_hand is None or queue.served < at_hand[0]):
                at_hand = (queue.served, run)
        if least is None:
            return None
        return at_hand[1] if at_hand and at_hand[0] <= least[0] + SCENE_SLACK else least[1]

    def take(self, run: str, workers: int) -> Batch:
        """Return the next batch of a waiting run: one put back, or a new one.

        Parameters
        ----------
        workers
            Workers that share the runs.
        """
        queue = self._queues[run]
        batch = queue.take_back() or self._cut_batch(queue, workers)
        self._served = queue.served
        queue.served += len(batch) * (queue.pace.seconds_per_row or 0.0)
        return batch

    def put_back(self, batch: Batch) -> None:
        """Have a batch leased again, before anything new of its run."""
        self._queues[batch.run].back[batch.id] = batch

    def put_back_row(self, batch: Batch, place: int) -> None:
        """Queue a row on which the simulator failed again, as a batch of its own."""
        self.put_back(batch.part(self._new_id(), slice(place, place + 1), batch.failed + 1))

    def remove(self, batch: Batch) -> None:
        """Forget a batch that was put back, if it still waits."""
        if batch.run in self._queues:
            self._queues[batch.run].back.pop(batch.id, None)

    def measure(self, batch: Batch, cpu_seconds: float) -> None:
        """Record the cost of a batch."""
        self._queues[batch.run].pace.measure(len(batch), cpu_seconds)

    def _cut_batch(self, queue: "_RunBatches", workers: int) -> Batch:
        """A new batch of the oldest generation."""
        chunk = queue.chunks.popleft()
        n = queue.pace.rows(len(chunk), workers, len(self._queues))
        if n < len(chunk):
            queue.chunks.appendleft(chunk.part(b"", slice(n, None)))
        return chunk.part(self._new_id(), slice(n))

    def _new_id(self) -> bytes:
        """Return an id that stays unique if an epoch recurs, as after a disk was restored."""
        self._cut += 1
        return self._turn + self._cut.to_bytes(8)


@dataclass
class _RunBatches:
    """Waiting rows of a run."""

    pace: BatchSizer
    chunks: deque[Batch] = field(default_factory=deque)
    """Rows that were never leased, of a generation each, without an id."""
    back: dict[bytes, Batch] = field(default_factory=dict)
    """Batches that are to be leased again, by id."""
    served: float = 0.0
    """CPU seconds leased so far; raised to the others' level when the run waits again."""

    def __len__(self) -> int:
        return sum(map(len, self.chunks)) + sum(map(len, self.back.values()))

    def __bool__(self) -> bool:
        return bool(self.chunks or self.back)

    @property
    def scene(self) -> str:
        return (next(iter(self.back.values())) if self.back else self.chunks[0]).scene

    def take_back(self) -> Batch | None:
        """Remove and return the batch put back first; None: empty."""
        return self.back.pop(next(iter(self.back))) if self.back else None
