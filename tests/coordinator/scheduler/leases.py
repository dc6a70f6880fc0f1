"""Leases and results for the tests of dispatch."""

import numpy as np

from qdgrasp_coordinator.scheduler.batch_queue import Lease, SettleReply
from qdgrasp_coordinator.scheduler.dispatcher import Dispatcher
from qdgrasp_protocol.messages import Failure, Result
from qdgrasp_protocol.rows import Outcome, RowShape

SHAPE = RowShape(genes=2, joints=1)
EPOCH = 5
ANN, BOB, EVE = "a" * 32, "b" * 32, "e" * 32
SCENE = "1" * 64


def genomes(n: int) -> np.ndarray:
    return np.linspace(-1, 1, 2 * n, dtype=np.float32).reshape(n, 2)


def submit(dispatch: Dispatcher, n: int, run: str = "run", scene: str = SCENE, generation: int = 0) -> None:
    indices, trials = np.arange(n, dtype=np.uint32), np.zeros(n, dtype=np.uint16)
    dispatch.submit(run, scene, "contact", generation, indices, trials, genomes(n))


def with_work(n: int = 10, batch_size: int | None = 2, workers: tuple[str, ...] = (ANN,)) -> Dispatcher:
    dispatch = Dispatcher(EPOCH, batch_size)
    submit(dispatch, n)
    for wid in workers:
        dispatch.join(wid, 1, 2, [], 0.0)
    return dispatch


def settle(
    dispatch: Dispatcher,
    lease: Lease,
    now: float,
    *,
    wid: str = "",
    failed: tuple[int, ...] = (),
    epoch: int = EPOCH,
) -> SettleReply:
    n = len(lease.batch)
    rows = SHAPE.empty(n)
    rows["outcome"], rows["nu"] = Outcome.HELD, lease.batch.indices
    result = Result(
        epoch=epoch,
        run=lease.batch.run,
        generation=lease.batch.generation,
        batch=lease.batch.id,
        attempt=lease.attempt,
        wid=wid or lease.wid,
        n=n,
        joints=1,
        descriptors=3,
        columns={},
        cpu_seconds=0.1 * n,
        failures=[Failure(row=row, reason=f"row {row} burst") for row in failed],
    )
    return dispatch.settle(wid or lease.wid, result, rows, now)


def indices(leases: list[Lease]) -> list[list[int]]:
    return [lease.batch.indices.tolist() for lease in leases]
