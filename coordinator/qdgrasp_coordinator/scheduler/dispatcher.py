"""Dispatch: which worker gets which batch, when a lease is over, and which result counts.

Rules 1 to 6 of docs/bus.md as plain state. Evaluation is pure, so whatever is lost in flight is evaluated
again, and the first result of a batch is as good as any other. Time is passed in, in seconds of any steady
clock.
"""

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.scheduler.batch_queue import (
    Batch,
    BatchQueue,
    Lease,
    Settlement,
    SettleReply,
    complete_rows,
)
from qdgrasp_coordinator.scheduler.worker_registry import OverdueWorker, Worker, WorkerRegistry
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Failure, Result
from qdgrasp_protocol.rows import Genomes, Rows

MOST_SETTLED = 10_000
"""Settled batches that are remembered, to tell duplicate and late results from unknown ones."""


@dataclass(eq=False)
class BatchState:
    """A batch that was leased and is not settled."""

    batch: Batch
    attempts: int = 0
    holder: str | None = None
    """Worker that holds it; None: it waits."""
    since: float = 0.0
    """When it was leased last."""
    leased: set[str] = field(default_factory=set)
    """All workers that were ever leased it."""


@dataclass(eq=False)
class SettledBatch:
    """A settled batch without its rows."""

    leased: set[str]
    winner: str | None
    """Worker that settled it; None: it was withdrawn."""


class BatchTable:
    """Batches that were leased and not settled, and the latest settled ones."""

    def __init__(self, epoch: int) -> None:
        self._epoch = epoch
        self._open: dict[bytes, BatchState] = {}
        self._settled: OrderedDict[bytes, SettledBatch] = OrderedDict()

    def open(self, batch: Batch) -> BatchState:
        """Return the state of a batch that is leased, made at its first lease."""
        return self._open.setdefault(batch.id, BatchState(batch))

    def find(self, batch_id: bytes) -> BatchState | None:
        """Return the state of a leased batch; None: never leased, or settled."""
        return self._open.get(batch_id)

    def of(self, run: str) -> list[BatchState]:
        """Return a run's leased, unsettled batches."""
        return [ticket for ticket in self._open.values() if ticket.batch.run == run]

    def close(self, ticket: BatchState, winner: str | None = None) -> None:
        """Move a batch to the settled ones, without its rows; without a winner if withdrawn."""
        del self._open[ticket.batch.id]
        self._settled[ticket.batch.id] = SettledBatch(ticket.leased, winner)
        if len(self._settled) > MOST_SETTLED:
            self._settled.popitem(last=False)

    def judge(self, wid: str, result: Result) -> Settlement:
        """Return the kind of a result on a worker's key.

        Raises
        ------
        MessageError
            It would be fresh, but does not fit its batch.
        """
        ticket, stub = self._open.get(result.batch), self._settled.get(result.batch)
        known = ticket or stub
        if result.epoch != self._epoch or (known is not None and wid not in known.leased):
            return Settlement.FOREIGN
        if ticket is not None:
            _check_result(ticket.batch, result)
            return Settlement.FRESH
        if stub is not None:
            return Settlement.DUPLICATE if stub.winner == wid else Settlement.LATE
        return Settlement.UNKNOWN


def _check_result(batch: Batch, result: Result) -> None:
    if result.n != len(batch):
        raise MessageError(f"a result has {result.n} rows, its batch {len(batch)}")
    for failure in result.failures:
        if failure.row >= result.n:
            raise MessageError(f"a result of {result.n} rows names row {failure.row} as failed")


STRIKES = 3  # Failures of the simulator after which a row is settled as an error
_COUNTED = ("leased", "requeued", "failures", "errors")


@dataclass(frozen=True)
class LostWorker:
    """A worker that was given up."""

    wid: str
    reason: str
    batches: int
    """Number of its batches queued again."""
    is_there: bool
    """It is still there, but stuck."""


class Dispatcher:
    """Leases the rows of all runs of a job to its workers.

    Parameters
    ----------
    epoch
        The coordinator's.
    batch_size
        Rows in a batch; None: as many as take about a quarter of a second.
    """

    def __init__(self, epoch: int, batch_size: int | None = None) -> None:
        self.counters = dict.fromkeys((*(kind.value for kind in Settlement), *_COUNTED), 0)
        """Results by kind, batches leased and queued again, rows failed and given up."""
        self._backlog = BatchQueue(batch_size)
        self._roster = WorkerRegistry()
        self._tickets = BatchTable(epoch)

    # Work comes in, and goes out.

    def submit(
        self,
        run: str,
        scene: str,
        prior: str,
        generation: int,
        indices: NDArray[np.uint32],
        trials: NDArray[np.uint16],
        genomes: Genomes,
    ) -> None:
        """Queue rows of one generation of a run: (n,), (n,), (n, d)."""
        self._backlog.submit(Batch(b"", run, scene, prior, generation, indices, trials, genomes))

    def withdraw(self, run: str) -> dict[str, list[bytes]]:
        """Forget all rows of a run; gives the batches that workers may drop, by worker."""
        self._backlog.withdraw(run)
        drops: dict[str, list[bytes]] = {}
        for ticket in self._tickets.of(run):
            if ticket.holder is not None:
                drops.setdefault(ticket.holder, []).append(ticket.batch.id)
                self._roster.release(ticket.holder, ticket.batch.id)
            self._tickets.close(ticket)
        return drops

    def leases(self, now: float) -> list[Lease]:
        """Lease what is queued to workers with credit left; send them in this order."""
        leases: list[Lease] = []
        if not self._backlog:
            return leases
        free, workers = self._roster.free(), len(self._roster)
        while (worker := free.first) and (run := self._backlog.turn(worker.scenes)):
            leases.append(self._lease(self._backlog.take(run, workers), worker, now))
            free.next()
        return leases

    # Workers come, are heard of, and go.

    def join(self, wid: str, number: int, credit: int, held: Iterable[bytes], now: float) -> list[bytes]:
        """Admit a worker, or admit it again; returns the batches that it is to drop.

        What it was leased and does not hold is queued again. A join older than the latest changes nothing.
        """
        old = self._roster.get(wid)
        if old is not None and number <= old.number:
            return []
        listed = list(dict.fromkeys(held))
        kept = {batch_id: ticket for batch_id in listed if (ticket := self._own(wid, batch_id))}
        if old is not None:
            self._requeue(batch_id for batch_id in old.batches if batch_id not in kept)
        worker = self._roster.admit(wid, number, credit, now)
        for ticket in kept.values():
            self._backlog.remove(ticket.batch)
            self._hand_over(ticket, worker, now)
        return [batch_id for batch_id in listed if batch_id not in kept]

    def seen(self, wid: str, now: float) -> None:
        """Record that a worker makes progress, on any job."""
        self._roster.seen(wid, now)

    def gone(self, wid: str, now: float) -> None:
        """Record that a worker's token vanished."""
        self._roster.gone(wid, now)

    def expect(self, wid: str, now: float) -> None:
        """Await the token of a worker that joined: it is late, or vanished before it was seen."""
        self._roster.expect(wid, now)

    def back(self, wid: str, now: float) -> None:
        """Record that a worker's token is there (again)."""
        self._roster.back(wid)

    def drain(self, wid: str) -> None:
        """Lease a worker nothing more; what it holds still counts."""
        self._roster.drain(wid)

    def is_drained(self, wid: str) -> bool:
        """True if a worker is to leave."""
        return self._roster.is_drained(wid)

    def link(self, is_up: bool, now: float) -> None:
        """Record a change of the coordinator's own link; while it is down no worker is given up."""
        self._roster.link(is_up, now)

    # Results come in.

    def settle(self, wid: str, result: Result, rows: Rows, now: float) -> SettleReply:
        """Settle a result: the first of a batch counts, if its sender was leased the batch.

        Parameters
        ----------
        wid
            The worker on whose key it came.
        result
            The message. One that cannot be unpacked may be passed on with all its rows named as failed.
        rows
            Its columns, unpacked; keys and genomes are filled in here.

        Raises
        ------
        MessageError
            It has another number of rows than its batch, or names a failed row that the batch has not.
        """
        kind = self._tickets.judge(wid, result)
        self.counters[kind.value] += 1
        if kind is not Settlement.FOREIGN:
            self._roster.seen(wid, now)
            self._roster.release(wid, result.batch)
        ticket = self._tickets.find(result.batch)
        if kind is not Settlement.FRESH or ticket is None:
            return SettleReply(kind)
        self._learn(ticket, wid, result, now)
        self._backlog.remove(ticket.batch)
        self._tickets.close(ticket, winner=wid)
        settled = self._split(ticket.batch, result, rows)
        if ticket.holder in (None, wid):
            return settled
        self._roster.release(ticket.holder, result.batch)
        return replace(settled, superseded=ticket.holder)

    # Time passes.

    def tick(self, now: float) -> list[LostWorker]:
        """Queue again what vanished workers held, and what was leased without progress for too long."""
        return [self._lose(worker) for worker in self._roster.overdue(now)]

    def next_deadline(self) -> float:
        """Return the time before which `tick` has nothing to do; infinite: never."""
        return self._roster.next_deadline()

    @property
    def strays(self) -> int:
        """Number of dropped results: late, duplicate, unknown or foreign."""
        return sum(self.counters[kind.value] for kind in Settlement if kind is not Settlement.FRESH)

    @property
    def workers(self) -> int:
        """Number of workers present, progressing and not leaving."""
        return len(self._roster)

    @property
    def members(self) -> list[Worker]:
        """Known workers, in the order in which they joined."""
        return list(self._roster)

    @property
    def queued_seconds(self) -> float:
        """Expected cost of the rows that wait for a worker [CPU s]."""
        return self._backlog.seconds

    # From hand to hand.

    def _lease(self, batch: Batch, worker: Worker, now: float) -> Lease:
        ticket = self._tickets.open(batch)
        ticket.attempts += 1
        ticket.since = now
        ticket.leased.add(worker.wid)
        self._hand_over(ticket, worker, now)
        self.counters["leased"] += 1
        return Lease(worker.wid, worker.number, ticket.attempts, batch)

    def _hand_over(self, ticket: BatchState, worker: Worker, now: float) -> None:
        ticket.holder = worker.wid
        self._roster.hold(worker, ticket.batch.id, ticket.batch.scene, now)

    def _own(self, wid: str, batch_id: bytes) -> BatchState | None:
        """Return a batch that a worker may go on with, held by it or waiting; else None."""
        ticket = self._tickets.find(batch_id)
        is_own = ticket is not None and wid in ticket.leased and ticket.holder in (None, wid)
        return ticket if is_own else None

    def _requeue(self, batch_ids: Iterable[bytes]) -> int:
        """Queue the unsettled batches again; returns their number."""
        tickets = [ticket for batch_id in batch_ids if (ticket := self._tickets.find(batch_id))]
        for ticket in tickets:
            ticket.holder = None
            self._backlog.put_back(ticket.batch)
        self.counters["requeued"] += len(tickets)
        return len(tickets)

    def _lose(self, worker: OverdueWorker) -> LostWorker:
        """Queue the batches of a given-up worker again."""
        is_there = self._roster.get(worker.wid) is not None
        return LostWorker(worker.wid, worker.reason, self._requeue(worker.batches), is_there)

    # Settling.

    def _learn(self, ticket: BatchState, wid: str, result: Result, now: float) -> None:
        self._backlog.measure(ticket.batch, result.cpu_seconds)
        if ticket.holder == wid:
            self._roster.patience.measure(now - ticket.since)

    def _split(self, batch: Batch, result: Result, rows: Rows) -> SettleReply:
        """Return the settled rows; queue failed ones again until they failed too often."""
        failed = {failure.row: failure.reason for failure in result.failures}
        self.counters["failures"] += len(failed)
        done = complete_rows(rows, batch, failed)
        if not failed:
            return SettleReply(Settlement.FRESH, done, result.cpu_seconds)
        if batch.failed + 1 < STRIKES:
            for place in sorted(failed):
                self._backlog.put_back_row(batch, place)
            return SettleReply(Settlement.FRESH, np.delete(done, list(failed)), result.cpu_seconds)
        self.counters["errors"] += len(failed)
        failures = tuple(Failure(row=place, reason=reason) for place, reason in failed.items())
        return SettleReply(Settlement.FRESH, done, result.cpu_seconds, failures)
