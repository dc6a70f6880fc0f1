"""Trusted workers check the rows of others: no wrong row is left, and no honest worker is excluded."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from tests.coordinator.scheduler.search_plans import Plan, evaluate, reference
from tests.fakes.job import FakeRunQueue
from tests.fakes.memory_bus import MemoryNetwork
from tests.fakes.messages import KEYS_BY_ID, made_id
from tests.fakes.recorder import JOB
from tests.fakes.service_thread import ServiceThread
from tests.fakes.worker import FakeWorker

from qdgrasp_coordinator.recorder.recorder_service import RecorderService
from qdgrasp_coordinator.scheduler import auditor
from qdgrasp_coordinator.scheduler.coordinator_service import CoordinatorService
from qdgrasp_coordinator.scheduler.recorder_client import RecorderClient
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_protocol.messages import TRUST_VARIABLE, worker_id, worker_key
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.rows import Outcome, Rows

PLANS = {
    "run-0": Plan(seed=1, population=20, evaluations=1000),
    "run-1": Plan(seed=2, population=20, evaluations=200),
}
HONEST = 30
"""Rows in which a liar is honest at first."""
Evaluate = Callable[[Rows], Rows]


def liar(share: float, first: int = HONEST) -> Evaluate:
    """An evaluation that is wrong in the last bit of a share of the rows, after some honest ones."""
    seen, random = 0, np.random.default_rng(5)

    def lying(rows: Rows) -> Rows:
        nonlocal seen
        found, seen = evaluate(rows), seen + len(rows)
        if seen > first:
            wrong = (random.random(len(rows)) < share) & (found["outcome"] != Outcome.ERROR)
            found["nu"][wrong] = np.nextafter(found["nu"][wrong], np.float32(9))
        return found

    return lying


def trusted_id(salt: int) -> str:
    """The id of a worker that knows this process's secret."""
    key = worker_key(salt.to_bytes(16))
    KEYS_BY_ID[worker_id(key)] = key
    return worker_id(key)


def carry_out(
    path: Path, others: list[Evaluate], trusted: Evaluate = evaluate
) -> tuple[set[str], dict[str, bytes]]:
    """Carry out the runs; returns the workers that were excluded, and the journals' rows."""
    network, stop, end = MemoryNetwork(), Stop(), Stop()
    service = CoordinatorService(
        bus := network.session(),
        stop,
        job=JOB,
        queue=FakeRunQueue(dict(PLANS)),
        make_sink=lambda run: RecorderClient(bus, JOB, run.shape),
        batch_size=2,
    )
    recorder = ServiceThread(RecorderService(network.session(), end, job=JOB, path=path).run, end)
    wids = [trusted_id(1), *(made_id(n) for n in range(len(others)))]
    with ExitStack() as stack:
        for wid, evaluation in zip(wids, [trusted, *others], strict=True):
            stack.enter_context(FakeWorker(network.session(), wid, evaluate=evaluation).at_work())
        service.run()
    recorder.leave()
    recorder.ends()
    journals = {}
    for name in PLANS:
        with Journal.open(path / "runs" / name) as journal:
            journals[name] = b"".join(rows.tobytes() for rows in journal.blocks())
            assert {worker for _, _, worker, _ in journal.makers()} <= set(wids)
            assert sum(n for _, n, _, _ in journal.makers()) == journal.count
    return set(service.scheduler.runs.excluded), journals


@pytest.fixture(autouse=True)
def secret(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TRUST_VARIABLE, "a secret of the job")


@pytest.mark.parametrize(
    ("shares", "audited"),
    [
        pytest.param([1.0], None, id="one that lies always after a while"),
        pytest.param([1.0, 1.0, 0.0], None, id="two against one"),
        pytest.param([0.1], 1.0, id="a tenth of its rows"),
        pytest.param([0.02, 0.0], 1.0, id="one of a hundred rows of the run"),
        pytest.param([0.0, 0.0], 1.0, id="nobody"),
    ],
)
def test_no_wrong_row_stays_and_no_honest_worker_is_excluded(tmp_path, monkeypatch, shares, audited) -> None:
    if audited:  # so many are checked that chance has no say
        monkeypatch.setattr(auditor, "AUDITED", audited)
    excluded, journals = carry_out(tmp_path / "job", [liar(share) for share in shares])
    assert excluded == {made_id(n) for n, share in enumerate(shares) if share}
    assert journals == {name: reference(plan) for name, plan in PLANS.items()}


def test_a_trusted_worker_that_finds_another_result_each_time_excludes_nobody(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(auditor, "AUDITED", 1.0)
    random = np.random.default_rng(3)

    def noisy(rows: Rows) -> Rows:
        found = evaluate(rows)
        found["nu"][found["outcome"] != Outcome.ERROR] = random.random()
        return found

    excluded, _ = carry_out(tmp_path / "job", [evaluate], noisy)
    assert not excluded
