"""The coordinator's service with many runs at once."""

import hashlib
import threading

import numpy as np
import pytest
from tests.common import PATIENCE
from tests.coordinator.recorder.fakes import JOB
from tests.coordinator.scheduler.fakes import (
    PLANS,
    FakeWorker,
    Job,
    OtherPlatformSink,
    ReplacedSink,
    SlowSink,
)
from tests.coordinator.scheduler.search_plans import Plan, reference

from qdgrasp_coordinator.metrics.job_status import JobStatus, from_json
from qdgrasp_protocol import bundle_transfer
from qdgrasp_protocol.errors import InputError, Refused, RunsFailed, TookOver
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.rows import Outcome


def test_many_runs_at_once_find_what_each_finds_alone() -> None:
    job = Job(dict(PLANS))
    job.carry_out()
    assert job.journals() == {name: reference(plan) for name, plan in PLANS.items()}
    assert max(job.open) > 1


def test_a_run_that_cannot_be_made_is_told_of_when_the_others_are_done() -> None:
    job = Job({"bad": None, **PLANS})
    with pytest.raises(RunsFailed, match=r"1 of 7 runs .* 'bad': Its mesh is no mesh\."):
        job.carry_out()
    assert job.journals() == {name: reference(plan) for name, plan in PLANS.items()}


def test_a_coordinator_that_another_one_replaced_ends_and_no_run_fails_for_it() -> None:
    with pytest.raises(TookOver):
        Job(dict(PLANS), **{"run-2": ReplacedSink}).carry_out()


def test_of_many_runs_that_cannot_be_made_some_are_named() -> None:
    bad = dict.fromkeys([f"bad-{number}" for number in range(13)])
    with pytest.raises(
        RunsFailed, match=r"13 of 14 runs .* 'bad-0': Its .* 'bad-1', .*'bad-10' and 2 more\.$"
    ):
        Job({**bad, "run-0": PLANS["run-0"]}).carry_out()


def test_the_only_run_of_a_job_fails_with_its_own_sentence() -> None:
    with pytest.raises(InputError, match=r"^Its mesh is no mesh\.$"):
        Job({"bad": None}).carry_out()


def test_no_more_runs_are_open_than_keep_the_workers_busy() -> None:
    job = Job({f"run-{seed}": Plan(seed=seed, population=400, evaluations=800) for seed in range(4)})
    job.carry_out(workers=1)
    assert max(job.open) <= 3


def test_scenes_of_runs_in_progress_are_handed_out_and_no_others() -> None:
    job = Job(dict(PLANS))
    other = job.network.session()
    with FakeWorker(job.network.session(), "f" * 32, answers=False).at_work() as idle:
        service = threading.Thread(target=job.service.run)
        service.start()
        try:
            assert idle.kept.wait(PATIENCE)
            scene = b"run-0" * 100
            assert bundle_transfer.fetch_bundle(other, JOB, hashlib.sha256(scene).hexdigest()) == scene
            with pytest.raises(Refused, match="no run in progress has the scene"):
                bundle_transfer.fetch_bundle(other, JOB, "0" * 64)
        finally:
            job.stop.set(15)
            service.join()


def test_the_last_figures_of_the_job_count_all_runs() -> None:
    job = Job(dict(PLANS))
    seen: list[JobStatus] = []
    with job.network.session().subscribe(
        Keys(JOB).stat("job"), lambda sample: seen.append(from_json(sample.payload, JobStatus))
    ):
        job.carry_out()
    last = seen[-1]
    assert (last.runs_done, last.runs_open, last.runs) == (6, 0, 6)
    assert last.evaluations == last.budget == 240


def test_a_full_disk_is_waited_for_and_no_run_fails_for_it() -> None:
    job = Job(dict(PLANS))
    job.programme.has_room.clear()

    def make_room(now: float) -> None:
        if job.service.figures(now).trouble == "There is no room.":
            job.programme.has_room.set()

    with FakeWorker(job.network.session(), "f" * 32).at_work():
        job.service.run(make_room)
    assert job.journals() == {name: reference(plan) for name, plan in PLANS.items()}


def test_a_run_of_another_platform_fails_and_the_others_are_done() -> None:
    job = Job(dict(PLANS), **{"run-5": OtherPlatformSink})
    with pytest.raises(RunsFailed, match=r"'run-5': Its rows were made elsewhere: .* pybullet 2\.0"):
        job.carry_out()
    assert job.journals() == {name: reference(plan) for name, plan in PLANS.items()} | {"run-5": b""}


def test_nobody_works_on_what_a_finished_run_does_not_need() -> None:
    plan = Plan(population=200, evaluations=20, overlaps="redraw")
    job = Job({"slow": plan}, slow=SlowSink)
    looks: list[float] = []

    def look(now: float) -> None:
        if job.service.figures(now).evaluations == plan.evaluations:
            looks.append(now)
        if len(looks) == 5:
            record = job.records["slow"]
            assert isinstance(record, SlowSink)
            record.is_safe = True

    with FakeWorker(job.network.session(), "f" * 32).at_work() as worker:
        job.service.run(look)
    rows = job.records["slow"].rows
    again, held, crossing = 2 * np.count_nonzero(rows["outcome"] == Outcome.ERROR), 2 * 2, 1
    assert worker.rows <= len(rows) + again + held + crossing


def test_what_a_finished_run_held_is_let_go() -> None:
    job = Job({f"run-{seed}": Plan(seed=seed, evaluations=20) for seed in range(40)})
    job.carry_out()
    assert len(job.programme.pipelines) == 40
    last_opened = 1
    assert sum(pipeline() is not None for pipeline in job.programme.pipelines) <= last_opened
