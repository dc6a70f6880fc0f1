"""A coordinator's service over a bus in memory, with workers that only pretend."""

import hashlib
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from queue import SimpleQueue
from typing import Protocol

import numpy as np
from tests.common import PATIENCE
from tests.coordinator.recorder.fakes import JOB
from tests.coordinator.scheduler.search_plans import SHAPE, Plan, evaluate

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.monitor.feed import reachable_jobs
from qdgrasp_coordinator.monitor.job_view import JobView
from qdgrasp_coordinator.scheduler.coordinator_service import CoordinatorService
from qdgrasp_coordinator.scheduler.pipeline import Pipeline
from qdgrasp_coordinator.scheduler.recorder_client import MemorySink, RecorderClient, RowSink
from qdgrasp_coordinator.scheduler.run_plan import JobExtent, RunPlan
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus, Sample
from qdgrasp_protocol.errors import DiskFull, QdgraspError, RunFailed, TookOver
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.memory_bus import MemoryNetwork
from qdgrasp_protocol.messages import Control, Join, Joined, Opened, OpenRun, Order, OrderReply, Result, Work
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.rows import COLUMNS, RESULT, pack, unpack
from qdgrasp_protocol.spec import RunSpec

PLATFORM = {"pybullet": "3.2.7"}
SPEC = RunSpec(gripper="hand", object="thing")
WORK = [column for column in COLUMNS if column.name in ("index", "trial", "genome")]
PLANS = {f"run-{seed}": Plan(seed=seed, population=5 + seed, evaluations=40) for seed in range(6)}


def until(condition: Callable[[], bool]) -> None:
    """Look again and again until something holds; the test fails when it takes too long."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)  # between two looks; nothing depends on how long it is


def assignment(name: str, plan: Plan) -> RunPlan:
    """The run of a plan at its very beginning."""
    bundle = Bundle(name.encode() * 100, hashlib.sha256(name.encode() * 100).hexdigest())
    return RunPlan(name, SPEC, bundle, "none", SHAPE, plan.pipeline())


class FakeRunQueue:
    """A programme of runs; those of no plan cannot be made."""

    def __init__(self, plans: dict[str, Plan | None]) -> None:
        self.extent = JobExtent.of({name: plan.evaluations if plan else 0 for name, plan in plans.items()})
        self._plans = plans
        self._left = list(plans)
        self.pipelines: list[weakref.ref[Pipeline]] = []
        self.has_room = threading.Event()
        self.has_room.set()

    def next(self) -> RunPlan | None:
        if not self._left:
            return None
        if not self.has_room.is_set():
            raise DiskFull("There is no room.")
        name = self._left.pop(0)
        plan = self._plans[name]
        if plan is None:
            raise RunFailed(name, "Its mesh is no mesh.")
        made = assignment(name, plan)
        self.pipelines.append(weakref.ref(made.pipeline))
        return made

    def put_back(self, run: str) -> None:
        self._left.insert(0, run)


class FakeWorker:
    """A worker that joins, and answers each batch in the thread that brings it, or keeps it."""

    def __init__(self, bus: Bus, wid: str, *, answers: bool = True) -> None:
        self._bus, self._keys, self._wid, self._answers = bus, Keys(JOB), wid, answers
        self._inbox: SimpleQueue[Sample | None] = SimpleQueue()
        self.runs: set[str] = set()
        self.rows = 0
        self.kept = threading.Event()
        self.controls: list[Control] = []

    @contextmanager
    def at_work(self) -> Iterator["FakeWorker"]:
        thread = threading.Thread(target=self._run)
        with ExitStack() as stack:
            stack.enter_context(self._bus.subscribe(self._keys.work(self._wid), self._inbox.put))
            stack.enter_context(self._bus.subscribe(self._keys.ctl(self._wid), self._heed))
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

    def _heed(self, sample: Sample) -> None:
        self.controls.append(messages.decode(sample.payload, Control))

    def _join(self) -> None:
        request = Join(
            versions=[1], wid=self._wid, number=1, credit=2, held=[], host="here", pid=1, platform=PLATFORM
        )
        messages.decode(self._bus.ask(self._keys.join, messages.encode(request), timeout=PATIENCE), Joined)

    def _run(self) -> None:
        while (sample := self._inbox.get()) is not None:
            work = messages.decode(sample.payload, Work)
            self.runs.add(work.run)
            self.rows += work.n
            if self._answers:
                key, result = self._keys.result(self._wid), self._result(work)
                self._bus.put(key, messages.encode(result), encoding=messages.encoding(Result))
            else:
                self.kept.set()

    def _result(self, work: Work) -> Result:
        rows = unpack(SHAPE.empty(work.n), WORK, work.columns, SHAPE)
        found = evaluate(rows)
        failures = [{"row": int(i), "reason": "poison"} for i in np.flatnonzero(found["outcome"] == 0)]
        return messages.decode(
            messages.encode(
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


class OtherPlatformSink(MemorySink):
    """The record of a run that was begun on another platform."""

    def open(self, run: OpenRun, epoch: int, wait: Callable[[], None]) -> Opened:
        return Opened(epoch=1, durable=[0], platform={"pybullet": "2.0"})


class IdentifiedSink(MemorySink):
    """The record of a run of a job with an identity."""

    def open(self, run: OpenRun, epoch: int, wait: Callable[[], None]) -> Opened:
        return Opened(epoch=2, durable=[0], platform={}, identity="mine")


class ReplacedSink(MemorySink):
    """The record of a run that another coordinator has opened."""

    def open(self, run: OpenRun, epoch: int, wait: Callable[[], None]) -> Opened:
        raise TookOver(JOB, epoch + 1)


class SlowSink(MemorySink):
    """A record whose rows take their time to be safe."""

    is_safe = False

    @property
    def is_empty(self) -> bool:
        return self.is_safe


class Network(Protocol):
    """Whatever opens sessions."""

    def session(self) -> Bus:
        """Another one."""


class Job:
    """A coordinator of many runs on a network, whose rows stay in memory.

    Parameters
    ----------
    network
        Its first session is the coordinator's; None: one in memory.
    recorded
        Whether a recorder keeps them instead.
    kinds
        The records of some runs, where they are not simply `MemorySink`.
    """

    def __init__(
        self,
        plans: dict[str, Plan | None],
        *,
        network: Network | None = None,
        seconds: float | None = None,
        recorded: bool = False,
        **kinds: type[MemorySink],
    ) -> None:
        self._kinds = kinds
        self._recorded = recorded
        self.programme = FakeRunQueue(plans)
        self.network = network or MemoryNetwork()
        self.stop = Stop()
        self.records: dict[str, MemorySink] = {}
        self.open: list[int] = []
        self.bus = self.network.session()
        self.service = CoordinatorService(
            self.bus,
            self.stop,
            job=JOB,
            queue=self.programme,
            make_sink=self._record,
            batch_size=2,
            seconds=seconds,
        )

    def _record(self, assignment: RunPlan) -> RowSink:
        if self._recorded:
            return RecorderClient(self.bus, JOB, SHAPE)
        kind = self._kinds.get(assignment.run, MemorySink)
        return self.records.setdefault(assignment.run, kind(SHAPE))

    def carry_out(self, workers: int = 2) -> None:
        with ExitStack() as stack:
            for number in range(workers):
                stack.enter_context(FakeWorker(self.network.session(), f"{number:032x}").at_work())
            self.service.run(lambda now: self.open.append(self.service.status(now).runs_open))

    @contextmanager
    def serving(self) -> Iterator[threading.Thread]:
        """The service in a thread of its own that answers, stopped at the end if it still goes on."""
        self.error: Exception | None = None
        thread = threading.Thread(target=self._serve)
        thread.start()
        try:
            with self.network.session() as bus:
                until(lambda: bool(bus.ask_all(Keys(JOB).stat("job"))) or not thread.is_alive())
            yield thread
        finally:
            self.stop.set(15)
            thread.join(PATIENCE)

    def _serve(self) -> None:
        try:
            self.service.run()
        except QdgraspError as error:
            self.error = error

    def journals(self) -> dict[str, bytes]:
        return {name: record.rows.tobytes() for name, record in self.records.items()}


def send_command(bus: Bus, act: str, **whom: str) -> str:
    order = Order(act=act, **whom)  # type: ignore[arg-type]
    return messages.decode(
        bus.ask(Keys(JOB).control, messages.encode(order), timeout=PATIENCE), OrderReply
    ).words


def job_view(bus: Bus) -> JobView:
    (view,) = reachable_jobs(bus)
    return view
