"""The coordinator's service with many runs at once, over a bus in memory and a worker that only pretends."""

import hashlib
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from queue import SimpleQueue

import numpy as np
import pytest
from tests.coordinator.plans import SHAPE, Chain, Plan, evaluate, reference

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.assignment import Assignment
from qdgrasp_coordinator.figures import JobFigures, from_json
from qdgrasp_coordinator.pipeline import Pipeline
from qdgrasp_coordinator.programme import Extent
from qdgrasp_coordinator.record import Memory
from qdgrasp_coordinator.service import CoordinatorService
from qdgrasp_protocol import chunks, codec
from qdgrasp_protocol.bus import Bus, Sample
from qdgrasp_protocol.errors import DiskFull, InputError, Refused, RunFailed, RunsFailed
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.local_bus import LocalNetwork
from qdgrasp_protocol.messages import Join, Joined, Opened, OpenRun, Result, Work
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import COLUMNS, RESULT, pack, unpack

JOB = "many"
SOON = 20.0
PLATFORM = {"pybullet": "3.2.7"}
WORK = [column for column in COLUMNS if column.name in ("index", "trial", "genome")]
PLANS = {f"run-{seed}": Plan(seed=seed, population=5 + seed, evaluations=40) for seed in range(6)}


class Runs:
    """A programme of runs; those of no plan cannot be made."""

    def __init__(self, plans: dict[str, Plan | None]) -> None:
        self.extent = Extent(runs=len(plans), evaluations=sum(p.evaluations for p in plans.values() if p))
        self._left = list(plans.items())
        self.pipelines: list[weakref.ref[Pipeline]] = []
        self.has_room = threading.Event()
        self.has_room.set()

    def next(self) -> Assignment | None:
        if not self._left:
            return None
        if not self.has_room.is_set():
            raise DiskFull("There is no room.")
        name, plan = self._left.pop(0)
        if plan is None:
            raise RunFailed(name, "Its mesh is no mesh.")
        search = Chain(plan.population, plan.seed)
        pipeline = Pipeline(search, SHAPE, plan.evaluations, plan.overlaps)
        self.pipelines.append(weakref.ref(pipeline))
        bundle = Bundle(name.encode() * 100, hashlib.sha256(name.encode() * 100).hexdigest())
        return Assignment(name, b"", bundle, "none", SHAPE, pipeline, plan.evaluations)


class Pretender:
    """A worker that joins, and answers each batch in the thread that brings it, or keeps it."""

    def __init__(self, bus: Bus, wid: str, *, answers: bool = True) -> None:
        self._bus, self._keys, self._wid, self._answers = bus, Keys(JOB), wid, answers
        self._inbox: SimpleQueue[Sample | None] = SimpleQueue()
        self.runs: set[str] = set()
        self.rows = 0
        self.kept = threading.Event()

    @contextmanager
    def at_work(self) -> Iterator["Pretender"]:
        thread = threading.Thread(target=self._run)
        with ExitStack() as stack:
            stack.enter_context(self._bus.subscribe(self._keys.work(self._wid), self._inbox.put))
            stack.enter_context(self._bus.token(self._keys.worker_token(self._wid)))
            stack.enter_context(self._bus.watch(self._keys.coordinator_token(), self._met))
            thread.start()
            try:
                yield self
            finally:
                self._inbox.put(None)
                thread.join()

    def _met(self, _key: str, alive: bool) -> None:
        if alive:
            threading.Thread(target=self._join).start()

    def _join(self) -> None:
        request = Join(
            versions=[1], wid=self._wid, number=1, credit=2, held=[], host="here", pid=1, platform=PLATFORM
        )
        codec.decode(self._bus.ask(self._keys.join, codec.encode(request), timeout=SOON), Joined)

    def _run(self) -> None:
        while (sample := self._inbox.get()) is not None:
            work = codec.decode(sample.payload, Work)
            self.runs.add(work.run)
            self.rows += work.n
            if self._answers:
                key, result = self._keys.result(self._wid), self._result(work)
                self._bus.put(key, codec.encode(result), encoding=codec.encoding(Result))
            else:
                self.kept.set()

    def _result(self, work: Work) -> Result:
        rows = unpack(SHAPE.empty(work.n), WORK, work.columns, SHAPE)
        found = evaluate(rows)
        failures = [{"row": int(i), "reason": "poison"} for i in np.flatnonzero(found["outcome"] == 0)]
        return codec.decode(
            codec.encode(
                Result(
                    epoch=work.epoch,
                    run=work.run,
                    generation=work.generation,
                    batch=work.batch,
                    attempt=work.attempt,
                    wid=self._wid,
                    n=work.n,
                    joints=SHAPE.joints,
                    descriptors=SHAPE.descriptors,
                    columns=pack(found, RESULT),
                    cpu_seconds=0.001,
                    failures=failures,  # type: ignore[arg-type]
                )
            ),
            Result,
        )


class Elsewhere(Memory):
    """The record of a run that was begun on another platform."""

    def open(self, run: OpenRun, epoch: int, wait: Callable[[], None]) -> Opened:
        return Opened(epoch=1, durable=[0], platform={"pybullet": "2.0"})


class Slow(Memory):
    """A record whose rows take their time to be safe."""

    is_safe = False

    @property
    def is_empty(self) -> bool:
        return self.is_safe


class Job:
    """A coordinator of many runs on a network, whose rows stay in memory.

    Parameters
    ----------
    kinds
        The records of some runs, where they are not simply `Memory`.
    """

    def __init__(self, plans: dict[str, Plan | None], **kinds: type[Memory]) -> None:
        self._kinds = kinds
        self.programme = Runs(plans)
        self.network = LocalNetwork()
        self.stop = Stop()
        self.records: dict[str, Memory] = {}
        self.open: list[int] = []
        self.service = CoordinatorService(
            self.network.session(),
            self.stop,
            job=JOB,
            programme=self.programme,
            make_record=self._record,
            batch_size=2,
        )

    def _record(self, assignment: Assignment) -> Memory:
        kind = self._kinds.get(assignment.run, Memory)
        return self.records.setdefault(assignment.run, kind(SHAPE))

    def carry_out(self, workers: int = 2) -> None:
        with ExitStack() as stack:
            for number in range(workers):
                stack.enter_context(Pretender(self.network.session(), f"{number:032x}").at_work())
            self.service.run(lambda now: self.open.append(self.service.figures(now).runs_open))

    def journals(self) -> dict[str, bytes]:
        return {name: record.rows.tobytes() for name, record in self.records.items()}


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
    with Pretender(job.network.session(), "f" * 32, answers=False).at_work() as idle:
        service = threading.Thread(target=job.service.run)
        service.start()
        try:
            assert idle.kept.wait(SOON)
            scene = b"run-0" * 100
            assert chunks.fetch(other, JOB, hashlib.sha256(scene).hexdigest()) == scene
            with pytest.raises(Refused, match="no run in progress has the scene"):
                chunks.fetch(other, JOB, "0" * 64)
        finally:
            job.stop.set(15)
            service.join()


def test_the_last_figures_of_the_job_count_all_runs() -> None:
    job = Job(dict(PLANS))
    seen: list[JobFigures] = []
    with job.network.session().subscribe(
        Keys(JOB).stat("job"), lambda sample: seen.append(from_json(sample.payload, JobFigures))
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

    with Pretender(job.network.session(), "f" * 32).at_work():
        job.service.run(make_room)
    assert job.journals() == {name: reference(plan) for name, plan in PLANS.items()}


def test_a_run_of_another_platform_fails_and_the_others_are_done() -> None:
    job = Job(dict(PLANS), **{"run-5": Elsewhere})
    with pytest.raises(RunsFailed, match=r"'run-5': Its rows were made elsewhere: .* pybullet 2\.0"):
        job.carry_out()
    assert job.journals() == {name: reference(plan) for name, plan in PLANS.items()} | {"run-5": b""}


def test_nobody_works_on_what_a_finished_run_does_not_need() -> None:
    plan = Plan(population=200, evaluations=20, overlaps="redraw")
    job = Job({"slow": plan}, slow=Slow)
    looks: list[float] = []

    def look(now: float) -> None:
        if job.service.figures(now).evaluations == plan.evaluations:
            looks.append(now)
        if len(looks) == 5:
            record = job.records["slow"]
            assert isinstance(record, Slow)
            record.is_safe = True

    with Pretender(job.network.session(), "f" * 32).at_work() as worker:
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
