"""Dispatch: who gets which batch, when a lease is over, and which result counts.

Rules 1 to 6 of PROTOCOL.md as plain state. Evaluation is pure, so whatever is lost in flight is evaluated
again, and the first result of a batch is as good as any other. Time is passed in,
in seconds of any steady clock.
"""

import struct
from collections import OrderedDict, deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import inf

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.archive import Genomes
from qdgrasp_coordinator.batch import Batch, Lease, Settled, Settlement, complete
from qdgrasp_coordinator.pace import Pace, Patience
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Failure, Result
from qdgrasp_protocol.rows import Rows

GRACE = 1.0
"""Seconds between the loss of a worker's token and the re-queueing of its batches."""
STRIKES = 3
"""A row that the simulator failed on so often is settled as an error."""
SCENES = 8
"""Scenes that a worker keeps open, least recently used first out."""
SLACK = 5.0
"""How many CPU seconds a run may be ahead of the others on workers that hold its scene."""
_COUNTED = ("leased", "requeued", "failures", "errors")
REMEMBERED = 10_000
"""Settled batches that are remembered, to tell duplicate and late results from unknown ones."""


@dataclass(frozen=True)
class Lost:
    """A worker that was given up, or is waited for no longer."""

    wid: str
    reason: str
    batches: int
    """How many of its batches were queued again."""


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
        self._epoch = epoch
        self._batch_size = batch_size
        self._runs: dict[str, _Run] = {}
        self._workers: dict[str, _Worker] = {}
        self._tickets: dict[bytes, _Ticket] = {}
        self._settled: OrderedDict[bytes, _Ticket] = OrderedDict()
        self._patience = Patience()
        self._link_is_up = True
        self._cut = 0
        self._served = 0.0

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
        entry = self._runs.setdefault(run, _Run(Pace(self._batch_size)))
        if not entry.has_work:
            entry.served = max(entry.served, self._served)
        entry.chunks.append(Batch(b"", run, scene, prior, generation, indices, trials, genomes))

    def withdraw(self, run: str) -> dict[str, list[bytes]]:
        """Forget all rows of a run; gives the batches that workers may drop, by worker."""
        self._runs.pop(run, None)
        drops: dict[str, list[bytes]] = {}
        for ticket in [ticket for ticket in self._tickets.values() if ticket.batch.run == run]:
            if ticket.holder is not None:
                drops.setdefault(ticket.holder, []).append(ticket.batch.id)
                self._workers[ticket.holder].batches.pop(ticket.batch.id, None)
            self._remember(ticket, winner=None)
        return drops

    def leases(self, now: float) -> list[Lease]:
        """Lease what is queued to workers with credit left; send them in this order."""
        leases = []
        while (worker := self._freest()) and (run := self._next_run(worker)):
            ticket = run.queued.popleft() if run.queued else self._cut_batch(run)
            leases.append(self._lease(ticket, worker, run, now))
        return leases

    # Workers come, are heard of, and go.

    def join(self, wid: str, number: int, credit: int, held: Iterable[bytes], now: float) -> list[bytes]:
        """Take a worker on, or on again; gives the batches that it is to drop.

        Whatever it was leased and does not hold is queued again. A join that a later one has overtaken
        changes nothing.
        """
        old = self._workers.get(wid)
        if old is not None and number <= old.number:
            return []
        listed = list(dict.fromkeys(held))
        kept = [batch_id for batch_id in listed if self._may_keep(wid, batch_id)]
        worker = _Worker(wid, number, credit, progress=now)
        if old is not None:
            worker.scenes = old.scenes
            self._requeue(batch_id for batch_id in old.batches if batch_id not in kept)
        self._workers[wid] = worker
        for batch_id in kept:
            self._take_back(self._tickets[batch_id], worker)
        return [batch_id for batch_id in listed if batch_id not in kept]

    def seen(self, wid: str, now: float) -> None:
        """Hear that a worker makes progress, on whatever job."""
        if wid in self._workers:
            self._workers[wid].progressed(now)

    def gone(self, wid: str, now: float) -> None:
        """Hear that a worker's token has vanished."""
        if wid in self._workers and self._workers[wid].gone_at is None:
            self._workers[wid].gone_at = now

    def back(self, wid: str, now: float) -> None:
        """Hear that a worker's token is there (again)."""
        if wid in self._workers:
            self._workers[wid].gone_at = None

    def link(self, is_up: bool, now: float) -> None:
        """Hear that the coordinator's own link went down or came up; while it is down nobody is given up."""
        if is_up and not self._link_is_up:
            for worker in self._workers.values():
                worker.progress = now
                worker.gone_at = None if worker.gone_at is None else now
        self._link_is_up = is_up

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
        kind = self._judge(wid, result)
        if kind is Settlement.FRESH:
            _check(self._tickets[result.batch].batch, result)
        self.counters[kind.value] += 1
        if kind is not Settlement.FOREIGN:
            self._release(wid, result.batch, now)
        if kind is not Settlement.FRESH:
            return Settled(kind)
        ticket = self._tickets[result.batch]
        self._learn(ticket, wid, result.cpu_seconds, now)
        self._remember(ticket, winner=wid)
        return self._split(ticket.batch, result, rows)

    # Time passes.

    def tick(self, now: float) -> list[Lost]:
        """Queue again what vanished workers held, and what was leased without progress for too long."""
        if not self._link_is_up:
            return []
        lost = []
        for worker in list(self._workers.values()):
            if worker.gone_at is not None and now >= worker.gone_at + GRACE:
                lost.append(self._give_up(worker, "its token vanished"))
                del self._workers[worker.wid]
            elif worker.is_leased and now >= worker.progress + self._patience.limit:
                worker.is_stuck = True
                lost.append(
                    self._give_up(worker, f"no sign of progress for {self._patience.limit:.0f} seconds")
                )
        return lost

    def next_deadline(self) -> float:
        """When `tick` has something to do if nothing happens before; infinite: never."""
        if not self._link_is_up:
            return inf
        gone = [worker.gone_at + GRACE for worker in self._workers.values() if worker.gone_at is not None]
        limit = self._patience.limit
        leased = [worker.progress + limit for worker in self._workers.values() if worker.is_leased]
        return min(gone + leased, default=inf)

    @property
    def lease_seconds(self) -> float:
        """How long a worker may go without a sign of progress."""
        return self._patience.limit

    @property
    def workers(self) -> int:
        """Workers that are there and make progress."""
        return sum(worker.gone_at is None and not worker.is_stuck for worker in self._workers.values())

    @property
    def queued(self) -> int:
        """Rows that wait for a worker."""
        return sum(run.remaining for run in self._runs.values())

    @property
    def leased(self) -> int:
        """Batches that workers hold."""
        return sum(ticket.holder is not None for ticket in self._tickets.values())

    # Leasing.

    def _freest(self) -> "_Worker | None":
        """The worker with the fewest batches among those with credit left; a stuck one if all are stuck.

        Of equals it is the one that was quiet for longest: with it every stuck worker gets its turn.
        """
        here = [worker for worker in self._workers.values() if worker.gone_at is None]
        well = [worker for worker in here if not worker.is_stuck] or here
        free = [worker for worker in well if len(worker.batches) < worker.credit]
        return min(free, key=lambda worker: (len(worker.batches), worker.progress), default=None)

    def _next_run(self, worker: "_Worker") -> "_Run | None":
        """The run that was served least; within the slack one whose scene the worker holds."""
        waiting = [run for run in self._runs.values() if run.has_work]
        if not waiting:
            return None
        least = min(run.served for run in waiting)
        at_hand = [run for run in waiting if run.scene in worker.scenes and run.served <= least + SLACK]
        return min(at_hand or waiting, key=lambda run: run.served)

    def _cut_batch(self, run: "_Run") -> "_Ticket":
        """A new batch from the run's oldest generation."""
        chunk = run.chunks.popleft()
        n = run.pace.rows(len(chunk), self.workers)
        if n < len(chunk):
            run.chunks.appendleft(chunk.part(b"", slice(n, None), 0))
        return self._ticket(chunk.part(self._new_id(), slice(n), 0))

    def _lease(self, ticket: "_Ticket", worker: "_Worker", run: "_Run", now: float) -> Lease:
        batch = ticket.batch
        self._served = run.served
        run.served += len(batch) * (run.pace.seconds_per_row or 0.0)
        if not worker.batches:
            worker.progress = now
        worker.uses(batch.scene)
        ticket.attempts += 1
        ticket.since = now
        ticket.leased.add(worker.wid)
        self._hold(ticket, worker)
        self.counters["leased"] += 1
        return Lease(worker.wid, worker.number, ticket.attempts, batch)

    def _new_id(self) -> bytes:
        self._cut += 1
        return struct.pack(">QQ", self._epoch, self._cut)

    def _ticket(self, batch: Batch) -> "_Ticket":
        ticket = _Ticket(batch)
        self._tickets[batch.id] = ticket
        return ticket

    def _hold(self, ticket: "_Ticket", worker: "_Worker") -> None:
        ticket.holder = worker.wid
        worker.batches[ticket.batch.id] = None

    # Giving back.

    def _may_keep(self, wid: str, batch_id: bytes) -> bool:
        """Whether a worker that rejoins may go on with a batch it holds."""
        ticket = self._tickets.get(batch_id)
        return ticket is not None and wid in ticket.leased and ticket.holder in (None, wid)

    def _take_back(self, ticket: "_Ticket", worker: "_Worker") -> None:
        """Let a worker go on with its batch, though it may have been queued again."""
        if ticket.holder is None:
            self._runs[ticket.batch.run].queued.remove(ticket)
        self._hold(ticket, worker)

    def _requeue(self, batch_ids: Iterable[bytes]) -> int:
        tickets = [self._tickets[batch_id] for batch_id in batch_ids if batch_id in self._tickets]
        for ticket in tickets:
            ticket.holder = None
            self._runs[ticket.batch.run].queued.append(ticket)
        self.counters["requeued"] += len(tickets)
        return len(tickets)

    def _give_up(self, worker: "_Worker", reason: str) -> Lost:
        requeued = self._requeue(worker.batches)
        worker.batches.clear()
        return Lost(worker.wid, reason, requeued)

    # Settling.

    def _judge(self, wid: str, result: Result) -> Settlement:
        ticket = self._tickets.get(result.batch) or self._settled.get(result.batch)
        if result.epoch != self._epoch or (ticket is not None and wid not in ticket.leased):
            return Settlement.FOREIGN
        if ticket is None:
            return Settlement.UNKNOWN
        if result.batch in self._tickets:
            return Settlement.FRESH
        return Settlement.DUPLICATE if ticket.winner == wid else Settlement.LATE

    def _release(self, wid: str, batch_id: bytes, now: float) -> None:
        """Give a worker its credit back."""
        worker = self._workers.get(wid)
        if worker is not None:
            worker.progressed(now)
            worker.batches.pop(batch_id, None)

    def _learn(self, ticket: "_Ticket", wid: str, cpu_seconds: float, now: float) -> None:
        self._runs[ticket.batch.run].pace.measure(len(ticket.batch), cpu_seconds)
        if ticket.holder == wid:
            self._patience.measure(now - ticket.since)

    def _remember(self, ticket: "_Ticket", winner: str | None) -> None:
        """Move a batch from the open ones to the settled ones."""
        batch = ticket.batch
        if ticket.holder is None and batch.run in self._runs:
            self._runs[batch.run].queued.remove(ticket)
        del self._tickets[batch.id]
        self._settled[batch.id] = _Ticket(_nothing(batch), leased=ticket.leased, winner=winner)
        if len(self._settled) > REMEMBERED:
            self._settled.popitem(last=False)

    def _split(self, batch: Batch, result: Result, rows: Rows) -> Settled:
        """Give what is settled; queue failed rows again, until they have failed too often."""
        failed = {failure.row: failure.reason for failure in result.failures}
        self.counters["failures"] += len(failed)
        done = complete(rows, batch, failed)
        if batch.failed + 1 < STRIKES:
            self._retry(batch, sorted(failed))
            return Settled(Settlement.FRESH, np.delete(done, list(failed)), result.cpu_seconds)
        self.counters["errors"] += len(failed)
        failures = tuple(Failure(row=place, reason=reason) for place, reason in failed.items())
        return Settled(Settlement.FRESH, done, result.cpu_seconds, failures)

    def _retry(self, batch: Batch, places: Iterable[int]) -> None:
        """Queue rows of a settled batch again, each in a batch of its own."""
        for place in places:
            row = batch.part(self._new_id(), slice(place, place + 1), batch.failed + 1)
            self._runs[batch.run].queued.append(self._ticket(row))


@dataclass(eq=False)
class _Ticket:
    """A batch and where it is."""

    batch: Batch
    attempts: int = 0
    holder: str | None = None
    """Who holds it; None: it is queued, or settled."""
    since: float = 0.0
    """When it was leased last."""
    leased: set[str] = field(default_factory=set)
    """All workers that were ever leased it."""
    winner: str | None = None
    """Who settled it."""


@dataclass
class _Run:
    """What is queued of a run."""

    pace: Pace
    chunks: deque[Batch] = field(default_factory=deque)
    """Rows that were never leased, a generation each, without an id."""
    queued: deque[_Ticket] = field(default_factory=deque)
    """Batches that are to be leased again."""
    served: float = 0.0
    """CPU seconds that were leased, made level with the others when work comes in."""

    @property
    def has_work(self) -> bool:
        return bool(self.chunks or self.queued)

    @property
    def scene(self) -> str:
        return self.queued[0].batch.scene if self.queued else self.chunks[0].scene

    @property
    def remaining(self) -> int:
        return sum(map(len, self.chunks)) + sum(len(ticket.batch) for ticket in self.queued)


@dataclass
class _Worker:
    """What is known of a worker."""

    wid: str
    number: int
    credit: int
    progress: float
    """When it last showed progress, or was leased its first batch."""
    batches: dict[bytes, None] = field(default_factory=dict)
    scenes: OrderedDict[str, None] = field(default_factory=OrderedDict)
    gone_at: float | None = None
    is_stuck: bool = False
    """It let a lease pass; until it shows progress it gets no work, unless all are stuck."""

    @property
    def is_leased(self) -> bool:
        return bool(self.batches) and self.gone_at is None

    def progressed(self, now: float) -> None:
        self.progress = now
        self.is_stuck = False

    def uses(self, scene: str) -> None:
        self.scenes[scene] = None
        self.scenes.move_to_end(scene)
        if len(self.scenes) > SCENES:
            self.scenes.popitem(last=False)


def _check(batch: Batch, result: Result) -> None:
    if result.n != len(batch):
        raise MessageError(f"a result has {result.n} rows, its batch {len(batch)}")
    for failure in result.failures:
        if failure.row >= result.n:
            raise MessageError(f"a result of {result.n} rows names row {failure.row} as failed")


def _nothing(batch: Batch) -> Batch:
    """A batch without its rows, to remember it by."""
    return batch.part(batch.id, slice(0), batch.failed)
