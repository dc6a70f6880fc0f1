"""Leases and results for the tests of dispatch."""

from collections.abc import Sequence

import numpy as np
from msgspec import structs
from tests.fakes.messages import ANN, join_message, result_message

from qdgrasp_coordinator.scheduler.batch_dispatcher import Dispatcher, Lease, SettleReply
from qdgrasp_coordinator.scheduler.batch_queue import RunRef
from qdgrasp_coordinator.scheduler.pipeline import Generation
from qdgrasp_coordinator.scheduler.worker_registry import LostWorker, WorkerRegistry
from qdgrasp_protocol.messages import Failure, Result
from qdgrasp_protocol.rows import Outcome, RowShape

SHAPE = RowShape(genes=2, joints=1)
EPOCH = 5
SCENE = "1" * 64


def genomes(n: int) -> np.ndarray:
    return np.linspace(-1, 1, 2 * n, dtype=np.float32).reshape(n, 2)


class Dispatch(Dispatcher):
    """A dispatcher with its workers."""

    def __init__(self, epoch: int, batch_size: int | None = None) -> None:
        self.workers = WorkerRegistry()
        super().__init__(epoch, self.workers, batch_size)

    def admit(
        self, wid: str, number: int, credit: int, held: Sequence[bytes], now: float, rows: int = 0
    ) -> list[bytes]:
        """Let a proven worker join whose token is there; its device evaluates so many rows at once."""
        self.workers.on_token(wid, True, now)
        drop = self.join(join_message(wid, number, credit, held, rows=rows), now)
        self.workers.answered(wid, b"", now, is_first=True)
        return drop

    def give_up(self, now: float) -> list[LostWorker]:
        """Queue again the batches of overdue workers."""
        lost = self.workers.overdue(now)
        for one in lost:
            self.requeue(one.worker.wid, one.batches)
        return lost


def submit(
    dispatch: Dispatch,
    n: int,
    run: str = "run",
    scene: str = SCENE,
    generation: int = 0,
    engine: str | None = None,
) -> None:
    indices, trials = np.arange(n, dtype=np.uint32), np.zeros(n, dtype=np.uint16)
    rows = Generation(generation, indices, trials, genomes(n))
    dispatch.submit(RunRef(run, scene, "contact", engine), rows)


def with_work(n: int = 10, batch_size: int | None = 2, workers: tuple[str, ...] = (ANN,)) -> Dispatch:
    dispatch = Dispatch(EPOCH, batch_size)
    submit(dispatch, n)
    for wid in workers:
        dispatch.admit(wid, 1, 2, [], 0.0)
    return dispatch


def settle(
    dispatch: Dispatch,
    lease: Lease,
    now: float,
    *,
    wid: str = "",
    failed: tuple[int, ...] = (),
    epoch: int = EPOCH,
) -> SettleReply | None:
    rows = SHAPE.empty(len(lease.task))
    rows["outcome"], rows["nu"] = Outcome.HELD, lease.task.rows.indices
    wid = wid or lease.wid
    found = structs.replace(result(lease), epoch=epoch, wid=wid, failures=failures(failed))
    return dispatch.settle(wid, found, rows, now)


def failures(rows: Sequence[int]) -> list[Failure]:
    return [Failure(row=row, reason=f"row {row} burst") for row in rows]


def result(lease: Lease) -> Result:
    """The worker's answer, without columns."""
    n = len(lease.task)
    return result_message(
        epoch=EPOCH,
        run=lease.task.run.run,
        generation=lease.task.rows.number,
        batch=lease.task.id,
        attempt=lease.attempt,
        wid=lease.wid,
        n=n,
        cpu_seconds=0.1 * n,
    )


def indices(leases: list[Lease]) -> list[list[int]]:
    return [lease.task.rows.indices.tolist() for lease in leases]
