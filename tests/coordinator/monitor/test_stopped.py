"""A monitor that was stopped costs a job nothing: over the real bus, with a flood for whoever watches."""

import multiprocessing
import os
import resource
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from unittest.mock import patch

from tests.coordinator.recording.recorded import JOB
from tests.coordinator.runs.plans import Plan
from tests.coordinator.serving.served import Job, Pretender, until
from tests.endpoints import own_endpoint
from tests.patience import PATIENCE

from qdgrasp_coordinator.monitor.feed import Feed
from qdgrasp_protocol import session
from qdgrasp_protocol.bus import Bus, Channel, Query
from qdgrasp_protocol.errors import BusError
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.zenoh_bus import ZenohBus

KEYS = Keys(JOB)
FLOOD, LAST = KEYS.event("flood"), KEYS.event("last")
HEAVY = f"{KEYS.root}/heavy/*"
PIECE, PIECES = 64 << 10, 2000
"""Much more than lies in any buffer between a router and a monitor."""
MOST_GROWN = PIECE * PIECES // 4
ASKERS, ANSWERS = 4, 64
ROWS = 200
PATIENT = patch.dict(session.SETTINGS, {"transport/link/tx/lease": 60_000})
"""However slow this machine is, nobody who stands still meanwhile is taken for dead."""


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
    """Watch, and ask all the time; say at the end how often the link was lost, and what came of the flood."""
    lost, heard, is_over = [], [], threading.Event()
    with PATIENT, ZenohBus.connect(endpoint, PATIENCE) as bus, ExitStack() as stack:
        bus.on_link(lambda up: None if up else lost.append(up))
        bus.subscribe(FLOOD, lambda _: heard.append(1))
        bus.subscribe(LAST, lambda _: is_over.set())
        feed = stack.enter_context(Feed(bus))
        for _ in range(ASKERS):
            threading.Thread(target=ask, args=(bus, is_over), daemon=True).start()
        until(lambda: any(view.workers for view in feed.views()))
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
    """What this process has of it [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


@PATIENT
def test_a_monitor_that_is_stopped_keeps_nobody_waiting_and_takes_no_memory() -> None:
    network = Routed()
    job = Job({"run-0": Plan(population=50, evaluations=10**6)}, network=network)
    with (
        job.serving(),
        job.network.session() as worker,
        Pretender(worker, "a" * 32).at_work() as pretender,
        running(monitor, network.endpoint) as (pid, pipe),
    ):
        assert pipe.recv() == "there"
        os.kill(pid, signal.SIGSTOP)
        before = memory()
        for _ in range(PIECES):
            job.bus.put(FLOOD, bytes(PIECE), encoding="application/json", channel=Channel.MONITOR)
        grown, rows = memory() - before, pretender.rows
        until(lambda: pretender.rows > rows + ROWS)
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
        job.bus.show(HEAVY, answers),
        job.network.session() as worker,
        Pretender(worker, "a" * 32).at_work() as pretender,
        job.network.session() as other,
        running(asker, network.endpoint) as (pid, _),
    ):
        is_asked.wait()
        os.kill(pid, signal.SIGSTOP)
        rows = pretender.rows
        may_answer.set()
        until(lambda: pretender.rows > rows + ROWS)
        until(lambda: KEYS.stat("job") in other.ask_all(KEYS.stat()))
