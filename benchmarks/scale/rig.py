"""A router in a process of its own, workers with prepared results in others, the coordinator in this one."""

import heapq
import multiprocessing
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from itertools import cycle
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
from benchmarks.measure import number
from rich.table import Table
from tests.common import own_endpoint

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.scheduler.coordinator_service import CoordinatorService
from qdgrasp_coordinator.scheduler.pipeline import Flight, Pipeline
from qdgrasp_coordinator.scheduler.recorder_client import RowSink
from qdgrasp_coordinator.scheduler.run_plan import JobExtent, RunPlan, RunQueue
from qdgrasp_coordinator.search.base import SearchAlgorithm
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.errors import BusError, NoReply
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import VERSION, Join, Joined, Result, Work, deflated, worker_id
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.rows import RESULT, Outcome, Rows, RowShape, pack
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.zenoh_bus import ZenohBus


@dataclass(frozen=True)
class ScaleFigure:
    """A measured number and its bounds."""

    name: str
    value: float
    unit: str
    least: float | None = None
    most: float | None = None
    remark: str = ""

    @property
    def is_met(self) -> bool | None:
        """Whether it is within its bounds; None: it has none."""
        if self.least is None and self.most is None:
            return None
        return (self.least or -float("inf")) <= self.value <= (self.most or float("inf"))

    @property
    def wanted(self) -> str:
        if self.least is not None:
            return f"at least {number(self.least)}"
        return "" if self.most is None else f"at most {number(self.most)}"

    def as_dict(self) -> dict[str, Any]:
        return {**vars(self), "is_met": self.is_met}


def table(name: str, figures: Sequence[ScaleFigure]) -> Table:
    """A part for a terminal."""
    shown = Table("what", "figure", "wanted", "", "remark", title=name, title_justify="left")
    for figure in figures:
        met = {None: "", True: "yes", False: "NO"}[figure.is_met]
        shown.add_row(figure.name, f"{number(figure.value)} {figure.unit}", figure.wanted, met, figure.remark)
    return shown


SHAPE = RowShape(genes=7, joints=2)
"""The rows of a two-finger hand."""
REACH = 0.15
"""Hands are anywhere in a cube of twice that [m]."""
VARIETY = 64
"""Different results for batches of one length."""
_PLACEHOLDERS = {"run": "@" * 31, "generation": 2**62 + 1, "batch": b"\xa5" * 16, "attempt": 2**62 + 3}
"""Placeholders in a result for a batch's own values."""


def rows(n: int, random: np.random.Generator, shape: RowShape = SHAPE) -> Rows:
    """Results as of random poses: three of five overlap, one of seven succeeds."""
    found = shape.empty(n)
    found["outcome"] = random.choice([Outcome.OVERLAP, Outcome.MISSED, Outcome.HELD], n, p=[0.6, 0.25, 0.15])
    found["fitness"] = np.maximum(found["outcome"].astype(int) - Outcome.DROPPED, 0)
    found["proposals"] = 1
    for column in ("descriptor", "base_to_object", "joints", "surface_point"):
        found[column] = random.uniform(-REACH, REACH, found[column].shape)
    return found


class PreparedResults:
    """The prepared results of one worker to batches of one length.

    Parameters
    ----------
    number
        The worker's: each has results of its own.
    seconds
        Reported cost of a batch [CPU s].
    key
        The worker's own.
    """

    def __init__(
        self,
        number: int,
        wid: str,
        epoch: int,
        n: int,
        seconds: float,
        shape: RowShape = SHAPE,
        variety: int = VARIETY,
        *,
        key: bytes,
    ) -> None:
        random = np.random.default_rng((number, n))
        self._pieces: Iterator[list[bytes]] = cycle(
            [_split(_result(wid, epoch, rows(n, random, shape), seconds, shape, key)) for _ in range(variety)]
        )

    def next_for(self, run: str, generation: int, batch: bytes, attempt: int) -> bytes:
        """The next result, for a batch."""
        pieces = next(self._pieces)
        own = (msgpack.packb(run), msgpack.packb(generation), batch, msgpack.packb(attempt), b"")
        return b"".join(part for pair in zip(pieces, own, strict=True) for part in pair)


def _result(wid: str, epoch: int, found: Rows, seconds: float, shape: RowShape, key: bytes) -> bytes:
    return messages.encode(
        Result(
            epoch=epoch,
            wid=wid,
            key=key,
            n=len(found),
            joints=shape.joints,
            descriptors=shape.descriptors,
            contact_slots=shape.contact_slots,
            columns=deflated(pack(found, RESULT)),
            cpu_seconds=seconds,
            **_PLACEHOLDERS,
        )
    )


def _split(payload: bytes) -> list[bytes]:
    """The pieces of a result before, between and after its placeholders."""
    pieces = []
    for placeholder in _PLACEHOLDERS.values():
        packed = placeholder if isinstance(placeholder, bytes) else msgpack.packb(placeholder)
        before, found, payload = payload.partition(packed)
        assert found
        pieces.append(before)
    return [*pieces, payload]


PLATFORM = {"stand-in": "1"}
SESSIONS_AT_ONCE = 16
"""Sessions that a process opens at once."""
PATIENCE = 30.0
"""Seconds until the router must answer."""


@dataclass(frozen=True)
class StandInGroup:
    """A number of stand-ins for workers of a job."""

    endpoint: str
    job: str
    workers: int
    credit: int = 2
    seconds: float = 0.0
    """Time that one of them takes for a batch [s]; 0: none."""
    row_seconds: float = 0.0
    """Reported cost of a row in addition [CPU s]."""
    sleeps: bool = False
    """True: a row also takes that time."""
    shape: RowShape = SHAPE
    variety: int = VARIETY


class StandInWorker:
    """A stand-in for one worker: a session that answers with prepared results.

    Parameters
    ----------
    later
        Calls a function at a time.
    """

    def __init__(
        self, number: int, group: StandInGroup, later: Callable[[float, Callable[[], None]], None]
    ) -> None:
        self._number = number
        self._key = secrets.token_bytes(32)
        self.wid = worker_id(self._key)
        self._group = group
        self._later = later
        self._keys = Keys(group.job)
        self._stack = ExitStack()
        self._results: dict[tuple[int, int], PreparedResults] = {}
        self._free_at = 0.0

    def join(self) -> float:
        """Start and join; returns the time of the answer."""
        self._bus = self._stack.enter_context(ZenohBus.connect(self._group.endpoint, PATIENCE, Stop()))
        self._stack.enter_context(self._bus.subscribe(self._keys.work(self.wid), self._take))
        self._stack.enter_context(self._bus.token(self._keys.worker_token(self.wid)))
        self._ask()
        return time.monotonic()

    def close(self) -> None:
        self._stack.close()

    def _ask(self) -> None:
        request = Join(
            versions=[VERSION],
            wid=self.wid,
            key=self._key,
            number=1,
            credit=self._group.credit,
            held=[],
            host="here",
            pid=1,
            platform=PLATFORM,
        )
        while True:
            try:
                messages.decode(
                    self._bus.ask(self._keys.join, messages.encode(request), timeout=10.0), Joined
                )
            except NoReply:
                time.sleep(0.05)
            else:
                return

    def _take(self, sample: Sample) -> None:
        if sample.encoding != messages.encoding(Work):
            return
        seconds = self._group.seconds
        if self._group.sleeps:
            seconds += self._group.row_seconds * int(msgpack.unpackb(sample.payload)["n"])
        if not seconds:
            self._answer(sample.payload)
            return
        self._free_at = max(self._free_at, time.monotonic()) + seconds
        self._later(self._free_at, lambda: self._answer(sample.payload))

    def _answer(self, payload: bytes) -> None:
        work = msgpack.unpackb(payload)
        group, kind = self._group, (work["epoch"], work["n"])
        if kind not in self._results:
            cost = group.seconds + group.row_seconds * work["n"]
            place = (self._number, self.wid, *kind, cost, group.shape, group.variety)
            self._results[kind] = PreparedResults(*place, key=self._key)
        batch = (work["run"], work["generation"], work["batch"], work["attempt"])
        answer = self._results[kind].next_for(*batch)
        with suppress(BusError):  # the session is closed: no process waits for it
            self._bus.put(self._keys.result(self.wid), answer, encoding=messages.encoding(Result))


class CallTimer:
    """Calls functions at given times, in a thread."""

    def __init__(self) -> None:
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._news = threading.Condition()
        self._count = 0
        threading.Thread(target=self._run, daemon=True).start()

    def later(self, at: float, act: Callable[[], None]) -> None:
        with self._news:
            self._count += 1
            heapq.heappush(self._due, (at, self._count, act))
            self._news.notify()

    def _run(self) -> None:
        while True:
            self._next()()

    def _next(self) -> Callable[[], None]:
        with self._news:
            while not self._due or self._due[0][0] > time.monotonic():
                self._news.wait(self._due[0][0] - time.monotonic() if self._due else None)
            return heapq.heappop(self._due)[-1]


@contextmanager
def start_stand_ins(parts: list[StandInGroup]) -> Iterator["StandInProcesses"]:
    """Start a process for each group, which joins when asked to; they end with the block."""
    context = multiprocessing.get_context("spawn")
    with ExitStack() as stack:
        pipes = []
        for part in parts:
            here, there = context.Pipe()
            process = context.Process(target=_serve, args=(there, part), daemon=True)
            process.start()
            there.close()
            stack.callback(process.join)
            stack.callback(here.send, None)
            pipes.append(here)
        for pipe in pipes:
            pipe.recv()
        yield StandInProcesses(pipes)


class StandInProcesses:
    """Started processes of stand-ins."""

    def __init__(self, pipes: list[Connection]) -> None:
        self._pipes = pipes

    def join(self) -> None:
        """Have all of them join."""
        for pipe in self._pipes:
            pipe.send("join")

    @property
    def have_joined(self) -> bool:
        return all(pipe.poll() for pipe in self._pipes)

    def last_join(self) -> float:
        """Time at which the last of them had its answer, by `time.monotonic`."""
        return max(pipe.recv() for pipe in self._pipes)


def _serve(pipe: Connection, group: StandInGroup) -> None:
    timer = CallTimer()
    workers = [StandInWorker(number, group, timer.later) for number in range(group.workers)]
    pipe.send(None)
    if pipe.recv() is None:
        return
    with ThreadPoolExecutor(SESSIONS_AT_ONCE) as pool:
        pipe.send(max(pool.map(StandInWorker.join, workers)))
        pipe.recv()
        list(pool.map(StandInWorker.close, workers))


JOB = "scale"
ENDLESS = 10**9
SCENE = Bundle(b"", "0" * 64)


def make_run_plan(run: str, spec: RunSpec, search: SearchAlgorithm, in_flight: int = 1) -> RunPlan:
    """A run that goes on for ever."""
    pipeline = Pipeline(search, SHAPE, spec.evaluations, "count", Flight(in_flight))
    return RunPlan(run, spec, SCENE, "contact", SHAPE, pipeline)


class GivenRuns(RunQueue):
    """A queue of given runs, which keep their state when they are put back."""

    def __init__(self, runs: list[RunPlan]) -> None:
        self.extent = JobExtent.of({run.run: run.spec.evaluations for run in runs})
        self._runs = {run.run: run for run in runs}
        self._left = list(runs)

    def next(self) -> RunPlan | None:
        return self._left.pop(0) if self._left else None

    def put_back(self, run: str) -> None:
        self._left.insert(0, self._runs[run])


@dataclass(frozen=True)
class Window:
    """The work of the coordinator in a time window."""

    seconds: float
    cpu_seconds: float
    """CPU time of this process."""
    rows: int
    """Rows that became final."""
    batches: int
    """Batches that were settled."""

    @property
    def microseconds(self) -> float:
        """CPU time of a row."""
        return 1e6 * self.cpu_seconds / self.rows

    @property
    def per_batch(self) -> float:
        """CPU time of a batch [us]."""
        return 1e6 * self.cpu_seconds / self.batches


class CoordinatorMeasurement:
    """Measures a coordinator: has stand-ins join, lets it warm up, measures a window, and ends it."""

    def __init__(
        self, stand_ins: StandInProcesses, runs: list[RunPlan], warm_up: float, seconds: float
    ) -> None:
        self._stand_ins = stand_ins
        self._runs = runs
        self._steps = self._measure(warm_up, seconds)
        self.stop = Stop()
        self._windows: list[Window] = []
        self.join_seconds = 0.0
        self.at_join: Callable[[], object] = lambda: None
        """Called when all have joined."""
        self.at_end: Callable[[], object] = lambda: None
        """Called after the window."""

    def step(self, now: float, service: CoordinatorService) -> None:
        self._service = service
        if next(self._steps, self) is self:
            self.stop.set(0)

    @property
    def window(self) -> Window:
        """The last window that was measured."""
        return self._windows[-1]

    def _measure(self, warm_up: float, seconds: float) -> Iterator[None]:
        while not self._service.scheduler.epoch:
            yield
        began = time.monotonic()
        self._stand_ins.join()
        while not self._stand_ins.have_joined:
            yield
        self.join_seconds = self._stand_ins.last_join() - began
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
        return rows, self._service.scheduler.dispatcher.counters["fresh"]


def coordinate(
    endpoint: str,
    runs: list[RunPlan],
    make_sinks: Callable[[ZenohBus], Callable[[RunPlan], RowSink]],
    measurement: CoordinatorMeasurement,
    batch_size: int | None,
) -> None:
    """Carry runs out until the measurement is complete."""
    with ZenohBus.connect(endpoint, 10.0, Stop()) as bus:
        service = CoordinatorService(
            bus,
            measurement.stop,
            job=JOB,
            queue=GivenRuns(runs),
            make_sink=make_sinks(bus),
            batch_size=batch_size,
            checked=0.0,  # results of stand-ins never agree
        )
        service.run(lambda now: measurement.step(now, service))


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
