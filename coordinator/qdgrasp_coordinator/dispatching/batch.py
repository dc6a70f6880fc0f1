"""Batches, leases, and what became of a result: the values that dispatch hands out."""

from collections.abc import Collection
from dataclasses import dataclass
from enum import Enum

import msgspec
import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.counts.whole import taken
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.genome import Genomes
from qdgrasp_protocol.messages import Failure, Result, Work, short
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import RESULT, Rows, Shape, unpack

BEST = int(max(Outcome))


@dataclass(frozen=True, eq=False)
class Batch:
    """Rows of one generation of one run that are leased together."""

    id: bytes
    """16 bytes: random ones of the turn and a counter, not used again in the job."""
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
    """How often the simulator failed on it; such a row is alone in its batch."""

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
    """A batch in the hands of a worker."""

    wid: str
    join: int
    """The worker's join number; the worker drops what it was sent for an older one."""
    attempt: int
    """Counts the leases of this batch, from 1."""
    batch: Batch

    def work(self, epoch: int) -> Work:
        """The message that brings it to the worker."""
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
    """What a result was."""

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
class Settled:
    """The answer to a result; the defaults are those of one that is dropped."""

    kind: Settlement
    rows: Rows | None = None
    """Settled rows with keys, genomes and results, in the order of the batch; None unless fresh."""
    cpu_seconds: float = 0.0
    """What the batch cost its worker."""
    failures: tuple[Failure, ...] = ()
    """Why rows failed for the last time, by their place in `rows`; they hold `Outcome.ERROR` and zeros."""
    superseded: str | None = None
    """Another worker that holds the batch too, and is to drop it: its credit is free again already."""


def complete(rows: Rows, batch: Batch, failed: Collection[int]) -> Rows:
    """Fill the keys and genomes of a batch in rows that hold its results; those that failed hold zeros."""
    rows = taken(rows, np.s_[:])
    if failed:
        rows[list(failed)] = np.zeros((), dtype=rows.dtype)
    rows["generation"] = batch.generation
    rows["index"] = batch.indices
    rows["trial"] = batch.trials
    rows["genome"] = batch.genomes
    return rows


def readable(result: Result, shape: Shape) -> tuple[Result, Rows]:
    """A result and its rows; where these cannot be read, all of them failed, for that reason."""
    if len(result.failures) == result.n:
        return result, shape.empty(result.n)
    try:
        return result, _read(result, shape)
    except MessageError as error:
        failures = [Failure(row=row, reason=short(str(error))) for row in range(result.n)]
        return msgspec.structs.replace(result, failures=failures), shape.empty(result.n)


def _read(result: Result, shape: Shape) -> Rows:
    rows = unpack(shape.empty(result.n), RESULT, result.columns, shape)
    greatest = int(rows["outcome"].max())
    if greatest > BEST:
        raise MessageError(f"column 'outcome' holds {greatest}, and outcomes end with {BEST}")
    return rows
