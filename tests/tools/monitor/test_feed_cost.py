"""Cost of monitors to a coordinator, with any number of them, and with one that is stopped."""

import gc
import multiprocessing
import os
import resource
import signal
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from unittest.mock import patch

from tests.common import PATIENCE, own_endpoint, wait_for
from tests.coordinator.scheduler.search_plans import SHAPE, Plan
from tests.fakes.job import PLANS, FakeRunQueue, Job, scheduler_of
from tests.fakes.messages import ANN, join_message
from tests.fakes.recorder import JOB
from tests.fakes.worker import FakeWorker

from qdgrasp_coordinator.scheduler.inbox import JoinRequest
from qdgrasp_coordinator.scheduler.recorder_client import MemorySink
from qdgrasp_coordinator.scheduler.run_registry import ActiveRun
from qdgrasp_coordinator.scheduler.status_publisher import StatusPublisher
from qdgrasp_protocol import session
from qdgrasp_protocol.bus import Bus, Channel, Query
from qdgrasp_protocol.errors import BusError
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.memory_bus import MemoryBus, MemoryNetwork
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.monitor.feed import SUBSCRIBED_KEYS, Feed

WORKERS = 70
"""More than stand on one page."""
OWN = tracemalloc.Filter(True, "*/qdgrasp_coordinator/scheduler/*")


class Counted(MemoryBus):
    """A session that notes each put."""

    def __init__(self, network: MemoryNetwork) -> None:
        super().__init__(network)
        self.keys: list[str] = []
        self.channels: set[Channel] = set()

    def put(self, key: str, payload: bytes, *, encoding: str, channel: Channel = Channel.DATA) -> None:
        self.keys.append(key)
        self.channels.add(channel)
        super().put(key, payload, encoding=encoding, channel=channel)


class Coordinator:
    """The status of three runs and many workers; the caller decides when it is published."""

    def __init__(self, network: MemoryNetwork) -> None:
        self.bus = Counted(network)
        self.now = 1.0 + int(time.monotonic())  # its runs were opened before that
        programme = FakeRunQueue(dict(PLANS))
        self.scheduler = scheduler_of(programme, lambda event: self.publisher.publish_event(event))
        self.publisher = StatusPublisher(self.bus, self.scheduler, lambda: self.now)
        for _ in range(3):
            plan = programme.next()
            assert plan is not None
            run = ActiveRun(plan, MemorySink(SHAPE))
            run.open(1, lambda: None)
            self.scheduler.runs.add(run)
        for number in range(WORKERS):
            self.scheduler.handle(JoinRequest(join_message(f"{number:032x}")), self.now)

    @contextmanager
    def open(self) -> Iterator[None]:
        keys = Keys(JOB)
        self.publisher.open(self.now)
        with ExitStack() as stack:
            for shown in (keys.stat(), keys.meta, keys.recent):
                stack.enter_context(self.bus.answer_values(shown, self.publisher.cache.answer))
            stack.enter_context(self.bus.token(keys.coordinator_token(1)))
            yield

    def show(self) -> None:
        """Publish progress and events for twenty seconds."""
        for quarter in range(80):
            self.publisher.publish_due(self.now + quarter / 4)
            if quarter % 20 == 0:
                self.scheduler.events.note("worker", "A worker has joined.")


@contextmanager
def watching(network: MemoryNetwork, monitors: int) -> Iterator[None]:
    """Some monitors that read, and as many that are stopped, whose rings are not read."""
    with ExitStack() as stack:
        for _ in range(monitors):
            stopped = network.session()
            for what, capacity in SUBSCRIBED_KEYS.items():
                stack.enter_context(stopped.ring(f"{Keys(JOB).root}/{what}", capacity))
            feed = stack.enter_context(Feed(network.session()))
            wait_for(lambda feed=feed: any(len(view.workers) == WORKERS for view in feed.views()))
        yield


def sent(monitors: int) -> list[str]:
    network = MemoryNetwork()
    coordinator = Coordinator(network)
    with coordinator.open(), watching(network, monitors):
        coordinator.show()
    return coordinator.bus.keys


def kept(monitors: int) -> int:
    """The memory that the coordinator's own modules hold after that [bytes]."""
    network = MemoryNetwork()
    tracemalloc.start()
    try:
        coordinator = Coordinator(network)
        with coordinator.open(), watching(network, monitors):
            coordinator.show()
            gc.collect()
            found = tracemalloc.take_snapshot().filter_traces([OWN]).statistics("filename")
    finally:
        tracemalloc.stop()
    return sum(each.size for each in found)


def test_a_coordinator_sends_the_same_to_nobody_and_to_twenty() -> None:
    alone = sent(0)
    assert len(alone) > 200
    assert sent(10) == alone


def test_what_a_coordinator_keeps_does_not_grow_with_those_who_watch() -> None:
    kept(1)  # what is remembered of the first time
    assert kept(10) <= kept(0) + 4096


def test_all_that_is_shown_is_dropped_before_anybody_waits() -> None:
    coordinator = Coordinator(MemoryNetwork())
    with coordinator.open():
        coordinator.publisher.publish_meta("mine")
        coordinator.show()
    assert coordinator.bus.channels == {Channel.MONITOR}


KEYS = Keys(JOB)
FLOOD, LAST = KEYS.event("flood"), KEYS.event("last")
HEAVY = f"{KEYS.root}/heavy/*"
PIECE, PIECES = 64 << 10, 2000
"""Much more than lies in any buffer between a router and a monitor."""
MOST_GROWN = PIECE * PIECES // 4
ASKERS, ANSWERS = 4, 64
ROWS = 200
PATIENT = patch.dict(session.BASE_SETTINGS, {"transport/link/tx/lease": 60_000})
"""On a slow machine too, no process that is stopped meanwhile is taken for dead."""


class Routed:
    """Sessions at a router; the first of them is that router."""

    def __init__(self) -> None:
        self.endpoint = own_endpoint()
        self._is_there = False

    def session(self) -> Bus:
        if self._is_there:
            return ZenohBus.connect(self.endpoint, PATIENCE)
        self._is_there = True
        return ZenohBus.router(self.endpoint)


def monitor(pipe: Connection, endpoint: str) -> None:
    """Watch, and query all the time; report lost links and received messages at the end."""
    lost, heard, is_over = [], [], threading.Event()
    with PATIENT, ZenohBus.connect(endpoint, PATIENCE) as bus, ExitStack() as stack:
        bus.on_link(lambda up: None if up else lost.append(up))
        bus.subscribe(FLOOD, lambda _: heard.append(1))
        bus.subscribe(LAST, lambda _: is_over.set())
        feed = stack.enter_context(Feed(bus))
        for _ in range(ASKERS):
            threading.Thread(target=ask, args=(bus, is_over), daemon=True).start()
        wait_for(lambda: any(view.workers for view in feed.views()))
        pipe.send("there")
        is_over.wait()
        pipe.send((len(lost), len(heard)))
        pipe.recv()


def ask(bus: Bus, is_over: threading.Event) -> None:
    while not is_over.is_set():
        try:
            bus.ask_all(KEYS.stat())
        except BusError:
            return


def asker(pipe: Connection, endpoint: str) -> None:
    """Ask for more than lies in any buffer."""
    with PATIENT, ZenohBus.connect(endpoint, PATIENCE) as bus:
        pipe.send("there")
        bus.ask_all(HEAVY, timeout=PATIENCE)


@contextmanager
def running(what: Callable[[Connection, str], None], endpoint: str) -> Iterator[tuple[int, Connection]]:
    """A process that does this, and a pipe to it."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=what, args=(there, endpoint), daemon=True)
    process.start()
    assert process.pid is not None
    try:
        yield process.pid, here
    finally:
        process.kill()
        process.join()


def memory() -> int:
    """Memory of this process [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


@PATIENT
def test_a_monitor_that_is_stopped_keeps_nobody_waiting_and_takes_no_memory() -> None:
    network = Routed()
    job = Job({"run-0": Plan(population=50, evaluations=10**6)}, network=network)
    with (
        job.serving(),
        job.network.session() as worker,
        FakeWorker(worker, ANN).at_work() as pretender,
        running(monitor, network.endpoint) as (pid, pipe),
    ):
        assert pipe.recv() == "there"
        os.kill(pid, signal.SIGSTOP)
        before = memory()
        for _ in range(PIECES):
            job.bus.put(FLOOD, bytes(PIECE), encoding="application/json", channel=Channel.MONITOR)
        grown, rows = memory() - before, pretender.rows
        wait_for(lambda: pretender.rows > rows + ROWS)
        os.kill(pid, signal.SIGCONT)
        while not pipe.poll(0.05):
            job.bus.put(LAST, b"", encoding="application/json", channel=Channel.MONITOR)
        lost, heard = pipe.recv()
    assert grown < MOST_GROWN
    assert lost == 0, "whoever is waited for is cut off after a while"
    assert heard < PIECES, "there was room for all that it did not read"


@PATIENT
def test_answers_that_a_stopped_monitor_does_not_take_hold_nobody_up() -> None:
    network, is_asked, may_answer = Routed(), threading.Event(), threading.Event()
    job = Job({"run-0": Plan(population=50, evaluations=10**6)}, network=network)

    def answers(_query: Query) -> dict[str, bytes]:
        is_asked.set()
        may_answer.wait()
        return {f"{KEYS.root}/heavy/{number}": bytes(1 << 20) for number in range(ANSWERS)}

    with (
        job.serving(),
        job.bus.answer_values(HEAVY, answers),
        job.network.session() as worker,
        FakeWorker(worker, ANN).at_work() as pretender,
        job.network.session() as other,
        running(asker, network.endpoint) as (pid, _),
    ):
        is_asked.wait()
        os.kill(pid, signal.SIGSTOP)
        rows = pretender.rows
        may_answer.set()
        wait_for(lambda: pretender.rows > rows + ROWS)
        wait_for(lambda: KEYS.stat("job") in other.ask_all(KEYS.stat()))
