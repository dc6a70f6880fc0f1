"""Status on the bus: published, and answered to queries of late comers."""

import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from operator import attrgetter
from types import SimpleNamespace

import pytest
from tests.common import PATIENCE, wait_for
from tests.coordinator.scheduler.search_plans import Plan
from tests.fakes.job import PLANS, IdentifiedSink, Job
from tests.fakes.messages import ANN, FAY, join_message, made_id
from tests.fakes.recorder import JOB
from tests.fakes.worker import FakeWorker

from qdgrasp_coordinator.metrics import job_status
from qdgrasp_coordinator.metrics.job_status import (
    EVENTS_KEPT,
    EventLog,
    JobEvent,
    JobEvents,
    JobMeta,
    JobStatus,
    RunStatus,
    WorkersPage,
    from_json,
    to_json,
)
from qdgrasp_coordinator.metrics.run_stats import CurvePoint, GrowthCurve, RunCounter
from qdgrasp_coordinator.scheduler import coordinator_service, status_publisher
from qdgrasp_coordinator.scheduler.inbox import Inbox, InboxEvent, JoinRequest
from qdgrasp_coordinator.scheduler.status_publisher import (
    CURVE_SECONDS,
    STALE_SECONDS,
    STATUS_INTERVAL,
    StatusCache,
    StatusPublisher,
)
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus, Query, Sample
from qdgrasp_protocol.errors import NoReply, RunsFailed
from qdgrasp_protocol.keys import Keys, matches
from qdgrasp_protocol.messages import Opened
from qdgrasp_protocol.rows import Outcome

ROOT = "qdgrasp/v1/mugs/stat"


class Wall:
    """A status cache with a clock that is set by hand, and the curve of one run."""

    def __init__(self) -> None:
        self.now = 100.0
        self.points: list[CurvePoint] = []
        self.cache = StatusCache(self.curves, lambda: self.now)

    def curves(self) -> dict[str, GrowthCurve]:
        return {f"{ROOT}/curve/a": GrowthCurve(run="a", points=self.points)}

    def asked(self, key: str) -> dict[str, bytes]:
        return self.cache.answer(Query(f"{ROOT}/{key}", "", b""))


def test_what_was_shown_last_is_told_by_its_key() -> None:
    wall = Wall()
    for payload in (b"1", b"2"):
        wall.cache.set(f"{ROOT}/job", payload)
    wall.cache.set(f"{ROOT}/run/a", b"3")
    assert wall.asked("**") == {f"{ROOT}/job": b"2", f"{ROOT}/run/a": b"3"}
    assert wall.asked("run/*") == {f"{ROOT}/run/a": b"3"}


def test_what_is_not_there_any_more_is_told_to_nobody() -> None:
    wall = Wall()
    for key in ("job", "run/a", "run/b", "team/0", "team/1"):
        wall.cache.set(f"{ROOT}/{key}", b"")
    wall.cache.retain(f"{ROOT}/run/*", {"b"})
    wall.cache.retain(f"{ROOT}/team/*", {"0"})
    assert {*wall.asked("**")} == {f"{ROOT}/{key}" for key in ("job", "run/b", "team/0")}


def test_curves_are_drawn_once_in_a_while_however_many_ask() -> None:
    wall = Wall()
    before = wall.asked("curve/*")
    wall.points = [CurvePoint(1, 1, 1, 1, 1)]
    assert wall.asked("curve/a") == before
    wall.now += CURVE_SECONDS
    assert wall.asked("curve/a") == {f"{ROOT}/curve/a": to_json(GrowthCurve(run="a", points=wall.points))}


def test_of_a_coordinator_that_stands_still_nothing_is_told() -> None:
    wall = Wall()
    wall.cache.set(f"{ROOT}/job", b"")
    wall.now += STALE_SECONDS
    assert wall.asked("job")
    wall.now += 0.1
    with pytest.raises(NoReply):
        wall.asked("job")


def test_of_more_runs_than_are_published_at_once_each_has_its_turn(monkeypatch) -> None:
    monkeypatch.setattr(status_publisher, "RUNS_AT_ONCE", 2)
    publisher = StatusPublisher(None, SimpleNamespace(job=JOB))
    turns = [publisher._in_turn(list("abcde")) for _ in range(5)]
    assert ["".join(turn) for turn in turns] == ["ab", "cd", "ea", "bc", "de"]
    assert publisher._in_turn(["a", "b"]) == ["a", "b"]


KEYS = Keys(JOB)
LONG = Plan(population=40, evaluations=100_000)


class Heard:
    """All messages of a job that a monitor hears."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self.samples: list[Sample] = []

    @contextmanager
    def listening(self) -> Iterator["Heard"]:
        with (
            self._bus.subscribe(KEYS.stat(), self.samples.append),
            self._bus.subscribe(KEYS.event(), self.samples.append),
        ):
            yield self

    def of(self, pattern: str) -> list[bytes]:
        return [sample.payload for sample in self.samples if matches(pattern, sample.key)]

    def words(self, kind: str = "*") -> list[str]:
        return [from_json(payload, JobEvent).words for payload in self.of(KEYS.event(kind))]


def carried_out(job: Job, **how: int) -> Heard:
    with Heard(job.network.session()).listening() as heard:
        job.carry_out(**how)
    return heard


def test_the_last_figures_of_a_run_are_those_of_its_journal_and_say_why_it_is_over() -> None:
    plan = PLANS["run-3"]
    job = Job({"run-3": plan})
    last = from_json(carried_out(job).of(KEYS.stat("run/run-3"))[-1], RunStatus)
    tally = RunCounter(plan.evaluations, "count")
    tally.count(job.records["run-3"].rows)
    counts = attrgetter(
        "evaluations", "rows", "simulated", "successes", "grasps", "robust", "errors", "cells", "outcomes"
    )
    assert counts(last) == counts(tally)
    assert set(last.outcomes) == {outcome.name.lower() for outcome in Outcome}
    assert sum(last.outcomes.values()) == last.rows - last.trials
    assert last.finished == "the budget of 40 evaluations is spent"
    assert (last.gripper, last.object, last.protocol, last.budget) == ("hand", "thing", "paper", 40)


def test_the_figures_of_the_job_are_the_sums_of_those_of_its_runs() -> None:
    heard = carried_out(Job(dict(PLANS)))
    runs = {one.run: one for one in (from_json(text, RunStatus) for text in heard.of(KEYS.stat("run/*")))}
    last = from_json(heard.of(KEYS.stat("job"))[-1], JobStatus)
    for name in ("evaluations", "successes", "grasps", "robust", "errors", "cells", "overlaps"):
        assert getattr(last, name) == sum(getattr(run, name) for run in runs.values()), name
    assert (last.waiting, last.requeued, last.strays) == (0, 0, 0)


def test_rows_that_no_recorder_has_confirmed_are_waiting() -> None:
    job = Job({"run-0": LONG}, recorded=True)
    waits: list[int] = []

    def look(now: float) -> None:
        waits.append(job.service.status(now).waiting)
        if waits[-1] > 0:
            job.stop.set(15)

    opened = messages.encode(Opened(epoch=1, durable=[0], platform={}))
    with (
        job.network.session() as bus,
        bus.answer(KEYS.open, lambda _query: opened),
        FakeWorker(job.network.session(), ANN).at_work(),
    ):
        job.service.run(look)
    assert waits[-1] > 0


def test_what_happens_is_told_when_it_does() -> None:
    job = Job({"bad": None, "run-1": PLANS["run-1"]})
    heard = Heard(job.network.session())
    with heard.listening(), pytest.raises(RunsFailed):
        job.carry_out(workers=1)
    assert re.fullmatch(r"The coordinator on \S+ \(process \d+\) begins\.", heard.words("job")[0])
    assert heard.words("job")[1:] == ["The coordinator ends: done."]
    assert heard.words("run") == [
        "Run 'run-1' begins.",
        "Run 'run-1' is finished: the budget of 40 evaluations is spent.",
    ]
    assert heard.words("worker")[0] == f"Worker {made_id(0)[:8]} on here (process 1) joined."
    assert heard.words("error")[0] == "Run 'bad' cannot be carried out: Its mesh is no mesh."
    given_up = [words for words in heard.words("error") if "given up after 3 tries: poison" in words]
    assert len(given_up) == int((job.records["run-1"].rows["outcome"] == Outcome.ERROR).sum()) > 0
    numbers = [from_json(payload, JobEvent).number for payload in heard.of(KEYS.event())]
    assert numbers == list(range(1, len(numbers) + 1))


def test_whose_work_a_coordinator_goes_on_with_is_told_when_its_turn_begins() -> None:
    job = Job({"run-1": PLANS["run-1"]}, **{"run-1": IdentifiedSink})
    with job.network.session() as bus, bus.ring(KEYS.meta, 8) as ring:
        job.carry_out()
        (told,) = [from_json(sample.payload, JobMeta) for sample in ring.take()]
    assert (told.job, told.epoch, told.identity) == (JOB, 2, "mine")


def test_that_trouble_came_and_went_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job_status, "STARTUP_SECONDS", 0.0)
    job = Job(dict(PLANS))
    job.programme.has_room.clear()
    heard = Heard(job.network.session())

    def make_room(now: float) -> None:
        if heard.words("trouble") and not job.programme.has_room.is_set():
            job.programme.has_room.set()

    with heard.listening(), FakeWorker(job.network.session(), FAY).at_work():
        job.service.run(make_room)
    assert heard.words("trouble") == ["There is no room.", "It goes on; this is over: There is no room."]


def test_those_who_come_late_hear_what_happened_and_how_counts_grew() -> None:
    job = Job({"run-0": LONG})
    with job.serving(), job.network.session() as bus, FakeWorker(job.network.session(), ANN).at_work():
        wait_for(lambda: curve(bus, "run-0").points)
        wait_for(lambda: KEYS.stat("run/run-0") in bus.ask_all(KEYS.stat()))
        values = bus.ask_all(KEYS.stat())
        (recent,) = bus.ask_all(KEYS.recent).values()
        everywhere = bus.ask_all("qdgrasp/v1/*/stat/curve/*")
    kinds = {key.removeprefix(KEYS.stat("")).split("/")[0] for key in values}
    assert kinds == {"job", "run", "team"}, "curves are shown where they are asked for"
    assert "Run 'run-0' begins." in [event.words for event in from_json(recent, JobEvents).events]
    assert set(everywhere) == {KEYS.stat("curve/run-0")}
    first = curve_of(everywhere, "run-0").points[0]
    assert first.evaluations == LONG.population
    assert first.successes >= first.robust


def test_late_comers_are_answered_while_the_coordinator_has_no_time() -> None:
    job = Job({"run-0": LONG})
    answers: dict[str, bytes] = {}

    def ask(now: float) -> None:  # in the coordinator's one thread
        with job.network.session() as bus:
            answers.update(bus.ask_all("qdgrasp/v1/*/stat/**") | bus.ask_all(KEYS.stat("curve/*")))
        if {KEYS.stat("run/run-0"), KEYS.stat("curve/run-0")} <= {*answers}:
            job.stop.set(15)

    with FakeWorker(job.network.session(), ANN).at_work():
        job.service.run(ask)
    assert {KEYS.stat("job"), KEYS.stat("team/0")} <= {*answers}


def test_a_run_that_is_over_is_not_shown_to_late_comers() -> None:
    job = Job({"run-1": PLANS["run-1"], "run-0": LONG})
    with job.serving(), job.network.session() as bus, FakeWorker(job.network.session(), ANN).at_work():
        wait_for(lambda: any(from_json(told, JobStatus).runs_done for told in asked(bus, "job").values()))
        wait_for(lambda: [*asked(bus, "run/*")] == [KEYS.stat("run/run-0")])


def test_a_worker_that_dies_is_shown_as_gone() -> None:
    job = Job({"run-0": LONG})
    heard = Heard(job.network.session())
    with job.serving(), heard.listening():
        with FakeWorker(job.network.session(), ANN, answers=False).at_work() as ann:
            assert ann.kept.wait(PATIENCE)
            wait_for(lambda: "working" in states(heard))
        wait_for(lambda: states(heard)[-1:] == ["gone"])


def states(heard: Heard) -> list[str]:
    """The states of the first worker, as they were heard."""
    pages = [from_json(payload, WorkersPage) for payload in heard.of(KEYS.stat("team/0"))]
    return [page.workers[0].state for page in pages if page.workers]


def asked(bus: Bus, what: str) -> dict[str, bytes]:
    return bus.ask_all(KEYS.stat(what))


def curve(bus: Bus, run: str) -> GrowthCurve:
    return curve_of(asked(bus, f"curve/{run}"), run)


def curve_of(values: dict[str, bytes], run: str) -> GrowthCurve:
    payload = values.get(KEYS.stat(f"curve/{run}"))
    return from_json(payload, GrowthCurve) if payload else GrowthCurve(run=run, points=[])


def test_nobody_needs_to_have_listened_to_hear_what_happened_last() -> None:
    chronicle = EventLog()
    for number in range(EVENTS_KEPT + 50):
        chronicle.note("job", f"{number}")
    latest = chronicle.latest.events
    assert (len(latest), latest[0].words, latest[-1].number) == (EVENTS_KEPT, "50", EVENTS_KEPT + 50)


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


@pytest.mark.parametrize("tenth", range(10))
def test_a_worker_whose_token_vanishes_is_shown_as_gone_within_half_a_second(tenth, monkeypatch) -> None:
    """Whenever that is in the second between two publications of the workers."""
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
            (0.1, lambda: clock.put(JoinRequest(join_message(ANN)))),
            (lost_after, worker.close),
        ]
        job.service.run(lambda now: job.open.append(job.service.status(now).runs_open))
    assert ["working"] in [shown for at, shown in states if at < lost_after]
    assert states[-1][0] - lost_after <= STATUS_INTERVAL + 1e-9
