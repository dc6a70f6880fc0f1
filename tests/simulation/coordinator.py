"""A simulated coordinator: the real scheduler, runs and link to the recorder, on one thread."""

import hashlib
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

from tests.fakes.messages import put
from tests.simulation.network import Network, Question, World
from tests.simulation.process import Busy, Listen, Process, Steps
from tests.simulation.worker import BUILDING_CODE, JOB, KEYS

from qdgrasp_coordinator.metrics.job_status import EventLog, JobEvent
from qdgrasp_coordinator.scheduler.coordinator_service import MOST_WAIT
from qdgrasp_coordinator.scheduler.job_scheduler import JobScheduler, JoinRequest
from qdgrasp_coordinator.scheduler.recorder_client import RecorderClient
from qdgrasp_coordinator.scheduler.run_plan import (
    BuildReply,
    JobExtent,
    RunPlan,
    RunQueue,
    WantedShape,
    WantedShapes,
)
from qdgrasp_coordinator.scheduler.run_registry import ActiveRun, LoadEnded, LoaderEvent, RunRegistry
from qdgrasp_protocol import messages
from qdgrasp_protocol.build_messages import MeshFile, ShapeTask
from qdgrasp_protocol.bus import LinkChange
from qdgrasp_protocol.errors import InputError, NoReply, Refused, TookOver
from qdgrasp_protocol.keys import last_chunk
from qdgrasp_protocol.messages import Join
from qdgrasp_protocol.rows import RowShape

NO_SHAPE = RowShape(0, 0)
RETRY = 0.5
"""Seconds between two tries to open a run; longer than in the service, to save time."""


def not_now() -> None:
    """Wait for another try."""
    raise NoReply("not now")


def shape_task(run: str) -> ShapeTask:
    """The build of the shape that a run waits for."""
    mesh = MeshFile(name="mesh.stl", sha256=hashlib.sha256(run.encode()).hexdigest(), size=1)
    return ShapeTask(files=(mesh,), code=BUILDING_CODE)


class SimulatedLoader(RunQueue):
    """Opens the runs of a job one at a time, without a thread; also the queue of the runs.

    It takes `seconds` on average to open one. Each run waits until its shape is among those that are
    `built`; None: runs wait for none.
    """

    excluded: frozenset[str] = frozenset()

    def __init__(
        self,
        host: "Coordinator",
        runs: list[str],
        plan: Callable[[str], RunPlan],
        seconds: float,
        built: set[str] | None,
    ) -> None:
        self.extent = JobExtent.of(dict.fromkeys(runs, 0))
        self.has_shapes = built is not None
        self.run = None
        self.trouble = ""
        self._host = host
        self._left = list(runs)
        self._built = set(runs) if built is None else built
        self._asked: dict[str, str] = {}
        """Runs by the keys of their shapes that are being built."""
        self._plan = plan
        self._seconds = seconds

    def put_back(self, run: str) -> None:
        self._left.insert(0, run)

    @property
    def ready_runs(self) -> int:
        return len(self._built.intersection(self._left))

    def begin(self, epoch: int, *, opens: bool, shapes: int, built: tuple[BuildReply, ...]) -> None:
        for reply in built:
            self._host.note(f"the shape of {self._asked[reply.key]}: {len(reply.pieces)} pieces")
            self._built.add(self._asked.pop(reply.key))
        if shapes:
            self._look_for_shapes(shapes)
        ready = next((run for run in self._left if run in self._built), None)
        if not opens:
            self._say(LoadEnded())
        elif ready is not None:
            self._left.remove(ready)
            self._try_to_open(ready, epoch)
        elif self._left and not epoch:
            self._try_to_begin()
        else:
            self._say(LoadEnded(runs_wait=True) if self._left else LoadEnded(is_last=True))

    def _say(self, event: LoaderEvent) -> None:
        self._host.scheduler.handle(event, self._host.now)

    def _look_for_shapes(self, most: int) -> None:
        missing = [run for run in self._left if run not in {*self._built, *self._asked.values()}]
        wanted = tuple(WantedShape(shape_task(run), Path(run)) for run in missing[:most])
        self._asked |= {shape.task.key: run for shape, run in zip(wanted, missing, strict=False)}
        self._say(WantedShapes(wanted, is_last=len(missing) <= most))

    def _try_to_begin(self) -> None:
        host, later = self._host, self._host.world.later
        if host.is_over:
            return
        try:
            opened = None if host.is_frozen else RecorderClient(host.bus, JOB, NO_SHAPE).begin_epoch(not_now)
        except NoReply:
            opened = None
        except (InputError, TookOver) as refusal:
            host.hear(LoadEnded(failure=refusal))
            return
        if opened is None:
            later(RETRY, self._try_to_begin)
        else:
            host.hear(LoadEnded(opened=opened))

    def _try_to_open(self, run: str, epoch: int) -> None:
        host, later = self._host, self._host.world.later
        if host.is_over:
            return
        if host.is_frozen:
            later(RETRY, lambda: self._try_to_open(run, epoch))
            return
        plan = self._plan(run)
        active = ActiveRun(plan, RecorderClient(host.bus, JOB, plan.shape))
        try:
            opened = active.open(epoch, not_now)
        except NoReply:
            later(RETRY, lambda: self._try_to_open(run, epoch))
        except (InputError, TookOver) as refusal:
            host.hear(LoadEnded(failure=refusal))
        else:
            host.note(f"opened {run} in epoch {opened.epoch} with {opened.durable[0]} rows")
            later(host.world.exponential(self._seconds), lambda: host.hear(LoadEnded(active, opened)))


class Coordinator(Process):
    """A coordinator process.

    `plan` makes the plan of a run, with a new search; `on_epoch` is called when its epoch begins. Runs wait
    for shapes until these are among the `built`; None: they do not.
    """

    def __init__(
        self,
        world: World,
        network: Network,
        name: str,
        runs: list[str],
        plan: Callable[[str], RunPlan],
        batch_size: int | None,
        *,
        on_epoch: Callable[["Coordinator"], None],
        opening: float = 0.2,
        built: set[str] | None = None,
    ) -> None:
        self._on_epoch = on_epoch
        loader = SimulatedLoader(self, runs, plan, opening, built)
        self.scheduler = JobScheduler(
            JOB,
            RunRegistry(loader, loader),  # type: ignore[arg-type]
            lambda key, message, channel: put(self.bus, key, message, channel),
            batch_size=batch_size,
            events=EventLog(self._show),
            on_epoch=self._open_to_workers,
            on_finished=lambda run, _now: self.note(f"{run.name} is done"),
        )
        self.link_is_up = True
        """True if its scheduler knows of no cut link."""
        self.is_done = False
        """All runs are finished and recorded."""
        self.was_replaced = False
        super().__init__(world, network, name)

    def steps(self) -> Steps:
        """Carry all runs out, or end when another coordinator took over."""
        self.network.subscribe(self.session, KEYS.recorded)
        self.network.watch(self.session, KEYS.recorder_token())
        try:
            self.scheduler.step(self.now)
            while not self.is_done:
                yield Listen(min(MOST_WAIT, max(0.0, self.scheduler.ends_at - self.now)))
                yield Busy(self.world.chance.uniform(0, 0.005))
                self._step()
        except TookOver as reason:
            self.note(str(reason))
            self.was_replaced = True

    def hear(self, event: object) -> None:
        """Hand requests to join over, and answer scene queries, as the subscriptions do."""
        if isinstance(event, Question) and event.query.key != KEYS.join:
            event.reply(self._scene(event.query.key))
        else:
            super().hear(self._request(event) if isinstance(event, Question) else event)

    def _scene(self, key: str) -> bytes | Exception:
        digests = {run.ref.scene for run in self.scheduler.runs}
        return b"a scene" if last_chunk(key) in digests else Refused("no run in progress has the scene")

    def _request(self, asked: Question) -> JoinRequest:
        def answered(answer: "Future[bytes]") -> None:
            error = answer.exception()
            asked.reply(error if isinstance(error, Exception) else answer.result())

        request = JoinRequest(messages.decode(asked.query.payload, Join))
        request.answer.add_done_callback(answered)
        return request

    def _be_over(self) -> None:
        super()._be_over()
        if self.session.is_local:
            self.network.go_down()

    def _step(self) -> None:
        for event in self.events():
            self.link_is_up = event.up if isinstance(event, LinkChange) else self.link_is_up
            self.scheduler.handle(event, self.now)  # type: ignore[arg-type]
        self.scheduler.step(self.now)
        self.is_done = self.scheduler.runs.are_done

    def _show(self, event: JobEvent) -> None:
        if event.kind == "recorder" and event.run:
            self.note(event.words)

    def _open_to_workers(self, epoch: int, _identity: str) -> None:
        self.link_is_up = True
        self._on_epoch(self)
        for pattern in (KEYS.result(), KEYS.stat("worker/*")):
            self.network.subscribe(self.session, pattern)
        self.network.answer(self.session, KEYS.join)
        self.network.answer(self.session, KEYS.asset())
        self.network.watch(self.session, KEYS.worker_token())
        self.network.watch(self.session, KEYS.coordinator_token())
        self.network.token(self.session, KEYS.coordinator_token(epoch))
