"""A recorder that has fewer rows than it had: its disk was restored from a copy."""

import shutil
from pathlib import Path

import numpy as np
from tests.coordinator.recording.recorded import recording
from tests.coordinator.runs.plans import Plan, reference
from tests.coordinator.serving.served import Job, Pretender, until
from tests.coordinator.serving.test_orders import shown, tell
from tests.patience import PATIENCE

from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.job_folder import JobFolder

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
    return {run.run: run.durable for run in shown(bus).runs}


def stand_still(bus) -> None:
    """Pause the job, and wait until all that was found is on the disk."""
    tell(bus, "pause")
    until(lambda: not any(worker.batches for worker in shown(bus).workers))
    until(lambda: all(run.durable == run.rows for run in shown(bus).runs))


def go_on(bus, rows: int) -> None:
    """Let the job go on until every run has so many more rows on the disk."""
    before = durable(bus)
    tell(bus, "continue")
    until(lambda: all(number >= before.get(run, 0) + rows for run, number in durable(bus).items()))


def test_only_the_run_whose_records_are_fewer_is_gone_on_with_from_what_is_left(tmp_path: Path) -> None:
    job, path, copy = Job(dict(PLANS), recorded=True), tmp_path / "job", tmp_path / "copy"
    ann, bob = (Pretender(job.network.session(), letter * 32) for letter in "ab")
    with job.serving() as service, job.network.session() as bus:
        with recording(job.network, path), ann.at_work():
            until(lambda: len(durable(bus)) == 2 and min(durable(bus).values()) > 100)
            stand_still(bus)
            early = durable(bus)
            shutil.copytree(path / "runs" / "fallen", copy)
            go_on(bus, 200)
            stand_still(bus)
            late = durable(bus)
        shutil.rmtree(path / "runs" / "fallen")
        copy.rename(path / "runs" / "fallen")
        with recording(job.network, path), bob.at_work():
            tell(bus, "continue")
            service.join(PATIENCE)
            assert not service.is_alive()
    assert job.error is None
    assert journals(path) == {name: reference(plan) for name, plan in PLANS.items()}
    assert early["fallen"] < late["fallen"]
