"""The rig: a router in a process of its own, stand-ins in others, and the coordinator in this one.

The coordinator is the real one, from its inbox to its outboxes; its CPU time is that of this process, threads
of the bus included.
"""

import multiprocessing
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from tests.benchmarks.scale.prepared import SHAPE
from tests.benchmarks.scale.stand_ins import Ready
from tests.endpoints import own_endpoint

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.campaigns.programme import Extent
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.runs.pipeline import Pipeline
from qdgrasp_coordinator.searches.search import Search
from qdgrasp_coordinator.serving.record import Record
from qdgrasp_coordinator.serving.service import CoordinatorService
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.spec import RunSpec, to_toml
from qdgrasp_protocol.zenoh_bus import ZenohBus

JOB = "scale"
ENDLESS = 10**9
SCENE = Bundle(b"", "0" * 64)


def assignment(run: str, spec: RunSpec, search: Search, in_flight: int = 1) -> Assignment:
    """A run that goes on for ever."""
    pipeline = Pipeline(search, SHAPE, spec.evaluations, "count", in_flight)
    return Assignment(run, to_toml(spec).encode(), SCENE, "contact", SHAPE, pipeline, spec.evaluations)


class Several:
    """A programme of runs that are all there, and go on as they are where they are put back."""

    def __init__(self, runs: list[Assignment]) -> None:
        self.extent = Extent.of({run.run: run.evaluations for run in runs})
        self._runs = {run.run: run for run in runs}
        self._left = list(runs)

    def next(self) -> Assignment | None:
        return self._left.pop(0) if self._left else None

    def put_back(self, run: str) -> None:
        self._left.insert(0, self._runs[run])


@dataclass(frozen=True)
class Window:
    """What the coordinator did in a time."""

    seconds: float
    cpu_seconds: float
    """Of this process."""
    rows: int
    """That became final."""
    batches: int
    """That were settled."""

    @property
    def microseconds(self) -> float:
        """CPU time of a row."""
        return 1e6 * self.cpu_seconds / self.rows

    @property
    def per_batch(self) -> float:
        """CPU time of a batch [us]."""
        return 1e6 * self.cpu_seconds / self.batches


class Watch:
    """Looks at a coordinator: has stand-ins join, lets it warm up, measures a window, and ends it."""

    def __init__(self, crew: Ready, runs: list[Assignment], warm_up: float, seconds: float) -> None:
        self._crew = crew
        self._runs = runs
        self._steps = self._watch(warm_up, seconds)
        self.stop = Stop()
        self._windows: list[Window] = []
        self.join_seconds = 0.0
        self.at_join: Callable[[], object] = lambda: None
        """Called when all have joined."""
        self.at_end: Callable[[], object] = lambda: None
        """Called behind the window."""

    def look(self, now: float, service: CoordinatorService) -> None:
        self._service = service
        if next(self._steps, self) is self:
            self.stop.set(0)

    @property
    def window(self) -> Window:
        """What was measured."""
        return self._windows[-1]

    def _watch(self, warm_up: float, seconds: float) -> Iterator[None]:
        while not self._service._turn.epoch:
            yield
        began = time.monotonic()
        self._crew.join()
        while not self._crew.have_joined:
            yield
        self.join_seconds = self._crew.last_join() - began
        self.at_join()
        yield from self._wait(warm_up)
        before, began, cpu = self._count(), time.perf_counter(), time.process_time()
        yield from self._wait(seconds)
        cpu, wall, after = time.process_time() - cpu, time.perf_counter() - began, self._count()
        self._windows.append(Window(wall, cpu, after[0] - before[0], after[1] - before[1]))
        self.at_end()

    def _wait(self, seconds: float) -> Iterator[None]:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            yield

    def _count(self) -> tuple[int, int]:
        rows = sum(run.pipeline.tally.rows for run in self._runs)
        return rows, self._service._turn.dispatch.counters["fresh"]


def coordinate(
    endpoint: str,
    runs: list[Assignment],
    make_record: Callable[[ZenohBus], Callable[[Assignment], Record]],
    watch: Watch,
    batch_size: int | None,
) -> None:
    """Carry runs out until the watch has seen enough."""
    with ZenohBus.connect(endpoint, 10.0, Stop()) as bus:
        service = CoordinatorService(
            bus,
            watch.stop,
            job=JOB,
            programme=Several(runs),
            make_record=make_record(bus),
            batch_size=batch_size,
        )
        service.run(lambda now: watch.look(now, service))


@contextmanager
def router() -> Iterator[tuple[str, int]]:
    """A router in a process of its own: its endpoint and process id."""
    context, endpoint = multiprocessing.get_context("spawn"), own_endpoint()
    here, there = context.Pipe()
    process = context.Process(target=_route, args=(there, endpoint), daemon=True)
    process.start()
    try:
        there.close()
        here.recv()
        assert process.pid is not None
        yield endpoint, process.pid
    finally:
        here.close()
        process.join()


def _route(pipe: Connection, endpoint: str) -> None:
    with ZenohBus.router(endpoint):
        pipe.send(None)
        try:
            pipe.recv()
        except EOFError:
            return


def resident(pid: int | str = "self") -> int:
    """The memory that a process has now [bytes]."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmRSS"))
