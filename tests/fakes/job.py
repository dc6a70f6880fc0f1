"""A coordinator's service over a bus in memory, with runs and workers that only pretend."""

import hashlib
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from math import inf

from tests.common import PATIENCE, wait_for
from tests.coordinator.scheduler.search_plans import SHAPE, Plan
from tests.fakes.memory_bus import MemoryNetwork
from tests.fakes.messages import made_id
from tests.fakes.recorder import JOB
from tests.fakes.service_thread import ServiceThread
from tests.fakes.worker import FakeWorker

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.metrics.job_status import EventLog, JobEvent
from qdgrasp_coordinator.scheduler.coordinator_service import CoordinatorService
from qdgrasp_coordinator.scheduler.job_scheduler import JobScheduler
from qdgrasp_coordinator.scheduler.recorder_client import RowSink
from qdgrasp_coordinator.scheduler.run_plan import JobExtent, RunPlan, RunQueue
from qdgrasp_coordinator.scheduler.run_registry import LoaderEvent, RunLoader, RunRegistry
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.errors import DiskFull, RunFailed, TookOver
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Opened, OpenRun, Order, OrderReply
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.monitor.feed import reachable_jobs
from qdgrasp_tools.monitor.job_model import JobView

SPEC = RunSpec(gripper="hand", object="thing")
PLANS = {f"run-{seed}": Plan(seed=seed, population=5 + seed, evaluations=40) for seed in range(6)}


def make_run_plan(name: str, plan: Plan) -> RunPlan:
    """The run of a plan at its very beginning."""
    bundle = Bundle(name.encode() * 100, hashlib.sha256(name.encode() * 100).hexdigest())
    return RunPlan(name, SPEC, bundle, "none", SHAPE, plan.pipeline())


class FakeRunQueue(RunQueue):
    """A programme of runs; those of no plan cannot be made."""

    def __init__(self, plans: dict[str, Plan | None]) -> None:
        self.extent = JobExtent.of({name: plan.evaluations if plan else 0 for name, plan in plans.items()})
        self._plans = plans
        self._left = list(plans)
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
        return make_run_plan(name, plan)

    def put_back(self, run: str) -> None:
        self._left.insert(0, run)


def runs_of(queue: FakeRunQueue, news: Callable[[LoaderEvent], object] = lambda _event: None) -> RunRegistry:
    """The runs of a queue, whose rows stay in memory."""
    return RunRegistry(queue, RunLoader(queue, lambda run: RowSink(run.shape), news, Stop()))


def scheduler_of(
    queue: FakeRunQueue, hear: Callable[[JobEvent], object] = lambda _: None, ends_at: float = inf
) -> JobScheduler:
    """The scheduler of these runs in its first epoch, which sends nothing; its events are heard."""
    scheduler = JobScheduler(JOB, runs_of(queue), lambda *_: None, events=EventLog(hear), ends_at=ends_at)
    scheduler.start_epoch(1)
    return scheduler


class OpenedSink(RowSink):
    """A record that is opened with an answer of its own."""

    answer: Opened

    def open(self, run: OpenRun, epoch: int, wait: Callable[[], None]) -> Opened:
        return self.answer


class OtherPlatformSink(OpenedSink):
    """The record of a run that was begun on another platform."""

    answer = Opened(epoch=1, durable=[0], platform={"pybullet": "2.0"})


class ReplacedSink(RowSink):
    """The record of a run that another coordinator has opened."""

    def open(self, run: OpenRun, epoch: int, wait: Callable[[], None]) -> Opened:
        raise TookOver(JOB, epoch + 1)


class SlowSink(RowSink):
    """A record whose rows take their time to be safe."""

    is_safe = False

    @property
    def is_empty(self) -> bool:
        return self.is_safe


class Job:
    """A coordinator of many runs on a network, whose rows stay in memory.

    The network's first session is the coordinator's. `kinds` are the records of some runs, where they are
    not simply `RowSink`.
    """

    def __init__(
        self,
        plans: dict[str, Plan | None],
        *,
        seconds: float | None = None,
        **kinds: type[RowSink],
    ) -> None:
        self._kinds = kinds
        self.programme = FakeRunQueue(plans)
        self.network = MemoryNetwork()
        self.stop = Stop()
        self.records: dict[str, RowSink] = {}
        self.open: list[int] = []
        self.bus = self.network.session()
        how = {"job": JOB, "queue": self.programme, "make_sink": self._record, "batch_size": 2}
        self.service = CoordinatorService(self.bus, self.stop, seconds=seconds, **how)

    def _record(self, plan: RunPlan) -> RowSink:
        kind = self._kinds.get(plan.run, RowSink)
        return self.records.setdefault(plan.run, kind(SHAPE))

    def carry_out(self, workers: int = 2) -> None:
        with ExitStack() as stack:
            for number in range(workers):
                stack.enter_context(FakeWorker(self.network.session(), made_id(number)).at_work())
            self.service.run(lambda now: self.open.append(self.service.scheduler.status(now).runs_open))

    @contextmanager
    def serving(self) -> Iterator[ServiceThread]:
        """The service in a thread of its own that answers, stopped at the end if it still goes on."""
        thread = ServiceThread(self.service.run, self.stop)
        try:
            with self.network.session() as bus:
                wait_for(lambda: bool(bus.ask_all(Keys(JOB).stat("job"))) or not thread.is_alive)
            yield thread
        finally:
            thread.leave()
            thread.ends()

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
