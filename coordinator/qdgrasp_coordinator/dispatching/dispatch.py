"""Dispatch: who gets which batch, when a lease is over, and which result counts.

Rules 1 to 6 of docs/bus.md as plain state. Evaluation is pure, so whatever is lost in flight is evaluated
again, and the first result of a batch is as good as any other. Time is passed in, in seconds of any steady
clock.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.dispatching.backlog import Backlog
from qdgrasp_coordinator.dispatching.batch import Batch, Lease, Settled, Settlement, complete
from qdgrasp_coordinator.dispatching.member import Member
from qdgrasp_coordinator.dispatching.roster import Overdue, Roster
from qdgrasp_coordinator.dispatching.tickets import Ticket, Tickets
from qdgrasp_protocol.genome import Genomes
from qdgrasp_protocol.messages import Failure, Result
from qdgrasp_protocol.rows import Rows

STRIKES = 3
"""A row that the simulator failed on so often is settled as an error."""
_COUNTED = ("leased", "requeued", "failures", "errors")


@dataclass(frozen=True)
class Lost:
    """A worker that was given up."""

    wid: str
    reason: str
    batches: int
    """How many of its batches were queued again."""
    is_there: bool
    """It is still there, but stuck."""


class Dispatch:
    """Leases the rows of all runs of a job to its workers.

    Parameters
    ----------
    epoch
        The coordinator's turn at the job.
    batch_size
        Rows in a batch; None: as many as take about a quarter of a second.
    """

    def __init__(self, epoch: int, batch_size: int | None = None) -> None:
        self.counters = dict.fromkeys((*(kind.value for kind in Settlement), *_COUNTED), 0)
        """What was seen: each kind of result, batches leased and queued again, rows failed and given up."""
        self._backlog = Backlog(batch_size)
        self._roster = Roster()
        self._tickets = Tickets(epoch)

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
        """Take a worker on, or on again; gives the batches that it is to drop.

        Whatever it was leased and does not hold is queued again. A join that a later one has overtaken
        changes nothing.
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
        """Hear that a worker makes progress, on whatever job."""
        self._roster.seen(wid, now)

    def gone(self, wid: str, now: float) -> None:
        """Hear that a worker's token has vanished."""
        self._roster.gone(wid, now)

    def expect(self, wid: str, now: float) -> None:
        """Hear that the token of a worker that joined is not there yet, or vanished before it was heard."""
        self._roster.expect(wid, now)

    def back(self, wid: str, now: float) -> None:
        """Hear that a worker's token is there (again)."""
        self._roster.back(wid)

    def drain(self, wid: str) -> None:
        """Lease a worker nothing more; what it holds it may answer."""
        self._roster.drain(wid)

    def is_drained(self, wid: str) -> bool:
        """Whether a worker is to leave."""
        return self._roster.is_drained(wid)

    def link(self, is_up: bool, now: float) -> None:
        """Hear that the coordinator's own link went down or came up; while it is down nobody is given up."""
        self._roster.link(is_up, now)

    # Results come in.

    def settle(self, wid: str, result: Result, rows: Rows, now: float) -> Settled:
        """Judge a result: the first of a batch wins, if it comes on the key of a worker that was leased it.

        Parameters
        ----------
        wid
            Whose key it came on.
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
            return Settled(kind)
        self._learn(ticket, wid, result, now)
        self._backlog.remove(ticket.batch)
        self._tickets.close(ticket, winner=wid)
        settled = self._split(ticket.batch, result, rows)
        if ticket.holder in (None, wid):
            return settled
        self._roster.release(ticket.holder, result.batch)
        return replace(settled, superseded=ticket.holder)

    # Time passes.

    def tick(self, now: float) -> list[Lost]:
        """Queue again what vanished workers held, and what was leased without progress for too long."""
        return [self._lose(worker) for worker in self._roster.overdue(now)]

    def next_deadline(self) -> float:
        """Before when `tick` has nothing to do if nothing happens; infinite: never."""
        return self._roster.next_deadline()

    @property
    def strays(self) -> int:
        """Results that were dropped: late, duplicate, unknown, or of somebody else's batch."""
        return sum(self.counters[kind.value] for kind in Settlement if kind is not Settlement.FRESH)

    @property
    def workers(self) -> int:
        """Workers that are there to stay, and make progress."""
        return len(self._roster)

    @property
    def members(self) -> list[Member]:
        """What is known of each worker, in the order in which they joined."""
        return list(self._roster)

    @property
    def queued_seconds(self) -> float:
        """What the rows that wait for a worker are expected to cost [CPU s]; 0 where none waits."""
        return self._backlog.seconds

    # From hand to hand.

    def _lease(self, batch: Batch, worker: Member, now: float) -> Lease:
        ticket = self._tickets.open(batch)
        ticket.attempts += 1
        ticket.since = now
        ticket.leased.add(worker.wid)
        self._hand_over(ticket, worker, now)
        self.counters["leased"] += 1
        return Lease(worker.wid, worker.number, ticket.attempts, batch)

    def _hand_over(self, ticket: Ticket, worker: Member, now: float) -> None:
        ticket.holder = worker.wid
        self._roster.hold(worker, ticket.batch.id, ticket.batch.scene, now)

    def _own(self, wid: str, batch_id: bytes) -> Ticket | None:
        """The ticket of a batch that a worker may go on with; it may wait to be leased again."""
        ticket = self._tickets.find(batch_id)
        is_own = ticket is not None and wid in ticket.leased and ticket.holder in (None, wid)
        return ticket if is_own else None

    def _requeue(self, batch_ids: Iterable[bytes]) -> int:
        """Have those of the batches that are open leased again."""
        tickets = [ticket for batch_id in batch_ids if (ticket := self._tickets.find(batch_id))]
        for ticket in tickets:
            ticket.holder = None
            self._backlog.put_back(ticket.batch)
        self.counters["requeued"] += len(tickets)
        return len(tickets)

    def _lose(self, worker: Overdue) -> Lost:
        """Queue again what a worker held that is given up."""
        is_there = self._roster.get(worker.wid) is not None
        return Lost(worker.wid, worker.reason, self._requeue(worker.batches), is_there)

    # Settling.

    def _learn(self, ticket: Ticket, wid: str, result: Result, now: float) -> None:
        self._backlog.measure(ticket.batch, result.cpu_seconds)
        if ticket.holder == wid:
            self._roster.patience.measure(now - ticket.since)

    def _split(self, batch: Batch, result: Result, rows: Rows) -> Settled:
        """Give what is settled; queue failed rows again, until they have failed too often."""
        failed = {failure.row: failure.reason for failure in result.failures}
        self.counters["failures"] += len(failed)
        done = complete(rows, batch, failed)
        if not failed:
            return Settled(Settlement.FRESH, done, result.cpu_seconds)
        if batch.failed + 1 < STRIKES:
            for place in sorted(failed):
                self._backlog.put_back_row(batch, place)
            return Settled(Settlement.FRESH, np.delete(done, list(failed)), result.cpu_seconds)
        self.counters["errors"] += len(failed)
        failures = tuple(Failure(row=place, reason=reason) for place, reason in failed.items())
        return Settled(Settlement.FRESH, done, result.cpu_seconds, failures)
