"""A recorder that has fewer rows than it had: its disk was restored from a copy."""

import shutil
from pathlib import Path

import numpy as np
from tests.common import wait_for
from tests.coordinator.scheduler.search_plans import Plan, reference
from tests.fakes.job import Job, job_view, send_command
from tests.fakes.messages import ANN, BOB
from tests.fakes.recorder import recording
from tests.fakes.worker import FakeWorker

from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.run_folder import RunFolder

PLANS = {
    "fallen": Plan(seed=1, population=40, evaluations=6000),
    "whole": Plan(seed=2, population=40, evaluations=6000),
}


def journals(path: Path) -> dict[str, bytes]:
    found = {}
    for run in JobFolder(path).run_paths:
        with RunFolder(run).journal() as journal:
            found[run.name] = np.concatenate([journal.shape.empty(0), *journal.blocks()]).tobytes()
    return found


def durable(bus) -> dict[str, int]:
    return {run.run: run.durable for run in job_view(bus).runs}


def stand_still(bus) -> None:
    """Pause the job, and wait until all its rows are on the disk."""
    send_command(bus, "pause")
    wait_for(lambda: not any(worker.batches for worker in job_view(bus).workers))
    wait_for(lambda: all(run.durable == run.rows for run in job_view(bus).runs))


def go_on(bus, rows: int) -> None:
    """Let the job go on until every run has so many more rows on the disk."""
    before = durable(bus)
    send_command(bus, "continue")
    wait_for(lambda: all(number >= before.get(run, 0) + rows for run, number in durable(bus).items()))


def test_only_the_run_whose_records_are_fewer_is_gone_on_with_from_what_is_left(tmp_path: Path) -> None:
    job, path, copy = Job(dict(PLANS), recorded=True), tmp_path / "job", tmp_path / "copy"
    ann, bob = (FakeWorker(job.network.session(), wid) for wid in (ANN, BOB))
    with job.serving() as service, job.network.session() as bus:
        with recording(job.network, path), ann.at_work():
            wait_for(lambda: len(durable(bus)) == 2 and min(durable(bus).values()) > 100)
            stand_still(bus)
            early = durable(bus)
            shutil.copytree(path / "runs" / "fallen", copy)
            go_on(bus, 200)
            stand_still(bus)
            late = durable(bus)
        shutil.rmtree(path / "runs" / "fallen")
        copy.rename(path / "runs" / "fallen")
        with recording(job.network, path), bob.at_work():
            send_command(bus, "continue")
            service.ends()
    assert service.error is None
    assert journals(path) == {name: reference(plan) for name, plan in PLANS.items()}
    assert early["fallen"] < late["fallen"]
