"""Batches and builds that were leased: who holds them, and which answer to them counts.

Time is passed in, in seconds of any steady clock.
"""

from collections import OrderedDict
from dataclasses import dataclass, field

from qdgrasp_coordinator.scheduler.batch_queue import Batch, Settlement
from qdgrasp_coordinator.scheduler.shape_queue import ShapeBuild
from qdgrasp_protocol.build_messages import Built
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Result

MOST_SETTLED = 10_000
"""Settled batches that are remembered, to tell duplicate and late results from unknown ones."""


@dataclass(eq=False)
class BatchState:
    """A batch, or a build, that was leased and is not settled."""

    batch: Batch | ShapeBuild
    attempts: int = 0
    holders: dict[str, float] = field(default_factory=dict)
    """Workers that hold it, and when they were leased it; none: it waits."""
    leased: set[str] = field(default_factory=set)
    """All workers that were ever leased it."""


class BatchTable:
    """Batches that were leased and not settled, and the latest settled ones."""

    def __init__(self, epoch: int) -> None:
        self._epoch = epoch
        self._open: OrderedDict[bytes, BatchState] = OrderedDict()
        """Leased batches by id; the latest leases are at the end."""
        self._settled: OrderedDict[bytes, tuple[set[str], str | None]] = OrderedDict()
        """By id: the workers that were leased it, and the one that settled it; None: withdrawn."""

    def open(self, batch: Batch | ShapeBuild) -> BatchState:
        """Return the state of a batch that is leased, made at its first lease."""
        return self._open.setdefault(batch.id, BatchState(batch))

    def hand_over(self, state: BatchState, wid: str, now: float) -> None:
        """Record that a worker holds a batch from now on."""
        state.holders[wid] = now
        self._open.move_to_end(state.batch.id)

    def late(self, before: float) -> list[BatchState]:
        """Return batches that one worker has held since before a time, those held for longest first.

        Rows on which others failed are not among them: they may end any worker's process.
        """
        found = []
        for state in self._open.values():
            if isinstance(state.batch, ShapeBuild) or not state.holders:
                continue
            if max(state.holders.values()) > before:
                break
            has_failed = state.batch.tried_by and state.batch.check is None
            if len(state.holders) == 1 and not has_failed:
                found.append(state)
        return found

    @property
    def leased(self) -> int:
        """Number of batches that workers hold."""
        return sum(bool(state.holders) for state in self._open.values())

    def find(self, batch_id: bytes) -> BatchState | None:
        """Return the state of a leased batch; None: never leased, or settled."""
        return self._open.get(batch_id)

    def of(self, run: str) -> list[BatchState]:
        """Return a run's leased, unsettled batches."""
        return [
            state
            for state in self._open.values()
            if isinstance(state.batch, Batch) and state.batch.run.run == run
        ]

    @property
    def builds(self) -> list[BatchState]:
        """Leased, unsettled builds."""
        return [state for state in self._open.values() if isinstance(state.batch, ShapeBuild)]

    def close(self, state: BatchState, winner: str | None = None) -> None:
        """Move a batch to the settled ones, without its rows; without a winner if withdrawn."""
        del self._open[state.batch.id]
        self._settled[state.batch.id] = (state.leased, winner)
        if len(self._settled) > MOST_SETTLED:
            self._settled.popitem(last=False)

    def classify(self, wid: str, result: Result | Built) -> Settlement:
        """Return the kind of a result on a worker's key; MessageError if it does not fit its batch."""
        state = self._open.get(result.batch)
        leased, winner = (state.leased, None) if state else self._settled.get(result.batch, (None, None))
        if result.epoch != self._epoch or (leased is not None and wid not in leased):
            return Settlement.FOREIGN
        if state is not None:
            _check_result(state.batch, result)
            return Settlement.FRESH
        if leased is None:
            return Settlement.UNKNOWN
        return Settlement.DUPLICATE if winner == wid else Settlement.LATE


def _check_result(batch: Batch | ShapeBuild, result: Result | Built) -> None:
    if isinstance(batch, ShapeBuild) or isinstance(result, Built):
        if not (isinstance(batch, ShapeBuild) and isinstance(result, Built)):
            raise MessageError("a shape is no answer to a batch, nor rows to a build")
        return
    if result.run != batch.run.run:
        raise MessageError(f"a result is of run '{result.run}', its batch of '{batch.run.run}'")
    if result.n != len(batch):
        raise MessageError(f"a result has {result.n} rows, its batch {len(batch)}")
    for failure in result.failures:
        if failure.row >= result.n:
            raise MessageError(f"a result of {result.n} rows names row {failure.row} as failed")
