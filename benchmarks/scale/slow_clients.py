"""Cost to a coordinator of subscribers that never read, and of twenty monitors, in pairs of windows."""

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from statistics import mean, median
from typing import Protocol

import numpy as np
import zenoh
from benchmarks.node_benchmark import PlatformSink
from benchmarks.scale.rig import (
    JOB,
    CoordinatorMeasurement,
    GivenRuns,
    ScaleFigure,
    StandInGroup,
    StandInProcesses,
    make_run_plan,
    resident,
    router,
    start_stand_ins,
)
from benchmarks.scale.throughput import BATCH, IN_FLIGHT, POPULATION, WARM_UP, WORKERS, ConstantSearch, spec
from tests.common import own_endpoint

from qdgrasp_coordinator.scheduler.coordinator_service import CoordinatorService
from qdgrasp_coordinator.scheduler.run_plan import RunPlan
from qdgrasp_protocol.bus import Channel
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.session import parse_endpoints, session_settings, to_json5
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.monitor.feed import Feed

PAUSE = 0.5
"""Seconds before a window."""
MOST_CPU, MOST_PUT, MOST_WAIT = 1.05, 1.5, 1.0
RESAMPLES = 10_000


class TimedBus(ZenohBus):
    """A session that notes how long each put takes [s], and how many of them are for monitors."""

    def put(self, key: str, payload: bytes, *, encoding: str, channel: Channel = Channel.DATA) -> None:
        began = time.perf_counter()
        super().put(key, payload, encoding=encoding, channel=channel)
        self.put_seconds.append(time.perf_counter() - began)
        self.monitor_keys.extend([key] if channel is Channel.MONITOR else [])

    put_seconds: list[float] = []  # noqa: RUF012 - one session, one list
    monitor_keys: list[str] = []  # noqa: RUF012


@dataclass(frozen=True)
class WindowFigures:
    """The work of the coordinator in a time window."""

    per_batch: float
    """CPU time of a batch [us]."""
    p99: float
    """99th percentile of its puts [us]."""
    longest: float
    """Longest of its puts [s]."""
    monitor_rate: float
    """Messages for monitors in a second."""
    memory: int
    """Memory of its process [bytes]."""


class Clients(Protocol):
    """Subscribers that are there in one window of each pair."""

    def connect(self) -> Iterator[None]:
        """Connect them; yields until they are there."""

    def disconnect(self) -> Iterator[None]:
        """Disconnect them; yields until they are gone."""


@dataclass(frozen=True)
class WindowPair:
    """Two windows, one after the other: without the clients and with them."""

    without_clients: WindowFigures
    with_clients: WindowFigures


class PairedMeasurement(CoordinatorMeasurement):
    """Measures pairs of windows, with and without further clients."""

    def __init__(
        self, stand_ins: StandInProcesses, runs: list[RunPlan], pairs: int, seconds: float, clients: Clients
    ) -> None:
        super().__init__(stand_ins, runs, WARM_UP, seconds)
        self._pairs = pairs
        self._clients = clients
        self.pairs: list[WindowPair] = []

    def _measure(self, warm_up: float, seconds: float) -> Iterator[None]:
        while not self._service.scheduler.epoch:
            yield
        self._stand_ins.join()
        while not self._stand_ins.have_joined:
            yield
        self._stand_ins.last_join()
        yield from self._wait(warm_up)
        for pair in range(self._pairs):
            found: dict[bool, WindowFigures] = {}
            for has_clients in (False, True) if pair % 2 == 0 else (True, False):
                found[has_clients] = yield from (
                    self._measure_with_clients(seconds) if has_clients else self._measure_window(seconds)
                )
            self.pairs.append(WindowPair(found[False], found[True]))

    def _measure_window(self, seconds: float) -> Iterator[None]:
        yield from self._wait(PAUSE)
        TimedBus.put_seconds.clear()
        TimedBus.monitor_keys.clear()
        cpu, batches = time.process_time(), self._count()[1]
        yield from self._wait(seconds)
        cpu, batches = time.process_time() - cpu, self._count()[1] - batches
        put_seconds, rate = np.array(TimedBus.put_seconds), len(TimedBus.monitor_keys) / seconds
        p99 = 1e6 * float(np.quantile(put_seconds, 0.99))
        return WindowFigures(1e6 * cpu / batches, p99, float(put_seconds.max()), rate, resident())

    def _measure_with_clients(self, seconds: float) -> Iterator[None]:
        yield from self._clients.connect()
        found = yield from self._measure_window(seconds)
        yield from self._clients.disconnect()
        return found


def measure_window_pairs(
    session: Callable[[], AbstractContextManager[TimedBus]],
    endpoint: str,
    clients: Clients,
    pairs: int,
    seconds: float,
) -> list[WindowPair]:
    """Have a coordinator hand out prepared batches, alone and with further clients.

    Parameters
    ----------
    session
        Opens the coordinator's: at a router, or as the router itself.
    """
    runs = [make_run_plan("run", spec("contact_rand", POPULATION), ConstantSearch(POPULATION), IN_FLIGHT)]
    with session() as bus, start_stand_ins([StandInGroup(endpoint, JOB, WORKERS)]) as stand_ins:
        measurement = PairedMeasurement(stand_ins, runs, pairs, seconds, clients)
        service = CoordinatorService(
            bus,
            measurement.stop,
            job=JOB,
            queue=GivenRuns(runs),
            make_sink=lambda run: PlatformSink(run.shape),
            batch_size=BATCH,
            checked=0.0,  # results of stand-ins never agree
        )
        service.run(lambda now: measurement.step(now, service))
    return measurement.pairs


def compared(pairs: list[WindowPair], who: str) -> Iterator[ScaleFigure]:
    """The coordinator's figures with further clients, over those alone."""
    cpu = [pair.with_clients.per_batch / pair.without_clients.per_batch for pair in pairs]
    put = [pair.with_clients.p99 / pair.without_clients.p99 for pair in pairs]
    batch, usual = (
        median(found)
        for found in zip(*((p.without_clients.per_batch, p.without_clients.p99) for p in pairs), strict=True)
    )
    remark = f"{_words(cpu)}; alone {batch:.0f} us"
    yield ScaleFigure(f"CPU of a batch beside {who}", median(cpu), "times", most=MOST_CPU, remark=remark)
    remark = f"{_words(put)}; alone {usual:.0f} us"
    yield ScaleFigure(f"p99 of a put beside {who}", median(put), "times", most=MOST_PUT, remark=remark)
    yield ScaleFigure(
        f"longest put beside {who}", max(pair.with_clients.longest for pair in pairs), "s", most=MOST_WAIT
    )


def _words(ratios: list[float]) -> str:
    """The bootstrap interval of the median of pairs."""
    random = np.random.default_rng(0)
    medians = np.median(random.choice(ratios, (RESAMPLES, len(ratios))), axis=1)
    low, high = np.quantile(medians, [0.025, 0.975])
    return f"median of {len(ratios)} pairs, 95 % interval {low:.3f} to {high:.3f}"


STUCK_PAIRS = 21
STUCK_WINDOW = 2.0
"""Seconds at most: a client that does not read for 4 s takes the router for dead."""
FLOOD, PIECE = 1000, 64 << 10
"""Number and bytes of messages that fill every buffer on the way to a subscriber."""


class StuckSubscriber:
    """A process that subscribes to everything, has been sent much, and reads only when it is asked to."""

    def __init__(self, endpoint: str) -> None:
        self._endpoint = endpoint
        self.lost: list[int] = []
        """Number of messages that it lost each time."""

    def connect(self) -> Iterator[None]:
        context = multiprocessing.get_context("spawn")
        self._pipe, there = context.Pipe()
        self._process = context.Process(
            target=_serve_stuck_subscriber, args=(there, self._endpoint), daemon=True
        )
        self._process.start()
        there.close()
        while not self._pipe.poll():
            yield
        self._pipe.recv()

    def disconnect(self) -> Iterator[None]:
        self._pipe.send(None)
        while not self._pipe.poll():
            yield
        self.lost.append(self._pipe.recv())
        self._process.join()


def flood(bus: ZenohBus, key: str, messages: int) -> None:
    """Send much to those who subscribe to the feeds of jobs."""
    for _ in range(messages):
        bus.put(key, bytes(PIECE), encoding="application/json", channel=Channel.MONITOR)


def _serve_stuck_subscriber(pipe: Connection, endpoint: str) -> None:
    key = Keys("other").stat("flood")
    chosen = session_settings("client", connect=parse_endpoints(endpoint), seconds=10.0)
    with (
        zenoh.open(zenoh.Config.from_json5(to_json5(chosen, "stuck"))) as session,
        ZenohBus.connect(endpoint, 10.0) as other,
    ):
        subscriber = session.declare_subscriber("qdgrasp/**", zenoh.handlers.FifoChannel(1))
        time.sleep(0.5)  # until the router knows of it
        flood(other, key, FLOOD)
        pipe.send(None)
        pipe.recv()
        heard, until = 0, time.monotonic() + 1.0
        while time.monotonic() < until:
            sample = subscriber.try_recv()
            heard += sample is not None and str(sample.key_expr) == key
        pipe.send(FLOOD - heard)


def measure_stuck_subscriber(seconds: float) -> Iterator[ScaleFigure]:
    with router() as (endpoint, _):
        clients = StuckSubscriber(endpoint)
        pairs = measure_window_pairs(
            lambda: TimedBus.connect(endpoint, 10.0, Stop()),
            endpoint,
            clients,
            STUCK_PAIRS,
            min(seconds, STUCK_WINDOW),
        )
    yield from compared(pairs, "it")
    remark = f"of {FLOOD}: it is there, and stuck"
    is_stuck = [0 < lost < FLOOD for lost in clients.lost]
    yield ScaleFigure("pairs in which it lost some", sum(is_stuck), "pairs", least=STUCK_PAIRS, remark=remark)


MONITORS = 20
MONITOR_PAIRS = 21
MONITOR_WINDOW = 1.5
"""Seconds at most: the router takes a client that is stopped for 4 s for dead."""
SETTLING = 0.7
"""Seconds in which those who are not stopped read what was sent to fill the others."""
MONITOR_NICENESS = 10
"""Niceness of monitors, so that the job's own processes connect first."""
READ_INTERVAL = 0.5
"""Seconds between two readings of the feed."""
MOST_MESSAGES = 1.1
"""Factor within which the messages of two windows differ by chance."""
EVENTS_AT_ONCE = 300
"""Messages of 64 KiB that fill all buffers between the router and a stopped monitor."""


class Monitors:
    """Processes that follow any job that is there, when they are asked to.

    Parameters
    ----------
    stopped
        How many of them are stopped while they do.
    """

    def __init__(self, processes: list[tuple[BaseProcess, Connection]], stopped: int) -> None:
        self._pipes = [pipe for _, pipe in processes]
        self._stopped = [process.pid for process, _ in processes[:stopped] if process.pid]

    def connect(self) -> Iterator[None]:
        yield from self._send_command("watch", self._pipes)
        for pid in self._stopped:
            os.kill(pid, signal.SIGSTOP)
        yield from self._send_command("flood", self._pipes[-1:])
        until = time.monotonic() + SETTLING
        while time.monotonic() < until:
            yield

    def disconnect(self) -> Iterator[None]:
        for pid in self._stopped:
            os.kill(pid, signal.SIGCONT)
        yield from self._send_command("leave", self._pipes)

    def _send_command(self, what: str, pipes: list[Connection]) -> Iterator[None]:
        """Send a command to some of them, and yield until they have carried it out."""
        for pipe in pipes:
            pipe.send(what)
        while not all(pipe.poll() for pipe in pipes):
            yield
        for pipe in pipes:
            pipe.recv()


@contextmanager
def monitors(endpoint: str, count: int = MONITORS, stopped: int = MONITORS // 2) -> Iterator[Monitors]:
    """Processes of monitors; they end with the block."""
    context, processes = multiprocessing.get_context("spawn"), []
    for _ in range(count):
        here, there = context.Pipe()
        process = context.Process(target=_serve_monitor, args=(there, endpoint), daemon=True)
        process.start()
        there.close()
        processes.append((process, here))
    try:
        for _, pipe in processes:
            pipe.recv()
        yield Monitors(processes, stopped)
    finally:
        for process, pipe in processes:
            pipe.close()
            process.join()


def _serve_monitor(pipe: Connection, endpoint: str) -> None:
    os.nice(MONITOR_NICENESS)
    pipe.send("ready")
    try:
        while pipe.recv():
            _follow_job(pipe, endpoint)
    except EOFError:
        return


def _follow_job(pipe: Connection, endpoint: str) -> None:
    with ZenohBus.connect(endpoint, 10.0) as bus, Feed(bus) as feed:
        while not any(view.workers for view in feed.views()):
            feed.wait(READ_INTERVAL)
        pipe.send("there")
        while (command := _next_command(pipe, feed)) != "leave":
            flood(bus, Keys(JOB).event(command), EVENTS_AT_ONCE)
            pipe.send("flooded")
    pipe.send("gone")


def _next_command(pipe: Connection, feed: Feed) -> str:
    """Read the feed now and then, until the next command comes."""
    while not pipe.poll(READ_INTERVAL):
        feed.views()
    return str(pipe.recv())


def measure_monitors(seconds: float) -> Iterator[ScaleFigure]:
    with router() as (endpoint, _):
        yield from _measure_monitors(
            lambda: TimedBus.connect(endpoint, 10.0, Stop()), endpoint, seconds, "a router beside it"
        )
    endpoint = own_endpoint()
    yield from _measure_monitors(lambda: TimedBus.router(endpoint), endpoint, seconds, "the router within it")


def _measure_monitors(
    open_session: Callable[[], TimedBus], endpoint: str, seconds: float, where: str
) -> Iterator[ScaleFigure]:
    with monitors(endpoint) as clients:
        pairs = measure_window_pairs(
            open_session, endpoint, clients, MONITOR_PAIRS, min(seconds, MONITOR_WINDOW)
        )
    yield from compared(pairs, f"{MONITORS} monitors, {where}")
    monitored = mean(pair.with_clients.monitor_rate for pair in pairs)
    usual = mean(pair.without_clients.monitor_rate for pair in pairs)
    remark = f"alone {usual:.1f} /s"
    yield ScaleFigure(
        f"messages for monitors, {where}", monitored / usual, "times", most=MOST_MESSAGES, remark=remark
    )
    grown = median(
        (pair.with_clients.memory - pair.without_clients.memory) / MONITORS / 1024 for pair in pairs
    )
    yield ScaleFigure(f"memory for a monitor, {where}", grown, "KiB", remark="of the coordinator's process")
