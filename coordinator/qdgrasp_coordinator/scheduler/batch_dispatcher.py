"""Dispatch: which worker gets which batch, and which result counts.

Rules 1, 5 and 6 of docs/bus.md as plain state. Evaluation is pure, so a batch that is lost in flight
is evaluated again, and the first result of a batch is as good as any other. Time is passed in, in seconds of
any steady clock.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from math import inf

import numpy as np

from qdgrasp_coordinator.scheduler.batch_queue import (
    Batch,
    BatchQueue,
    Lease,
    RunRef,
    Settlement,
    SettleReply,
    WorkerName,
    asked_rows,
    complete_rows,
)
from qdgrasp_coordinator.scheduler.batch_table import BatchState, BatchTable
from qdgrasp_coordinator.scheduler.cross_checks import (
    CHECKED_ROWS,
    CHECKED_SHARE,
    Check,
    CheckVerdict,
    CrossChecks,
    HeldResult,
)
from qdgrasp_coordinator.scheduler.pipeline import Generation
from qdgrasp_coordinator.scheduler.shape_queue import BuildLease, BuildReply, ShapeBuild, ShapeQueue
from qdgrasp_coordinator.scheduler.worker import Worker, names_of
from qdgrasp_coordinator.scheduler.worker_registry import WorkerRegistry
from qdgrasp_protocol.build_messages import Built, ShapeTask
from qdgrasp_protocol.messages import Failure, Join, Result
from qdgrasp_protocol.rows import Rows

MOST_BUILD_LEASES = 5  # Leases of a build without an answer after which it is not leased again
BUILDER_SECONDS = 30.0  # Seconds for which a worker that has the code for a build is waited for
STRIKES = 3
"""Workers on which a row failed after which it is settled as an error; where there are fewer, tries."""
EARLY_SECONDS = 5.0
"""Seconds after the first join in which a coordinator that took over expects workers to join again."""
_COUNTED = ("leased", "requeued", "doubled", "failures", "errors", "checked", "differing")


class Dispatcher:
    """Leases the rows of all runs of a job to its workers.

    A batch has `batch_size` rows; None: as many as take about a quarter of a second. The share `checked` of
    the rows is evaluated by a second worker.
    """

    def __init__(
        self,
        epoch: int,
        workers: WorkerRegistry,
        batch_size: int | None = None,
        checked: float = CHECKED_SHARE,
    ) -> None:
        self.counters = dict.fromkeys((*(kind.value for kind in Settlement), *_COUNTED), 0)
        """Results by kind; batches leased, queued again, leased to a second worker; rows failed, given up,
        checked, and in checks that differed."""
        self._sick: list[Worker] = []
        self.checks = CrossChecks(checked)
        self._verdicts: list[CheckVerdict] = []
        self._workers = workers
        self._queue = BatchQueue(batch_size)
        self._shapes = ShapeQueue()
        self._unanswered: deque[ShapeTask] = deque()  # Builds that were leased too often without an answer
        self._lacks_builder_since = inf
        self._batches = BatchTable(epoch)
        self._takes_over = epoch > 1
        self._first_join = inf

    def submit(self, run: RunRef, generation: Generation) -> None:
        """Queue rows of one generation of a run."""
        self._queue.submit(run, generation)

    def withdraw(self, run: str) -> dict[str, list[bytes]]:
        """Forget all rows of a run; gives the batches that workers may drop, by worker."""
        self._queue.withdraw(run)
        self.checks.withdraw(run)
        return self._withdraw(self._batches.of(run))

    def _withdraw(self, states: list[BatchState]) -> dict[str, list[bytes]]:
        drops: dict[str, list[bytes]] = {}
        for state in states:
            for holder in state.holders:
                drops.setdefault(holder, []).append(state.batch.id)
                self._workers.release(holder, state.batch.id)
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
        """Lease what is queued to workers with credit left; send them in this order.

        Where nothing waits, idle workers are leased batches that others have held for long.
        """
        leases: list[Lease] = []
        for worker in self._workers.idle(now) if self._queue or self._queue.has_tried else ():
            batch = self._next_batch(worker, now)
            if batch is not None:
                leases.append(self._lease_batch(batch, worker, now))
            elif not (self._queue or self._queue.has_tried):
                break
        if not self._queue:
            leases += self._double_leases(now)
        return leases

    def _next_batch(self, worker: Worker, now: float) -> Batch | None:
        """Return the next batch for a worker, if there is one."""
        rows = worker.join.rows
        batch = self._queue.pop_tried(lambda one: self._may_have(worker, one, now))
        if batch is not None:
            return batch
        run = self._queue.next_run(worker.scenes, rows > 0)
        return None if run is None else self._queue.pop(run, len(self._workers), rows)

    def _may_have(self, worker: Worker, batch: Batch, now: float) -> bool:
        """Return whether a worker may have a batch that others have tried."""
        if batch.run.needs_device and not worker.join.rows:
            return False
        is_again = worker.name in batch.tried_by
        if is_again and (batch.check is not None or self._expects_other(batch.tried_by, now)):
            return False
        return self._workers.may_have(worker, batch.tried_by)

    def _double_leases(self, now: float) -> Iterator[Lease]:
        """Lease to idle workers batches that others have held for long; these keep them too."""
        late = self._batches.late(now - self._workers.lease_timeout.straggling)
        for worker in self._workers.idle(now) if late else ():
            if worker.batches or not late:
                return
            state = next((state for state in late if self._may_double(worker, state, now)), None)
            if state is None or not isinstance(state.batch, Batch):
                continue
            late.remove(state)
            self.counters["doubled"] += 1
            yield self._lease_batch(state.batch, worker, now)

    def _may_double(self, worker: Worker, state: BatchState, now: float) -> bool:
        batch, is_new = state.batch, worker.wid not in state.leased
        return is_new and isinstance(batch, Batch) and self._may_have(worker, batch, now)

    def _lease_batch(self, batch: Batch, worker: Worker, now: float) -> Lease:
        return Lease(worker.wid, worker.join.number, self._lease(batch, worker, now), batch)

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
        state.leased.add(worker.wid)
        self._hand_over(state, worker, now)
        self.counters["leased"] += 1
        return state.attempts

    def join(self, join: Join, now: float) -> list[bytes]:
        """Admit a worker, or admit it again; returns the batches that it is to drop.

        Batches leased to it that it does not hold are queued again. A join older than the latest changes
        nothing. Raises Refused if it is not admitted.
        """
        before = self._workers.join(join, now)
        self._first_join = min(self._first_join, now)
        worker = self._workers.get(join.wid)
        if before is None or worker is None:
            return []
        listed = list(dict.fromkeys(join.held))
        kept = {batch_id: state for batch_id in listed if (state := self._own(join.wid, batch_id))}
        self.requeue(join.wid, [batch_id for batch_id in before if batch_id not in kept])
        for state in kept.values():
            self._remove(state.batch)
            self._hand_over(state, worker, now)
        return [batch_id for batch_id in listed if batch_id not in kept]

    def requeue(self, wid: str, batch_ids: Iterable[bytes]) -> int:
        """Queue unsettled batches that a worker has lost and no other holds; returns their number."""
        held = [state for batch_id in batch_ids if (state := self._batches.find(batch_id))]
        for state in held:
            state.holders.pop(wid, None)
        states = [state for state in held if not state.holders]
        for state in states:
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
        self._batches.hand_over(state, worker.wid, now)
        scene = state.batch.run.scene if isinstance(state.batch, Batch) else None
        self._workers.hold(worker, state.batch.id, scene, now)

    def _own(self, wid: str, batch_id: bytes) -> BatchState | None:
        """Return a batch that a worker may go on with, held by it or waiting; else None."""
        state = self._batches.find(batch_id)
        is_own = state is not None and wid in state.leased and not state.holders.keys() - {wid}
        return state if is_own else None

    def settle(self, wid: str, result: Result, rows: Rows, now: float) -> SettleReply:
        """Settle a result: the first of a batch counts, if its sender was leased the batch.

        Keys and genomes are filled into `rows`, the unpacked columns of the result that came on the key of
        worker `wid`. A result to be checked first, or of a check, is fresh and has no rows: `take_released`
        gives them later. Raises MessageError if its run or number of rows is not its batch's, or it names a
        failed row that the batch has not.
        """
        if wid in self.checks.excluded:
            self.counters[Settlement.FOREIGN.value] += 1
            return SettleReply(Settlement.FOREIGN)
        kind, state = self._close(wid, result, now)
        if state is None or not isinstance(state.batch, Batch):
            return SettleReply(kind)
        batch, worker = state.batch, self._workers.name(wid)
        self._queue.measure(batch, result.cpu_seconds)
        if wid in state.holders:
            self._workers.lease_timeout.measure(now - state.holders[wid])
        superseded = self._release_others(state, wid)
        complete_rows(rows, batch, {failure.row for failure in result.failures})
        if batch.check is not None:
            self._settle_check(batch.check, worker, rows, is_failed=bool(result.failures))
            return SettleReply(kind, superseded=superseded)
        reply = replace(self._split(batch, worker, result, rows, now), superseded=superseded)
        return self._hold(batch, worker, reply, now)

    # Checks.

    def _expects_other(self, workers: tuple[WorkerName, ...], now: float) -> bool:
        """Return whether another worker is there, or is likely to be soon, as it was before."""
        is_early = self._takes_over and now < self._first_join + EARLY_SECONDS
        return is_early or self._workers.expects_other(workers, now)

    def _hold(self, batch: Batch, worker: WorkerName, reply: SettleReply, now: float) -> SettleReply:
        """Return a reply without its rows if these are to be checked first, or their worker is."""
        rows = reply.rows
        if rows is None or not len(rows) or reply.failures or batch.run.needs_device:
            return reply
        n = self.checks.rows_to_check(batch)
        is_checked = n > 0 and self._workers.has_other((worker,))
        if not is_checked and not (self.checks.must_wait(worker) and self._expects_other((worker,), now)):
            return reply
        check = self._begin_check(batch.run, worker, rows[:n], is_first=False) if is_checked else None
        self.checks.hold(HeldResult(worker, batch.run, reply, rows, check))
        return replace(reply, rows=None)

    def _begin_check(self, run: RunRef, worker: WorkerName, rows: Rows, *, is_first: bool) -> bytes:
        """Queue rows that a worker has evaluated for another one; returns the id of the check."""
        asked = asked_rows(rows)
        name = self._queue.check(run, asked, (worker,))
        self.checks.open(name, Check(run, asked, {worker: rows.tobytes()}, is_first=is_first))
        return name

    def _settle_check(self, name: bytes, worker: WorkerName, rows: Rows, *, is_failed: bool) -> None:
        """Compare rows with what others answered; one more worker is asked if they differ from all."""
        check = self.checks.find(name)
        if check is None:
            return
        if is_failed:
            check.failed_on = (*check.failed_on, worker)
        elif (verdict := self.checks.answer(name, worker, rows.tobytes())) is not None:
            self._end_check(verdict)
            return
        else:
            self.counters["differing"] += len(rows)
        self._queue.check(check.run, check.rows, check.tried_by, name)

    def _end_check(self, verdict: CheckVerdict) -> None:
        self.counters["checked"] += verdict.rows
        self._verdicts.append(verdict)
        for worker in verdict.wrong:
            self.requeue(worker.wid, self._workers.exclude(worker.wid))
        for result in self.checks.take_excluded():
            self._queue.submit_again(result.run, asked_rows(result.rows))

    def take_released(self, now: float) -> list[HeldResult]:
        """Return results that were held and are not in doubt any more.

        Checks are begun for workers that no other has confirmed, and ended where no worker can decide them.
        """
        if not self.checks.held and not self.checks.are_open:
            return []
        expects_other = partial(self._expects_other, now=now)
        for result in self.checks.unchecked():
            if self._workers.has_other((result.worker,)):
                self._begin_check(result.run, result.worker, result.rows[: CHECKED_ROWS // 2], is_first=True)
        for name, verdict in self.checks.end_hopeless(expects_other, self._is_here):
            self._queue.drop_check(name)
            if verdict is not None:
                self._end_check(verdict)
        for name in self.checks.take_needless():
            self._queue.drop_check(name)
        return self.checks.take_released(expects_other)

    def take_verdicts(self) -> list[CheckVerdict]:
        """Return how checks have ended since the last call."""
        verdicts, self._verdicts = self._verdicts, []
        return verdicts

    def take_sick(self) -> list[Worker]:
        """Return the workers that became sick since the last call."""
        sick, self._sick = self._sick, []
        return sick

    def _is_here(self, name: WorkerName) -> bool:
        worker = self._workers.get(name.wid)
        return worker is not None and not worker.is_drained

    @property
    def trouble(self) -> str:
        """Names of workers that disagree while no other can decide; empty where none do."""
        for check in self.checks.disputes:
            if not self._workers.has_other(check.tried_by):
                return (
                    f"workers {names_of(check.answers)} answer the same {len(check.rows)} rows of run "
                    f"'{check.run.run}' differently: start another worker, which decides, or drain the one "
                    "that is wrong"
                )
        return ""

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
        superseded = self._release_others(state, wid)
        if built.reason and not built.is_final and len(state.batch.failed_by) + 1 < STRIKES:
            self._shapes.requeue_failed(state.batch, wid)
            return None
        return BuildReply.of(state.batch, built, superseded)

    def _is_at_another(self, wid: str, built: Built) -> bool:
        """Return whether a build failed on a worker while another one goes on with it."""
        is_fresh = self._batches.classify(wid, built) is Settlement.FRESH
        state = self._batches.find(built.batch) if is_fresh and built.reason and not built.is_final else None
        return state is not None and bool(state.holders.keys() - {wid})

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

    def _release_others(self, state: BatchState, winner: str) -> tuple[str, ...]:
        """Free the credit of other holders of a settled batch; returns these."""
        others = tuple(holder for holder in state.holders if holder != winner)
        for holder in others:
            self._workers.release(holder, state.batch.id)
        return others

    def _split(self, batch: Batch, worker: WorkerName, result: Result, rows: Rows, now: float) -> SettleReply:
        """Return the settled rows; queue failed ones for other workers until they failed too often."""
        failed = {failure.row: failure.reason for failure in result.failures}
        self.counters["failures"] += len(failed)
        if not failed:
            self._blame(batch.tried_by, now)
            return SettleReply(Settlement.FRESH, rows, result.cpu_seconds)
        tried = (*batch.tried_by, worker)
        if not self._is_given_up(tried, now):
            for place in sorted(failed):
                self._queue.requeue_row(batch, place, worker)
            return SettleReply(Settlement.FRESH, np.delete(rows, list(failed)), result.cpu_seconds)
        self.counters["errors"] += len(failed)
        failures = tuple(Failure(row=place, reason=reason) for place, reason in failed.items())
        return SettleReply(Settlement.FRESH, rows, result.cpu_seconds, failures)

    def _is_given_up(self, tried: tuple[WorkerName, ...], now: float) -> bool:
        """Return whether a row failed on three workers, or so often where there are fewer."""
        return len(tried) >= STRIKES and (len(set(tried)) >= STRIKES or not self._expects_other(tried, now))

    def _blame(self, tried: tuple[WorkerName, ...], now: float) -> None:
        """Count rows that one worker has evaluated as faults of those that failed on them."""
        for name in set(tried):
            sick = self._workers.blame(name.wid, now)
            if sick is not None:
                self.checks.doubt(name.wid)
                self._sick.append(sick)
