"""Dispatch: which worker gets which batch, and which result counts.

Rules 1, 5 and 6 of docs/bus.md as plain state. Evaluation is pure, so whatever is lost in flight is
evaluated again, and the first result of a batch is as good as any other. Time is passed in, in seconds of
any steady clock.
"""

from collections import OrderedDict, deque
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from math import inf

import numpy as np

from qdgrasp_coordinator.scheduler.batch_queue import (
    Batch,
    BatchQueue,
    Lease,
    RunRef,
    Settlement,
    SettleReply,
    complete_rows,
)
from qdgrasp_coordinator.scheduler.pipeline import Generation
from qdgrasp_coordinator.scheduler.shape_queue import BuildLease, BuildReply, ShapeBuild, ShapeQueue
from qdgrasp_coordinator.scheduler.worker_registry import Worker, WorkerRegistry
from qdgrasp_protocol.build_messages import Built, ShapeTask
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Failure, Join, Result
from qdgrasp_protocol.rows import Rows

MOST_SETTLED = 10_000
"""Settled batches that are remembered, to tell duplicate and late results from unknown ones."""


@dataclass(eq=False)
class BatchState:
    """A batch, or a build, that was leased and is not settled."""

    batch: Batch | ShapeBuild
    attempts: int = 0
    holder: str | None = None
    """Worker that holds it; None: it waits."""
    since: float = 0.0
    """When it was leased last."""
    leased: set[str] = field(default_factory=set)
    """All workers that were ever leased it."""


class BatchTable:
    """Batches that were leased and not settled, and the latest settled ones."""

    def __init__(self, epoch: int) -> None:
        self._epoch = epoch
        self._open: dict[bytes, BatchState] = {}
        self._settled: OrderedDict[bytes, tuple[set[str], str | None]] = OrderedDict()
        """By id: the workers that were leased it, and that which settled it; None: it was withdrawn."""

    def open(self, batch: Batch | ShapeBuild) -> BatchState:
        """Return the state of a batch that is leased, made at its first lease."""
        return self._open.setdefault(batch.id, BatchState(batch))

    @property
    def leased(self) -> int:
        """Number of batches that workers hold."""
        return sum(state.holder is not None for state in self._open.values())

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
    if result.n != len(batch):
        raise MessageError(f"a result has {result.n} rows, its batch {len(batch)}")
    for failure in result.failures:
        if failure.row >= result.n:
            raise MessageError(f"a result of {result.n} rows names row {failure.row} as failed")


MOST_BUILD_LEASES = 5  # Leases of a build without an answer after which it is not leased again
BUILDER_SECONDS = 30.0  # Seconds for which a worker that has the code for a build is waited for
STRIKES = 3  # Failures of the simulator after which a row is settled as an error
_COUNTED = ("leased", "requeued", "failures", "errors")


class Dispatcher:
    """Leases the rows of all runs of a job to its workers.

    A batch has `batch_size` rows; None: as many as take about a quarter of a second.
    """

    def __init__(self, epoch: int, workers: WorkerRegistry, batch_size: int | None = None) -> None:
        self.counters = dict.fromkeys((*(kind.value for kind in Settlement), *_COUNTED), 0)
        """Results by kind, batches leased and queued again, rows failed and given up."""
        self._workers = workers
        self._queue = BatchQueue(batch_size)
        self._shapes = ShapeQueue()
        self._unanswered: deque[ShapeTask] = deque()  # Builds that were leased too often without an answer
        self._lacks_builder_since = inf
        self._batches = BatchTable(epoch)

    def submit(self, run: RunRef, generation: Generation) -> None:
        """Queue rows of one generation of a run."""
        self._queue.submit(run, generation)

    def withdraw(self, run: str) -> dict[str, list[bytes]]:
        """Forget all rows of a run; gives the batches that workers may drop, by worker."""
        self._queue.withdraw(run)
        return self._withdraw(self._batches.of(run))

    def _withdraw(self, states: list[BatchState]) -> dict[str, list[bytes]]:
        drops: dict[str, list[bytes]] = {}
        for state in states:
            if state.holder is not None:
                drops.setdefault(state.holder, []).append(state.batch.id)
                self._workers.release(state.holder, state.batch.id)
            self._batches.close(state)
        return drops

    def build(self, tasks: Iterable[ShapeTask]) -> None:
        """Queue shapes that are to be built."""
        self._shapes.submit(tasks)

    def withdraw_builds(self) -> dict[str, list[bytes]]:
        """Forget all builds; gives those that workers may drop, by worker."""
        self._shapes.clear()
        self._unanswered.clear()
        return self._withdraw(self._batches.builds)

    def unbuildable(self, now: float) -> list[ShapeTask]:
        """Take back at most one build that waits and that no worker here is likely to do.

        It was leased often without an answer, failed on all workers with the code for it, or there has been
        no such worker that is well for `BUILDER_SECONDS`, while there were others.
        """
        if self._unanswered:
            return [self._unanswered.popleft()]
        if not self._shapes:
            self._lacks_builder_since = inf
            return []
        workers = [worker for worker in self._workers if worker.is_well]
        codes = {worker.join.builds for worker in workers}
        build = next((build for build in self._shapes if self._has_failed_everywhere(build, workers)), None)
        if build is None and workers and all(build.task.code not in codes for build in self._shapes):
            self._lacks_builder_since = min(self._lacks_builder_since, now)
            is_late = now >= self._lacks_builder_since + BUILDER_SECONDS
            build = next(iter(self._shapes)) if is_late else None
        elif build is None:
            self._lacks_builder_since = inf
        if build is None:
            return []
        self._shapes.remove(build)
        if (state := self._batches.find(build.id)) is not None:
            self._batches.close(state)
        return [build.task]

    def _has_failed_everywhere(self, build: ShapeBuild, workers: Iterable[Worker]) -> bool:
        able = {worker.wid for worker in workers if worker.join.builds == build.task.code}
        return bool(able) and able <= build.failed_by

    @property
    def queued_seconds(self) -> float:
        """Expected cost of the rows that wait for a worker [CPU s]."""
        return self._queue.seconds

    def wanted_workers(self, *, is_leasing: bool) -> int:
        """Return how many workers leased batches, and rows and builds to be leased, could keep busy."""
        return self._batches.leased + (self._queue.batches + len(self._shapes) if is_leasing else 0)

    @property
    def strays(self) -> int:
        """Number of dropped results: late, duplicate, unknown or foreign."""
        return sum(self.counters[kind.value] for kind in Settlement if kind is not Settlement.FRESH)

    def leases(self, now: float) -> list[Lease]:
        """Lease what is queued to workers with credit left; send them in this order."""
        leases: list[Lease] = []
        for worker in self._workers.idle(now) if self._queue else ():
            rows = worker.join.rows
            run = self._queue.next_run(worker.scenes, rows > 0)
            if run is None:
                if not self._queue:
                    break
                continue
            batch = self._queue.pop(run, len(self._workers), rows)
            leases.append(Lease(worker.wid, worker.join.number, self._lease(batch, worker, now), batch))
        return leases

    def build_leases(self, now: float) -> list[BuildLease]:
        """Lease builds that wait to workers that have the code for them; send them before batches."""
        leases: list[BuildLease] = []
        for worker in self._workers.idle(now) if self._shapes else ():
            if (build := self._shapes.pop(worker.wid, worker.join.builds)) is not None:
                attempt = self._lease(build, worker, now)
                leases.append(BuildLease(worker.wid, worker.join.number, attempt, build))
        return leases

    def _lease(self, batch: Batch | ShapeBuild, worker: Worker, now: float) -> int:
        """Lease a batch or build to a worker; returns how many leases of it there were."""
        state = self._batches.open(batch)
        state.attempts += 1
        state.since = now
        state.leased.add(worker.wid)
        self._hand_over(state, worker, now)
        self.counters["leased"] += 1
        return state.attempts

    def join(self, join: Join, now: float) -> list[bytes]:
        """Admit a worker, or admit it again; returns the batches that it is to drop.

        What it was leased and does not hold is queued again. A join older than the latest changes nothing.
        Raises Refused if it is not admitted.
        """
        before = self._workers.join(join, now)
        worker = self._workers.get(join.wid)
        if before is None or worker is None:
            return []
        listed = list(dict.fromkeys(join.held))
        kept = {batch_id: state for batch_id in listed if (state := self._own(join.wid, batch_id))}
        self.requeue(batch_id for batch_id in before if batch_id not in kept)
        for state in kept.values():
            self._remove(state.batch)
            self._hand_over(state, worker, now)
        return [batch_id for batch_id in listed if batch_id not in kept]

    def requeue(self, batch_ids: Iterable[bytes]) -> int:
        """Queue the unsettled batches again that a worker holds no more; returns their number."""
        states = [state for batch_id in batch_ids if (state := self._batches.find(batch_id))]
        for state in states:
            state.holder = None
            if isinstance(state.batch, ShapeBuild) and state.attempts >= MOST_BUILD_LEASES:
                self._batches.close(state)
                self._unanswered.append(state.batch.task)
            else:
                self._requeue(state.batch)
        self.counters["requeued"] += len(states)
        return len(states)

    def _requeue(self, batch: Batch | ShapeBuild) -> None:
        if isinstance(batch, Batch):
            self._queue.requeue(batch)
        else:
            self._shapes.requeue(batch)

    def _remove(self, batch: Batch | ShapeBuild) -> None:
        if isinstance(batch, Batch):
            self._queue.remove(batch)
        else:
            self._shapes.remove(batch)

    def _hand_over(self, state: BatchState, worker: Worker, now: float) -> None:
        state.holder = worker.wid
        scene = state.batch.run.scene if isinstance(state.batch, Batch) else None
        self._workers.hold(worker, state.batch.id, scene, now)

    def _own(self, wid: str, batch_id: bytes) -> BatchState | None:
        """Return a batch that a worker may go on with, held by it or waiting; else None."""
        state = self._batches.find(batch_id)
        is_own = state is not None and wid in state.leased and state.holder in (None, wid)
        return state if is_own else None

    def settle(self, wid: str, result: Result, rows: Rows, now: float) -> SettleReply:
        """Settle a result: the first of a batch counts, if its sender was leased the batch.

        Keys and genomes are filled into `rows`, the unpacked columns of the result that came on the key of
        worker `wid`. Raises MessageError if it has another number of rows than its batch, or names a failed
        row that the batch has not.
        """
        kind, state = self._close(wid, result, now)
        if state is None or not isinstance(state.batch, Batch):
            return SettleReply(kind)
        self._queue.measure(state.batch, result.cpu_seconds)
        if state.holder == wid:
            self._workers.lease_timeout.measure(now - state.since)
        return replace(self._split(state.batch, result, rows), superseded=self._release_other(state, wid))

    def settle_build(self, wid: str, built: Built, now: float) -> BuildReply | None:
        """Settle the answer to a build; None: it is dropped, or the build is tried again.

        A build that failed is tried again until it failed too often. Raises MessageError as `settle`.
        """
        if self._is_at_another(wid, built):
            self._workers.answered(wid, built.batch, now)
            return None
        _, state = self._close(wid, built, now)
        if state is None or not isinstance(state.batch, ShapeBuild):
            return None
        superseded = self._release_other(state, wid)
        if built.reason and not built.is_final and len(state.batch.failed_by) + 1 < STRIKES:
            self._shapes.requeue_failed(state.batch, wid)
            return None
        return BuildReply.of(state.batch, built, superseded)

    def _is_at_another(self, wid: str, built: Built) -> bool:
        """Return whether a build failed on a worker while another one goes on with it."""
        is_fresh = self._batches.classify(wid, built) is Settlement.FRESH
        state = self._batches.find(built.batch) if is_fresh and built.reason and not built.is_final else None
        return state is not None and state.holder not in (None, wid)

    def _close(self, wid: str, result: Result | Built, now: float) -> tuple[Settlement, BatchState | None]:
        """Settle a batch or build by its first result; gives its state if this is that one."""
        kind = self._batches.classify(wid, result)
        self.counters[kind.value] += 1
        if kind is not Settlement.FOREIGN:
            self._workers.answered(wid, result.batch, now)
        state = self._batches.find(result.batch) if kind is Settlement.FRESH else None
        if state is not None:
            self._remove(state.batch)
            self._batches.close(state, winner=wid)
        return kind, state

    def _release_other(self, state: BatchState, winner: str) -> str | None:
        """Free the credit of another holder of a settled batch; returns that one."""
        if state.holder in (None, winner):
            return None
        self._workers.release(state.holder, state.batch.id)
        return state.holder

    def _split(self, batch: Batch, result: Result, rows: Rows) -> SettleReply:
        """Return the settled rows; queue failed ones again until they failed too often."""
        failed = {failure.row: failure.reason for failure in result.failures}
        self.counters["failures"] += len(failed)
        complete_rows(rows, batch, failed)
        if not failed:
            return SettleReply(Settlement.FRESH, rows, result.cpu_seconds)
        if batch.failed + 1 < STRIKES:
            for place in sorted(failed):
                self._queue.requeue_row(batch, place)
            return SettleReply(Settlement.FRESH, np.delete(rows, list(failed)), result.cpu_seconds)
        self.counters["errors"] += len(failed)
        failures = tuple(Failure(row=place, reason=reason) for place, reason in failed.items())
        return SettleReply(Settlement.FRESH, rows, result.cpu_seconds, failures)
