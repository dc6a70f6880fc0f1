"""The coordinator's service with many runs at once, commanded by administrators."""

import hashlib
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from tests.common import PATIENCE, wait_for
from tests.coordinator.scheduler.search_plans import Plan, reference
from tests.fakes.job import PLANS, Job, OtherPlatformSink, ReplacedSink, SlowSink, job_view, send_command
from tests.fakes.messages import ANN, BOB, FAY
from tests.fakes.recorder import JOB
from tests.fakes.worker import FakeWorker

from qdgrasp_coordinator.metrics.job_status import JobStatus, from_json
from qdgrasp_protocol.bus import Bus, fetch_bundle
from qdgrasp_protocol.errors import Cancelled, Refused, RunsFailed, TookOver
from qdgrasp_protocol.keys import Keys


def test_a_run_that_cannot_be_made_is_told_of_when_the_others_are_done() -> None:
    job = Job({"bad": None, **PLANS})
    with pytest.raises(RunsFailed, match=r"1 of 7 runs .* 'bad': Its mesh is no mesh\."):
        job.carry_out()
    assert job.journals() == {name: reference(plan) for name, plan in PLANS.items()}


def test_a_coordinator_that_another_one_replaced_ends_and_no_run_fails_for_it() -> None:
    with pytest.raises(TookOver):
        Job(dict(PLANS), **{"run-2": ReplacedSink}).carry_out()


def test_scenes_of_runs_in_progress_are_handed_out_and_no_others() -> None:
    job = Job(dict(PLANS))
    other = job.network.session()
    with FakeWorker(job.network.session(), FAY, answers=False).at_work() as idle, job.serving():
        assert idle.kept.wait(PATIENCE)
        scene = b"run-0" * 100
        assert fetch_bundle(other, Keys(JOB).asset(hashlib.sha256(scene).hexdigest())) == scene
        with pytest.raises(Refused, match="no run in progress has the scene"):
            fetch_bundle(other, Keys(JOB).asset("0" * 64))


def test_a_full_disk_is_waited_for_and_no_run_fails_for_it() -> None:
    job = Job(dict(PLANS))
    job.programme.has_room.clear()

    def make_room(now: float) -> None:
        if job.service.scheduler.status(now).trouble == "There is no room.":
            job.programme.has_room.set()

    with FakeWorker(job.network.session(), FAY).at_work():
        job.service.run(make_room)
    assert job.journals() == {name: reference(plan) for name, plan in PLANS.items()}


def test_a_run_of_another_platform_fails_and_the_others_are_done() -> None:
    job = Job(dict(PLANS), **{"run-5": OtherPlatformSink})
    with pytest.raises(RunsFailed, match=r"'run-5': Its rows were made elsewhere: .* pybullet 2\.0"):
        job.carry_out()
    assert job.journals() == {name: reference(plan) for name, plan in PLANS.items()} | {"run-5": b""}


# Commands of administrators, and jobs that end early.

LONG = Plan(population=50, evaluations=5000)


@contextmanager
def last_words(bus: Bus) -> Iterator[Callable[[], list[str]]]:
    """The states that a coordinator told of, the latest last."""
    with bus.ring(Keys(JOB).stat("job"), 64) as ring:
        yield lambda: [from_json(sample.payload, JobStatus).state for sample in ring.take()]


def test_a_pause_changes_nothing_that_is_found() -> None:
    job = Job(dict(PLANS))
    bus = job.network.session()
    paused, looks = threading.Event(), iter(range(10**9))

    def look(now: float) -> None:
        if next(looks) == 5:
            threading.Thread(target=lambda: (send_command(bus, "pause"), paused.set())).start()
        if paused.is_set():
            paused.clear()
            assert job.service.scheduler.status(now).state == "paused"
            threading.Thread(target=send_command, args=(bus, "continue")).start()

    with FakeWorker(job.network.session(), ANN).at_work(), FakeWorker(job.network.session(), BOB).at_work():
        job.service.run(look)
    assert job.journals() == {name: reference(plan) for name, plan in PLANS.items()}


def test_nothing_is_handed_out_while_a_job_is_paused() -> None:
    job = Job({"run-0": LONG})
    with job.serving(), job.network.session() as bus:
        assert "is paused" in send_command(bus, "pause")
        assert "already" in send_command(bus, "pause")
        with FakeWorker(job.network.session(), ANN).at_work() as worker:
            wait_for(lambda: bool(job_view(bus).workers))
            before = worker.rows
            assert send_command(bus, "continue") == f"Job '{JOB}' goes on."
            wait_for(lambda: worker.rows > 0)
    assert before == 0


def test_a_cancelled_job_ends_with_what_it_has_and_takes_back_what_is_out() -> None:
    job = Job({"run-0": LONG})
    worker = FakeWorker(job.network.session(), ANN, answers=False)
    with job.serving() as service, job.network.session() as bus, worker.at_work(), last_words(bus) as told:
        assert worker.kept.wait(PATIENCE)
        assert "ends" in send_command(bus, "cancel")
        service.ends()
        assert told()[-1] == "cancelled"
    assert isinstance(service.error, Cancelled)
    assert (str(service.error), service.error.exit_code) == (f"Job '{JOB}' was cancelled.", 0)
    assert worker.controls[-1].drop


def test_a_cancelled_job_waits_for_what_is_found_to_be_safe() -> None:
    job = Job({"run-0": LONG}, **{"run-0": SlowSink})
    worker = FakeWorker(job.network.session(), ANN)
    with job.serving() as service, job.network.session() as bus, worker.at_work():
        wait_for(lambda: worker.rows > 0)
        send_command(bus, "cancel")
        assert job_view(bus).figures.state == "ending"
        with pytest.raises(Refused, match="ending already"):
            send_command(bus, "pause")
        job.records["run-0"].is_safe = True
        service.ends()
    assert isinstance(service.error, Cancelled)


def test_a_drained_worker_is_told_and_gets_nothing_more() -> None:
    job = Job({"run-0": LONG})
    ann = FakeWorker(job.network.session(), ANN, answers=False)
    bob = FakeWorker(job.network.session(), BOB)
    with job.serving(), job.network.session() as bus, ann.at_work():
        assert ann.kept.wait(PATIENCE)
        assert send_command(bus, "drain", worker=ANN[:3]).startswith(
            f"Asked 1 worker of job '{JOB}' to finish"
        )
        (worker,) = job_view(bus).workers
        assert (worker.state, ann.controls[-1].drain) == ("leaving", True)
        assert job_view(bus).figures.workers == 0
        before = ann.rows
        with bob.at_work():
            wait_for(lambda: bob.rows > 50)
        assert ann.rows == before


@pytest.mark.parametrize(
    ("whom", "reason"),
    [
        ({"worker": "c"}, f"has 0 workers 'c': .* of {ANN[:8]} on here, {BOB[:8]} on here"),
        ({"worker": ""}, "has 2 workers ''"),
        ({"host": "moon"}, "has 0 workers 'moon'"),
    ],
)
def test_who_is_not_there_cannot_be_drained(whom: dict[str, str], reason: str) -> None:
    job = Job({"run-0": LONG})
    ann, bob = (FakeWorker(job.network.session(), wid, answers=False) for wid in (ANN, BOB))
    with job.serving(), job.network.session() as bus, ann.at_work():
        assert ann.kept.wait(PATIENCE)
        with bob.at_work():
            assert bob.kept.wait(PATIENCE)
            with pytest.raises(Refused, match=reason):
                send_command(bus, "drain", **whom)
