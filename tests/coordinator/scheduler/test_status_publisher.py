"""Status on the bus: published, and answered to queries of late comers."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest
from tests.common import PATIENCE, wait_for
from tests.coordinator.scheduler.search_plans import Plan
from tests.fakes.job import PLANS, Job
from tests.fakes.messages import ANN, FAY, made_id
from tests.fakes.recorder import JOB
from tests.fakes.worker import FakeWorker

from qdgrasp_coordinator.metrics import job_status
from qdgrasp_coordinator.metrics.job_status import JobEvent, JobStatus, RunStatus, WorkersPage, from_json
from qdgrasp_coordinator.metrics.run_stats import RunCounter
from qdgrasp_coordinator.scheduler.status_publisher import STALE_SECONDS, StatusCache
from qdgrasp_protocol.bus import Bus, Query, Sample
from qdgrasp_protocol.errors import NoReply, RunsFailed
from qdgrasp_protocol.keys import Keys, matches
from qdgrasp_protocol.rows import Outcome

ROOT = "qdgrasp/v1/mugs/stat"


class Wall:
    """A status cache with a clock that is set by hand."""

    def __init__(self) -> None:
        self.now = 100.0
        self.cache = StatusCache(lambda: self.now)

    def asked(self, key: str) -> dict[str, bytes]:
        return self.cache.answer(Query(f"{ROOT}/{key}", "", b""))


def test_what_is_not_there_any_more_is_told_to_nobody() -> None:
    wall = Wall()
    for key in ("job", "run/a", "run/b", "team/0", "team/1"):
        wall.cache.set(f"{ROOT}/{key}", b"")
    wall.cache.retain(f"{ROOT}/run/*", {"b"})
    wall.cache.retain(f"{ROOT}/team/*", {"0"})
    assert {*wall.asked("**")} == {f"{ROOT}/{key}" for key in ("job", "run/b", "team/0")}


def test_of_a_coordinator_that_stands_still_nothing_is_told() -> None:
    wall = Wall()
    wall.cache.set(f"{ROOT}/job", b"")
    wall.now += STALE_SECONDS
    assert wall.asked("job")
    wall.now += 0.1
    with pytest.raises(NoReply):
        wall.asked("job")


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
    tally = RunCounter(plan.spec)
    tally.count(job.records["run-3"].rows)
    assert (last.totals, last.rows, last.outcomes) == (tally.totals, tally.rows, tally.outcomes)
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


def test_what_happens_is_told_when_it_does() -> None:
    job = Job({"bad": None, "run-1": replace(PLANS["run-1"], seed=2)})
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
