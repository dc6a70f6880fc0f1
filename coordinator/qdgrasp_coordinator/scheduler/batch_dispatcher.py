"""Dispatch: which worker gets which batch or build, and which answer counts.

Rules 1, 5 and 6 of docs/bus.md as plain state. Evaluation is pure, so a batch that is lost in flight
is evaluated again, and the first result of a batch is as good as any other. Time is passed in, in seconds of
any steady clock.
"""

from collections import OrderedDict, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from math import inf

import numpy as np

from qdgrasp_coordinator.scheduler.auditor import check_result, complete_rows
from qdgrasp_coordinator.scheduler.batch_queue import (
    Audit,
    Batch,
    BatchQueue,
    Probe,
    RunRef,
    ShapeBuild,
    Task,
)
from qdgrasp_coordinator.scheduler.pipeline import Generation
from qdgrasp_coordinator.scheduler.run_plan import BuildReply
from qdgrasp_coordinator.scheduler.worker_registry import STRAGGLER_TURNAROUNDS, Worker, WorkerRegistry
from qdgrasp_protocol.build_messages import Build, Built, ShapeTask
from qdgrasp_protocol.messages import Failure, Join, Result, Work
from qdgrasp_protocol.rows import Rows

STRIKES = 3
"""Tries of a row that fails, or leases of a build, after which it is given up."""
PAUSE_SECONDS, FEW_ROWS = 10.0, 4
"""Seconds between two tries of rows while all fail; with so few rows there is nothing to compare with."""
EVERY_ROW = f"every row fails, tried again each {PAUSE_SECONDS:.0f} s: {{}}"
MOST_SETTLED = 10_000
"""Settled batches that are remembered, to tell duplicate and late results from unknown ones."""
MOST_AUDITS = 128  # Audits that wait for a trusted worker; with so many no more are drawn
_COUNTED = ("leased", "requeued", "doubled", "failures", "errors")


@dataclass(frozen=True)
class Lease:
    """A batch or a build leased to a worker."""

    wid: str
    join: int
    """The worker's join number; the worker drops what it was sent for an older one."""
    attempt: int
    """Counts the leases of this batch, from 1."""
    task: Batch | ShapeBuild

    def message(self, epoch: int) -> Work | Build:
        """Return the message to the worker."""
        lease, task = {"epoch": epoch, "attempt": self.attempt, "join": self.join}, self.task
        if isinstance(task, ShapeBuild):
            return Build(batch=task.id, task=task.task, **lease)
        return Work(
            batch=task.id,
            run=task.run.run,
            scene=task.run.scene,
            prior=task.run.prior,
            generation=task.rows.number,
            n=len(task),
            genes=task.rows.genomes.shape[1],
            columns={
                "index": task.rows.indices.astype("<u4").tobytes(),
                "trial": task.rows.trials.astype("<u2").tobytes(),
                "genome": task.rows.genomes.astype("<f4").tobytes(),
            },
            **lease,
        )


class Settlement(Enum):
    """Kinds of results."""

    FRESH = "fresh"
    """The first result of its batch: it is taken, all others are dropped."""
    LATE = "late"
    """The batch was settled, or is not known any more."""
    FOREIGN = "foreign"
    """A result of another epoch, or from a worker that was never leased this batch."""


@dataclass(frozen=True)
class SettleReply:
    """Rows and holders that a result settles."""

    rows: Rows
    """Settled rows with keys, genomes and results, in the order of the batch."""
    cpu_seconds: float
    """Cost of the batch [CPU s]."""
    failures: tuple[Failure, ...] = ()
    """Reasons of final failures, by place in `rows`, which hold `Outcome.ERROR` and zeros."""
    audit: Audit | None = None
    """What was audited, if the batch was an audit."""


class Dispatcher:
    """Leases the rows of all runs of a job, and builds of shapes, to its workers.

    A batch has `batch_size` rows; None: as many as take about a quarter of a second.
    """

    # Everything that was asked and is not settled is in one place: it waits in the queue, or is held by a
    # worker, or by two where the first is slow. Only `settle`, `withdraw` and `give_up_build` take it out.

    def __init__(self, epoch: int, workers: WorkerRegistry, batch_size: int | None = None) -> None:
        self.counters = dict.fromkeys((*(kind.value for kind in Settlement), *_COUNTED), 0)
        """Results by kind; batches leased, queued again, leased to a second worker; rows failed, given up."""
        self._workers = workers
        self._queue = BatchQueue(batch_size)
        self._epoch = epoch
        self._open: OrderedDict[bytes, Batch | ShapeBuild] = OrderedDict()
        """What was leased and is not settled, by id; the latest leases are at the end."""
        self._settled: OrderedDict[bytes, set[str]] = OrderedDict()
        """The latest that was settled, by id: the workers that were leased it."""
        self._builds: deque[ShapeBuild] = deque()  # That wait for a worker
        self._healthy_at = -inf  # When the latest batch was leased of which rows were evaluated
        self._known: dict[str, tuple[RunRef, Generation]] = {}  # A row that was evaluated, by run
        self._is_probing = False  # One of these is evaluated again
        self._rows = 0  # That were submitted
        self.trouble = ""
        """The reason why all rows fail; empty if some are evaluated."""
        self._lease_at = -inf  # When rows are leased again though all fail

    def submit(self, run: RunRef, generation: Generation) -> None:
        """Queue rows of one generation of a run."""
        self._rows += len(generation)
        self._queue.submit(run, generation)

    def withdraw(self, run: str, *, audits: bool = True) -> dict[str, list[bytes]]:
        """Forget the rows of a run, and its `audits`; gives batches that workers may drop."""
        self._queue.withdraw(run, audits=audits)
        self._known.pop(run, None)
        self._is_probing = False
        tasks = (task for task in self._open.values() if isinstance(task, Batch) and task.run.run == run)
        return self._withdraw([task for task in tasks if audits or not isinstance(task, Probe)])

    def audit(self, run: RunRef, rows: Rows, maker: str, answer: Rows | None = None) -> None:
        """Have a trusted worker evaluate rows (n,) of a generation again; `answer`: to confirm it."""
        asked = Generation(int(rows["generation"][0]), rows["index"], rows["trial"], rows["genome"])
        if answer is not None or len(self._queue.audits) < MOST_AUDITS:
            audit = Audit(id=self._queue.new_id(), run=run, rows=asked, recorded=rows, answer=answer)
            audit.tried_by = (maker,)
            self._queue.requeue(audit)

    def awaits_audit(self, run: str) -> bool:
        """Return whether rows of a run are to be audited, and a trusted worker is there."""
        audits = [*self._queue.audits, *(task for task in self._open.values() if isinstance(task, Audit))]
        is_trusted_there = any(worker.is_trusted and worker.is_well for worker in self._workers)
        return is_trusted_there and any(audit.run.run == run for audit in audits)

    def _withdraw(self, tasks: Iterable[Task]) -> dict[str, list[bytes]]:
        drops: dict[str, list[bytes]] = {}
        for task in tasks:
            for holder in task.holders:
                drops.setdefault(holder, []).append(task.id)
                self._workers.release(holder, task.id)
            self._close(task)
        return drops

    def _close(self, task: Task) -> None:
        """Move a batch or build to the settled ones, without its rows."""
        del self._open[task.id]
        self._settled[task.id] = task.leased
        if len(self._settled) > MOST_SETTLED:
            self._settled.popitem(last=False)

    @property
    def queued_seconds(self) -> float:
        """Expected cost of the rows that wait for a worker [CPU s]."""
        return self._queue.seconds

    def wanted_workers(self, *, is_leasing: bool) -> int:
        """Return how many workers leased batches, and rows and builds to be leased, could keep busy."""
        leased = sum(bool(task.holders) for task in self._open.values())
        return leased + (self._queue.batches + len(self._builds) if is_leasing else 0)

    @property
    def strays(self) -> int:
        """Number of dropped results: late or foreign."""
        return self.counters["late"] + self.counters["foreign"]

    # Leases.

    def leases(self, now: float) -> list[Lease]:
        """Lease what waits to workers with credit left, builds first; send them in this order.

        Where nothing waits, idle workers are leased batches that others have held for long.
        """
        leases = [self._lease(build, worker, now) for build, worker in self._next_builds()]
        if self.trouble and now < self._lease_at:
            return leases
        self._lease_at = now + PAUSE_SECONDS
        for worker in self._workers.idle() if self._queue or self._queue.tried else ():
            batch = self._next_batch(worker, now)
            if batch is not None:
                leases.append(self._lease(batch, worker, now))
            elif not (self._queue or self._queue.tried):
                break
        if not self._queue:
            leases += self._double_leases(now)
        return leases

    def _next_builds(self) -> Iterator[tuple[ShapeBuild, Worker]]:
        for worker in self._workers.idle() if self._builds else ():
            code = worker.join.builds
            fitting = (build for build in self._builds if code and build.task.code == code)
            build = next((build for build in fitting if build.attempts < STRIKES), None)
            if build is not None:
                self._builds.remove(build)
                yield build, worker

    def _next_batch(self, worker: Worker, now: float) -> Batch | None:
        """Return the next batch for a worker, if there is one."""
        rows = worker.join.rows
        batch = self._queue.pop_tried(lambda one: self._may_have(worker, one, now))
        if batch is not None:
            return batch
        run = self._queue.next_run(worker.scenes, rows > 0)
        return None if run is None else self._queue.pop(run, len(self._workers), rows)

    def _may_have(self, worker: Worker, batch: Batch, now: float) -> bool:
        """Return whether a worker may have an audit, or a row that failed, on others first."""
        if isinstance(batch, Audit):
            return worker.is_trusted
        if batch.run.needs_device and not worker.join.rows:
            return False
        tried = self._tried(batch)
        if not (worker.is_proven or self._workers.proven <= tried):
            return False
        if len(batch.tried_by) >= STRIKES:
            return not (self._known or self._queue) or not self._may_be_shared(batch)
        return worker.wid not in tried or not self._workers.expects_other(tried, now)

    def _tried(self, batch: Batch) -> set[str]:
        """Return the workers that had a batch before others should; none once it failed too often."""
        return set(batch.tried_by) if len(batch.tried_by) < STRIKES else set()

    def _double_leases(self, now: float) -> Iterator[Lease]:
        """Lease to idle workers batches that others have held for long; these keep them too.

        Who has them is proven no more. They go to a proven worker each, or while there is none to all: a
        silent worker is not waited for, nor the next one that turns out to be silent.
        """
        late = self._late(now)
        for holder in {holder for batch in late for holder in batch.holders}:
            self._workers.mark_late(holder)
        is_any_proven = bool(self._workers.proven)
        for worker in self._workers.idle() if late else ():
            if worker.batches or not late or worker.is_proven < is_any_proven:
                return
            batch = next((one for one in late if self._may_double(worker, one)), None)
            if batch is not None:
                late.remove(batch)
                late += [] if is_any_proven else [batch]
                self.counters["doubled"] += 1
                yield self._lease(batch, worker, now)

    def _late(self, now: float) -> list[Batch]:
        """Return batches that their holders have had for long, those had for longest first.

        The more holders, the longer, and the sooner if none is proven. Rows on which others failed may end
        any worker's process: they count once a lease may be over.
        """
        timeout, proven, found = self._workers.lease_timeout, self._workers.proven, []
        soon = timeout.straggling / STRAGGLER_TURNAROUNDS if proven else timeout.straggling
        for task in self._open.values():
            if isinstance(task, ShapeBuild | Probe) or not task.holders:
                continue
            age = now - max(task.holders.values())
            if age < soon:
                break
            patience = timeout.limit if task.tried_by else timeout.straggling
            if age >= len(task.holders) * (soon if proven.isdisjoint(task.holders) else patience):
                found.append(task)
        return found

    def _may_double(self, worker: Worker, batch: Batch) -> bool:
        return worker.wid not in self._tried(batch) | batch.holders.keys() and not (
            batch.run.needs_device and not worker.join.rows
        )

    def _lease(self, task: Batch | ShapeBuild, worker: Worker, now: float) -> Lease:
        if isinstance(task, Batch) and len(task.tried_by) + 1 >= STRIKES:
            task.may_be_shared = self._may_be_shared(task)
        task.attempts, task.leased_at = task.attempts + 1, min(task.leased_at, now)
        task.leased.add(worker.wid)
        self._hand_over(task, worker, now)
        self.counters["leased"] += 1
        return Lease(worker.wid, worker.join.number, task.attempts, task)

    def _hand_over(self, task: Batch | ShapeBuild, worker: Worker, now: float) -> None:
        """Record that a worker holds a batch or build from now on."""
        task.holders[worker.wid] = now
        self._open[task.id] = task
        self._open.move_to_end(task.id)
        scene = task.run.scene if isinstance(task, Batch) else None
        self._workers.hold(worker, task.id, scene, now)

    # Workers come and go.

    def join(self, join: Join, now: float) -> list[bytes]:
        """Admit a worker, or admit it again; returns the batches that it is to drop.

        Batches leased to it that it does not hold are queued again. A join older than the latest changes
        nothing. Raises Refused if it is not admitted.
        """
        before = self._workers.join(join, now)
        worker = self._workers.get(join.wid)
        if before is None or worker is None:
            return []
        # The worker says what it still holds: messages of both sides may have been lost since it joined last.
        listed = list(dict.fromkeys(join.held))
        kept = {task_id: task for task_id in listed if (task := self._own(join.wid, task_id))}
        self.requeue(join.wid, [task_id for task_id in before if task_id not in kept])
        for task in kept.values():
            self._remove(task)
            self._hand_over(task, worker, now)
        return [task_id for task_id in listed if task_id not in kept]

    def _own(self, wid: str, task_id: bytes) -> Batch | ShapeBuild | None:
        """Return a batch that a worker may go on with, held by it or waiting; else None."""
        task = self._open.get(task_id)
        is_own = task is not None and wid in (task.holders or task.leased)
        return task if is_own else None

    def requeue(self, wid: str, task_ids: Iterable[bytes]) -> int:
        """Queue unsettled batches that a worker has lost and no other holds; returns their number."""
        held = [task for task_id in task_ids if (task := self._open.get(task_id))]
        for task in held:
            task.holders.pop(wid, None)
        lost = [task for task in held if not task.holders]
        for task in lost:
            self._requeue(task)
        self.counters["requeued"] += len(lost)
        return len(lost)

    def _requeue(self, task: Batch | ShapeBuild) -> None:
        if isinstance(task, Batch):
            self._queue.requeue(task)
        elif task not in self._builds:
            self._builds.appendleft(task)

    def _remove(self, task: Batch | ShapeBuild) -> None:
        """Take a batch or build out of the queue, if it waits there to be leased again."""
        if isinstance(task, Batch):
            self._queue.remove(task)
        elif task in self._builds:
            self._builds.remove(task)

    # Answers.

    def settle(self, wid: str, result: Result, rows: Rows, now: float) -> SettleReply | None:
        """Settle a result: the first of a batch counts; None: dropped.

        Its sender must have been leased the batch. Keys and genomes are filled into `rows`, the unpacked
        columns of the result. Raises MessageError if its run or number of rows is not its batch's, or it
        names a failed row that the batch has not.
        """
        batch = self._take(wid, result, now)
        if not isinstance(batch, Batch):
            return None
        if isinstance(batch, Audit):
            complete_rows(rows, batch, {failure.row for failure in result.failures})
            return SettleReply(rows, result.cpu_seconds, audit=batch)
        if isinstance(batch, Probe):
            self._on_probe(batch, wid, result, now)
            return None
        self._queue.measure(batch, result.cpu_seconds)
        if wid in batch.holders:
            self._workers.lease_timeout.measure(now - batch.holders[wid])
        complete_rows(rows, batch, {failure.row for failure in result.failures})
        return self._split(batch, wid, result, rows, now)

    def _split(self, batch: Batch, wid: str, result: Result, rows: Rows, now: float) -> SettleReply:
        """Return the settled rows; queue failed ones for other workers until they failed too often."""
        failed = {failure.row: failure.reason for failure in result.failures}
        self.counters["failures"] += len(failed)
        if good := [place for place in range(len(batch)) if place not in failed]:
            self._known[batch.run.run] = (batch.run, batch.rows[good[0] : good[0] + 1])
            self._note_health(batch)
        is_last = len(batch.tried_by) + 1 >= STRIKES
        if failed and is_last and batch.may_be_shared:
            self._suspect_fault(next(iter(failed.values())))
        if not is_last or batch.may_be_shared:
            for place in sorted(failed):
                self._queue.requeue_row(batch, place, wid, now)
            settled = np.delete(rows, list(failed)) if failed else rows
            return SettleReply(settled, result.cpu_seconds)
        self.counters["errors"] += len(failed)
        failures = tuple(Failure(row=place, reason=reason) for place, reason in failed.items())
        return SettleReply(rows, result.cpu_seconds, failures)

    def _may_be_shared(self, batch: Batch) -> bool:
        """Return whether a row may fail for a reason that all share: no later one was evaluated."""
        is_first_of_many = self._healthy_at == -inf and self._rows > FEW_ROWS
        return self._healthy_at < batch.failed_at and bool(self._known or is_first_of_many)

    def _note_health(self, batch: Batch) -> None:
        """Note that a row was evaluated."""
        self._healthy_at, self.trouble = max(self._healthy_at, batch.leased_at), ""

    def _suspect_fault(self, reason: str) -> None:
        """Find out whether all rows fail as one did: by a row that was evaluated before."""
        if not self._known:
            self.trouble = EVERY_ROW.format(reason)
        elif not self._is_probing:
            self._is_probing, (run, row) = True, next(reversed(self._known.values()))
            self._queue.requeue(Probe(id=self._queue.new_id(), run=run, rows=row))

    def _on_probe(self, probe: Probe, wid: str, result: Result, now: float) -> None:
        if not result.failures:
            self._note_health(probe)
        elif len(probe.tried_by) + 1 < STRIKES:
            self._queue.requeue_row(probe, 0, wid, now)
            return
        self._is_probing = False
        for failure in result.failures:
            self.trouble = EVERY_ROW.format(failure.reason)
            self._suspect_fault(failure.reason)

    def _take(self, wid: str, result: Result | Built, now: float) -> Batch | ShapeBuild | None:
        """Settle a batch or build by its first result; gives it if this is that one."""
        kind = self._classify(wid, result)
        self.counters[kind.value] += 1
        if kind is not Settlement.FOREIGN:
            self._workers.answered(wid, result.batch, now, is_first=kind is Settlement.FRESH)
        task = self._open.get(result.batch) if kind is Settlement.FRESH else None
        if task is not None:
            self._remove(task)
            self._close(task)
        return task

    def _classify(self, wid: str, result: Result | Built) -> Settlement:
        """Return the kind of a result on a worker's key; MessageError if it does not fit its batch."""
        task = self._open.get(result.batch)
        leased = task.leased if task else self._settled.get(result.batch)
        if result.epoch != self._epoch or (leased is not None and wid not in leased):
            return Settlement.FOREIGN
        if task is not None:
            check_result(task, result)
            return Settlement.FRESH
        return Settlement.LATE

    # Builds.

    def build(self, tasks: Iterable[ShapeTask]) -> None:
        """Queue shapes that are to be built."""
        self._builds.extend(map(self._new_build, tasks))

    def _new_build(self, task: ShapeTask, attempts: int = 0) -> ShapeBuild:
        return ShapeBuild(id=self._queue.new_id(), task=task, attempts=attempts)

    def settle_build(self, wid: str, built: Built, now: float) -> BuildReply | None:
        """Settle the answer to a build; None: it is dropped, or the build is tried again.

        A build that failed is tried again until it was leased too often. Raises MessageError as `settle`.
        """
        build = self._open.get(built.batch)
        is_late = build is not None and wid in build.leased and build.holders.keys() - {wid}
        if is_late and built.reason and not built.is_final:  # another worker is at work on it
            self._workers.answered(wid, built.batch, now)
            return None
        build = self._take(wid, built, now)
        if not isinstance(build, ShapeBuild):
            return None
        if built.reason and not built.is_final and build.attempts < STRIKES:
            self._builds.appendleft(self._new_build(build.task, build.attempts))
            return None
        return BuildReply(build.task.key, built.pieces, built.reason, built.cpu_seconds)

    def give_up_build(self) -> ShapeTask | None:
        """Take one build back that no worker here is likely to do, if there is such a build.

        It was leased too often, or of the workers that are well none has the code for it.
        """
        codes = {worker.join.builds for worker in self._workers if worker.is_well}
        for build in self._builds:
            if build.attempts >= STRIKES or (codes and build.task.code not in codes):
                self._builds.remove(build)
                if build.id in self._open:
                    self._close(build)
                return build.task
        return None

    def withdraw_builds(self) -> dict[str, list[bytes]]:
        """Forget all builds; gives those that workers may drop, by worker."""
        self._builds.clear()
        return self._withdraw([task for task in self._open.values() if isinstance(task, ShapeBuild)])
