"""The scheduler of a job: workers join, leave and are lost; a job ends before it is done."""

from concurrent.futures import Future
from math import inf

import msgspec
import pytest
from tests.coordinator.scheduler.search_plans import SHAPE, Plan
from tests.fakes.job import FakeRunQueue, SlowSink, make_run_plan, scheduler_of
from tests.fakes.messages import ANN, BOB, join_message
from tests.fakes.recorder import JOB

from qdgrasp_coordinator.metrics.job_status import WORKERS_PER_PAGE, JobEvent, WorkerStatus
from qdgrasp_coordinator.scheduler.job_scheduler import LEAST_STOP_SECONDS, MOST_STOP_SECONDS, JoinRequest
from qdgrasp_coordinator.scheduler.recorder_client import RowSink
from qdgrasp_coordinator.scheduler.run_registry import ActiveRun, LoadEnded
from qdgrasp_coordinator.scheduler.worker_registry import GONE_SECONDS
from qdgrasp_protocol.bus import Sample, TokenChange
from qdgrasp_protocol.errors import Cancelled, RunFailed
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Heartbeat, Join, Opened

KEYS = Keys(JOB)


class SchedulerWithoutRuns:
    """A scheduler without runs, and the events that it logs."""

    def __init__(self) -> None:
        self.events: list[JobEvent] = []
        self.scheduler = scheduler_of(FakeRunQueue({}), self.events.append)

    def joins(self, asked: Join, now: float) -> "Future[bytes]":
        request = JoinRequest(asked)
        self.scheduler.handle(TokenChange(KEYS.worker_token(asked.wid), True), now)
        self.scheduler.handle(request, now)
        return request.answer

    def dies(self, wid: str, now: float) -> None:
        self.scheduler.handle(TokenChange(KEYS.worker_token(wid), False), now)

    def says(self, now: float, wid: str = ANN, **values: object) -> None:
        heartbeat = Heartbeat(wid=wid, host="node7", **values)  # type: ignore[arg-type]
        key = KEYS.stat(f"worker/{wid}")
        self.scheduler.handle(Sample(key, msgspec.json.encode(heartbeat), "application/json"), now)

    def shown(self, now: float) -> list[WorkerStatus]:
        return [worker for page in self.scheduler.workers.pages(now) for worker in page.workers]

    def states(self, now: float) -> list[str]:
        return [worker.state for worker in self.shown(now)]

    @property
    def words(self) -> list[str]:
        return [event.words for event in self.events]


@pytest.fixture
def job() -> SchedulerWithoutRuns:
    return SchedulerWithoutRuns()


def test_what_a_worker_says_of_itself_is_shown(job: SchedulerWithoutRuns) -> None:
    job.joins(join_message(ANN), 10.0)
    job.says(12.0, memory=1 << 30, restarts=2)
    (ann,) = job.shown(15.0)
    assert (ann.memory, ann.restarts, ann.host, ann.pid) == (1 << 30, 2, "node7", 9)
    assert (ann.seconds, ann.seen) == (5.0, 3.0)


def test_a_killed_worker_is_gone_at_once_and_listed_for_a_minute(job) -> None:
    job.joins(join_message(ANN), 0.0)
    job.joins(join_message(BOB), 0.0)
    job.dies(ANN, 5.0)
    assert job.states(5.0) == ["gone", "idle"]
    job.scheduler.step(6.1)
    assert job.words[-1] == f"Worker {ANN[:8]} on node7 (process 9) is gone: its token vanished."
    assert job.states(6.1 + GONE_SECONDS - 0.1) == ["idle", "gone"]
    assert job.states(6.2 + GONE_SECONDS) == ["idle"]


def test_a_worker_whose_token_is_late_is_not_shown_as_gone(job: SchedulerWithoutRuns) -> None:
    job.scheduler.handle(JoinRequest(join_message(ANN)), 0.0)
    assert job.states(1.0) == ["idle"]
    job.scheduler.handle(TokenChange(KEYS.worker_token(ANN), True), 2.0)
    job.dies(ANN, 3.0)
    assert job.states(3.0) == ["gone"]


def test_a_refused_worker_is_told_of_with_the_reason(job: SchedulerWithoutRuns) -> None:
    job.joins(join_message(ANN), 0.0)
    other = msgspec.structs.replace(join_message(BOB), platform={"pybullet": "9"})
    assert job.joins(other, 1.0).exception()
    (_, refused) = job.events
    assert (refused.kind, refused.worker) == ("worker", BOB)
    assert "was refused" in refused.words
    assert "pybullet" in refused.words
    assert not refused.words.endswith("..")


class LibraryQueue(FakeRunQueue):
    """A queue of runs on objects that are called as the runs."""

    def object_of(self, run: str) -> str:
        return f"/library/{run}.stl"


def test_a_run_that_cannot_be_carried_out_is_told_of_with_its_object() -> None:
    events: list[JobEvent] = []
    scheduler = scheduler_of(LibraryQueue({"mug": None}), events.append)
    scheduler.handle(LoadEnded(failure=RunFailed("mug", "Its mesh is no mesh.")), 0.0)
    assert [(event.kind, event.run, event.object) for event in events] == [
        ("error", "mug", "/library/mug.stl")
    ]


def test_a_worker_without_the_engine_of_a_run_is_refused_and_leaves_when_such_a_run_begins() -> None:
    scheduler = scheduler_of(FakeRunQueue({"run-0": Plan()}), lambda _event: None)
    without = msgspec.structs.replace(join_message(ANN), platform={"mujoco": "4.0.1"})
    scheduler.workers.join(without, 0.0)
    run = ActiveRun(make_run_plan("run-0", Plan()), RowSink(SHAPE))
    scheduler.handle(LoadEnded(run, Opened(epoch=1, durable=[0], platform={})), 1.0)
    (worker,) = scheduler.workers
    assert worker.is_drained
    request = JoinRequest(msgspec.structs.replace(without, wid=BOB))
    scheduler.handle(request, 2.0)
    assert "run 'run-0' is simulated in pybullet" in str(request.answer.exception())


def test_a_sign_without_progress_keeps_nobody_from_being_stuck(job: SchedulerWithoutRuns) -> None:
    job.joins(join_message(ANN), 0.0)
    (worker,) = job.scheduler.workers
    job.says(5.0, progressed=False)
    assert (worker.progress, job.shown(5.0)[0].seen) == (0.0, 0.0)
    job.says(6.0, progressed=True)
    assert worker.progress == 6.0


@pytest.mark.parametrize("workers", [0, 1, WORKERS_PER_PAGE, WORKERS_PER_PAGE + 1])
def test_each_worker_stands_on_one_page(job: SchedulerWithoutRuns, workers: int) -> None:
    for number in range(workers):
        job.joins(join_message(f"{number:032x}"), 0.0)
    pages = job.scheduler.workers.pages(1.0)
    assert [page.page for page in pages] == list(range(max(1, -(-workers // WORKERS_PER_PAGE))))
    assert {page.pages for page in pages} == {len(pages)}
    assert [int(worker.wid, 16) for page in pages for worker in page.workers] == list(range(workers))


def test_a_job_ends_by_itself_when_its_time_is_over_and_not_before() -> None:
    scheduler = scheduler_of(FakeRunQueue({}), ends_at=110.0)
    scheduler.step(109.9)
    assert (scheduler.is_ending, scheduler.ends_at) == (False, 110.0)
    scheduler.step(110.0)
    assert (scheduler.is_ending, scheduler.ends_at) == (True, inf)


@pytest.mark.parametrize(("is_safe", "patience"), [(True, LEAST_STOP_SECONDS), (False, MOST_STOP_SECONDS)])
def test_an_ending_waits_for_the_recorder_but_not_for_ever(is_safe: bool, patience: float) -> None:
    scheduler = scheduler_of(FakeRunQueue({}))
    run = ActiveRun(make_run_plan("run-0", Plan()), SlowSink(SHAPE))
    run.sink.is_safe = is_safe
    scheduler.handle(LoadEnded(run, Opened(epoch=1, durable=[0], platform={})), 1.0)
    assert not scheduler.has_ended(1e9)
    scheduler.stop(5.0, cancelled := Cancelled("mugs"))
    assert scheduler.stop_reason is cancelled
    assert not scheduler.has_ended(4.99 + patience)
    assert scheduler.has_ended(5.0 + patience)
