"""How fast something was lately."""

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack
from types import SimpleNamespace

import msgspec
import pytest
from tests.coordinator.recorder.fakes import JOB
from tests.coordinator.scheduler.fakes import PLATFORM, Job
from tests.coordinator.scheduler.search_plans import Plan

from qdgrasp_coordinator.metrics.job_status import (
    WORKERS_PER_PAGE,
    EventLog,
    JobEvent,
    WorkersPage,
    WorkerStatus,
    from_json,
)
from qdgrasp_coordinator.scheduler import coordinator_service
from qdgrasp_coordinator.scheduler.job_scheduler import (
    Inbox,
    InboxEvent,
    JobScheduler,
    JoinRequest,
    TokenChange,
)
from qdgrasp_coordinator.scheduler.status_publisher import STATUS_INTERVAL
from qdgrasp_coordinator.scheduler.worker_admission import (
    GONE_SECONDS,
    MOST_GONE,
    RATE_SECONDS,
    RateMeter,
    WorkerActivity,
)
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Heartbeat, Join


@pytest.mark.parametrize("seconds", [1, 5, 60])
def test_a_steady_speed_is_told_from_the_beginning(seconds: int) -> None:
    speed = RateMeter(100.0)
    for step in range(1, 20 * seconds + 1):
        speed.count(1, 100.0 + step / 20)
    assert speed.at(100.0 + seconds) == pytest.approx(20, rel=0.03)


def test_what_was_long_ago_is_forgotten() -> None:
    speed = RateMeter(0.0)
    speed.count(1000, 1.0)
    assert speed.at(2.0) > 50
    assert speed.at(10 * RATE_SECONDS) < 0.02


def test_nothing_was_counted_before_there_was_time() -> None:
    speed = RateMeter(5.0)
    speed.count(10, 5.0)
    assert speed.at(5.0) == 0.0


ANN, BOB = "a" * 32, "b" * 32
KEYS = Keys(JOB)


def join(wid: str, number: int = 1, credit: int = 2) -> Join:
    platform = {"pybullet": "3.2.7"}
    return Join(
        versions=[1], wid=wid, number=number, credit=credit, held=[], host="node7", pid=9, platform=platform
    )


class Office:
    """A turn without runs, and what it notes."""

    def __init__(self) -> None:
        self.events: list[JobEvent] = []
        self.turn = JobScheduler(JOB, 1, self, lambda *_: None, None, EventLog(self.events.append))  # type: ignore[arg-type]

    def __iter__(self):  # type: ignore[no-untyped-def]
        return iter(())

    def get(self, run: str) -> None:
        return None

    def joins(self, asked: Join, now: float) -> "Future[bytes]":
        request = JoinRequest(asked)
        self.turn.take(TokenChange(KEYS.worker_token(asked.wid), True), now)
        self.turn.take(request, now)
        return request.answer

    def dies(self, wid: str, now: float) -> None:
        self.turn.take(TokenChange(KEYS.worker_token(wid), False), now)

    def says(self, now: float, wid: str = ANN, **values: object) -> None:
        sign = Heartbeat(wid=wid, host="node7", **values)  # type: ignore[arg-type]
        key = KEYS.stat(f"worker/{wid}")
        self.turn.take(Sample(key, msgspec.json.encode(sign), "application/json"), now)

    def shown(self, now: float) -> list[WorkerStatus]:
        return [worker for page in self.turn.crew.pages(now) for worker in page.workers]

    def states(self, now: float) -> list[str]:
        return [worker.state for worker in self.shown(now)]

    @property
    def words(self) -> list[str]:
        return [event.words for event in self.events]


@pytest.fixture
def office() -> Office:
    return Office()


def test_what_a_worker_says_of_itself_is_shown(office: Office) -> None:
    office.joins(join(ANN), 10.0)
    office.says(12.0, memory=1 << 30, restarts=2)
    (ann,) = office.shown(15.0)
    assert (ann.memory, ann.restarts, ann.host, ann.pid) == (1 << 30, 2, "node7", 9)
    assert (ann.seconds, ann.seen) == (5.0, 3.0)


def test_a_killed_worker_is_gone_at_once_and_stays_on_the_list_for_a_minute(office: Office) -> None:
    office.joins(join(ANN), 0.0)
    office.joins(join(BOB), 0.0)
    office.dies(ANN, 5.0)
    assert office.states(5.0) == ["gone", "idle"]
    office.turn.step(6.1)
    assert office.words[-1] == "Worker aaaaaaaa on node7 (process 9) is gone: its token vanished."
    assert office.states(6.1 + GONE_SECONDS - 0.1) == ["idle", "gone"]
    assert office.states(6.2 + GONE_SECONDS) == ["idle"]


def test_a_worker_whose_token_is_late_is_not_shown_as_gone(office: Office) -> None:
    office.turn.take(JoinRequest(join(ANN)), 0.0)
    assert office.states(1.0) == ["idle"]
    office.turn.take(TokenChange(KEYS.worker_token(ANN), True), 2.0)
    office.dies(ANN, 3.0)
    assert office.states(3.0) == ["gone"]


def test_a_worker_that_said_it_leaves_has_left(office: Office) -> None:
    office.joins(join(ANN), 0.0)
    office.joins(join(ANN, number=2, credit=0), 1.0)
    office.dies(ANN, 2.0)
    office.turn.step(4.0)
    assert [words.split(")")[1] for words in office.words] == [" joined.", " has left."]


def test_a_worker_that_joins_again_goes_on_as_it_was(office: Office) -> None:
    office.joins(join(ANN), 0.0)
    office.dies(ANN, 5.0)
    office.turn.step(7.0)
    office.joins(join(ANN, number=2), 20.0)
    (ann,) = office.shown(30.0)
    assert (ann.state, ann.seconds) == ("idle", 30.0)


def test_a_refused_worker_is_told_of_with_the_reason(office: Office) -> None:
    office.joins(join(ANN), 0.0)
    other = msgspec.structs.replace(join(BOB), platform={"pybullet": "9"})
    assert office.joins(other, 1.0).exception()
    (_, refused) = office.events
    assert (refused.kind, refused.worker) == ("worker", BOB)
    assert "was refused" in refused.words
    assert "pybullet" in refused.words


def test_a_sign_without_progress_keeps_nobody_from_being_stuck(office: Office) -> None:
    office.joins(join(ANN), 0.0)
    member = office.turn.dispatch.members[0]
    office.says(5.0, progressed=False)
    assert (member.progress, office.shown(5.0)[0].seen) == (0.0, 0.0)
    office.says(6.0, progressed=True)
    assert member.progress == 6.0


@pytest.mark.parametrize("workers", [0, 1, WORKERS_PER_PAGE, WORKERS_PER_PAGE + 1])
def test_each_worker_stands_on_one_page(office: Office, workers: int) -> None:
    for number in range(workers):
        office.joins(join(f"{number:032x}"), 0.0)
    pages: list[WorkersPage] = office.turn.crew.pages(1.0)
    assert [page.page for page in pages] == list(range(max(1, -(-workers // WORKERS_PER_PAGE))))
    assert {page.pages for page in pages} == {len(pages)}
    assert [int(worker.wid, 16) for page in pages for worker in page.workers] == list(range(workers))


def test_no_more_of_those_who_are_gone_are_kept_than_can_be_shown() -> None:
    team = WorkerActivity()
    for number in range(2 * MOST_GONE):
        team.joined(join(f"{number:032x}"), 0.0)
        team.lost(f"{number:032x}", 0.0)
    assert sum(len(page.workers) for page in team.pages([], 1.0)) == MOST_GONE


ANN = "a" * 32
LONG = Plan(population=40, evaluations=100_000)


class Clock(Inbox):
    """An inbox whose waiting is all the time that passes, and what happens when.

    Until the first run is open, which takes another thread some time, none does.
    """

    def __init__(self, now: float) -> None:
        super().__init__()
        self.now = self.began = now
        self.happens: list[tuple[float, Callable[[], object]]] = []
        self.is_running: Callable[[], bool] = lambda: False

    def take(self, patience: float, most: int = 256) -> list[InboxEvent]:
        if not self.is_running():
            return super().take(min(patience, 0.01), most)
        events = super().take(0.0, most)
        if events:
            return events
        self.now += patience
        if self.happens and self.happens[0][0] <= self.now - self.began:
            after, act = self.happens.pop(0)
            self.now = self.began + after
            act()
        return super().take(0.0, most)


def join_request() -> JoinRequest:
    return JoinRequest(
        Join(versions=[1], wid=ANN, number=1, credit=2, held=[], host="here", pid=1, platform=PLATFORM)
    )


@pytest.mark.parametrize("tenth", range(10))
def test_a_worker_whose_token_vanishes_is_shown_as_gone_within_half_a_second(
    tenth: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whenever that is in the second between two publications of the team."""
    clock, lost_after = Clock(now=1000.0), 5.0 + tenth / 10
    monkeypatch.setattr(coordinator_service, "Inbox", lambda: clock)
    monkeypatch.setattr(coordinator_service, "time", SimpleNamespace(monotonic=lambda: clock.now))
    job = Job({"run-0": LONG})
    states: list[tuple[float, list[str]]] = []

    def heard(sample: Sample) -> None:
        page = from_json(sample.payload, WorkersPage)
        states.append((clock.now - clock.began, [one.state for one in page.workers]))
        if states[-1][1] == ["gone"]:
            job.stop.set(15)

    with ExitStack() as stack, job.network.session() as monitor, job.network.session() as worker:
        stack.enter_context(monitor.subscribe(KEYS.stat("team/*"), heard))
        clock.is_running = lambda: bool(job.open and job.open[-1])
        clock.happens = [
            (0.0, lambda: stack.enter_context(worker.token(KEYS.worker_token(ANN)))),
            (0.1, lambda: clock.put(join_request())),
            (lost_after, worker.close),
        ]
        job.service.run(lambda now: job.open.append(job.service.figures(now).runs_open))
    assert ["working"] in [shown for at, shown in states if at < lost_after]
    assert states[-1][0] - lost_after <= STATUS_INTERVAL + 1e-9
