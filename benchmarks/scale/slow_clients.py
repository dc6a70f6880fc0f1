"""Cost to a coordinator of subscribers that never read, and of twenty monitors, in pairs."""

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
from benchmarks.scale.rig import (
    JOB,
    Crowd,
    Ready,
    ScaleFigure,
    Several,
    Watch,
    assignment,
    crowds,
    resident,
    router,
)
from benchmarks.scale.throughput import BATCH, IN_FLIGHT, POPULATION, WARM_UP, WORKERS, Prepared, spec
from tests.common import own_endpoint

from qdgrasp_coordinator.local.node_benchmark import PlatformSink
from qdgrasp_coordinator.monitor.feed import Feed
from qdgrasp_coordinator.scheduler.coordinator_service import CoordinatorService
from qdgrasp_coordinator.scheduler.run_plan import RunPlan
from qdgrasp_protocol.bus import Channel
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.session import parse_endpoints, session_settings, to_json5
from qdgrasp_protocol.zenoh_bus import ZenohBus

PAUSE = 0.5
"""Seconds before a window."""
MOST_CPU, MOST_PUT, MOST_WAIT = 1.05, 1.5, 1.0
RESAMPLES = 10_000


class Timed(ZenohBus):
    """A session that notes how long each put takes [s], and how many of them are for monitors."""

    def put(self, key: str, payload: bytes, *, encoding: str, channel: Channel = Channel.DATA) -> None:
        began = time.perf_counter()
        super().put(key, payload, encoding=encoding, channel=channel)
        self.took.append(time.perf_counter() - began)
        self.shown.extend([key] if channel is Channel.MONITOR else [])

    took: list[float] = []  # noqa: RUF012 - one session, one list
    shown: list[str] = []  # noqa: RUF012


@dataclass(frozen=True)
class Stretch:
    """The work of the coordinator in a time window."""

    per_batch: float
    """CPU time of a batch [us]."""
    p99: float
    """99th percentile of its puts [us]."""
    longest: float
    """Longest of its puts [s]."""
    shown: float
    """Messages for monitors in a second."""
    memory: int
    """Memory of its process [bytes]."""


class Company(Protocol):
    """Subscribers that are there in one window of each pair."""

    def come(self) -> Iterator[None]:
        """Yields until they are there."""

    def leave(self) -> Iterator[None]:
        """Yields until they are gone."""


@dataclass(frozen=True)
class Pair:
    """Two windows beside each other."""

    alone: Stretch
    beside: Stretch


class Turns(Watch):
    """Measures pairs of windows, with and without company."""

    def __init__(
        self, crew: Ready, runs: list[RunPlan], pairs: int, seconds: float, company: Company
    ) -> None:
        super().__init__(crew, runs, WARM_UP, seconds)
        self._pairs = pairs
        self._company = company
        self.pairs: list[Pair] = []

    def _watch(self, warm_up: float, seconds: float) -> Iterator[None]:
        while not self._service.scheduler.epoch:
            yield
        self._crew.join()
        while not self._crew.have_joined:
            yield
        self._crew.last_join()
        yield from self._wait(warm_up)
        for pair in range(self._pairs):
            found: dict[bool, Stretch] = {}
            for is_beside in (False, True) if pair % 2 == 0 else (True, False):
                found[is_beside] = yield from (self._beside(seconds) if is_beside else self._alone(seconds))
            self.pairs.append(Pair(found[False], found[True]))

    def _alone(self, seconds: float) -> Iterator[None]:
        yield from self._wait(PAUSE)
        Timed.took.clear()
        Timed.shown.clear()
        cpu, batches = time.process_time(), self._count()[1]
        yield from self._wait(seconds)
        cpu, batches = time.process_time() - cpu, self._count()[1] - batches
        took, shown = np.array(Timed.took), len(Timed.shown) / seconds
        p99 = 1e6 * float(np.quantile(took, 0.99))
        return Stretch(1e6 * cpu / batches, p99, float(took.max()), shown, resident())

    def _beside(self, seconds: float) -> Iterator[None]:
        yield from self._company.come()
        found = yield from self._alone(seconds)
        yield from self._company.leave()
        return found


def take_turns(
    session: Callable[[], AbstractContextManager[Timed]],
    endpoint: str,
    company: Company,
    pairs: int,
    seconds: float,
) -> list[Pair]:
    """Have a coordinator hand out prepared batches, alone and beside company.

    Parameters
    ----------
    session
        Opens the coordinator's: at a router, or as the router itself.
    """
    runs = [assignment("run", spec("contact_rand", POPULATION), Prepared(POPULATION), IN_FLIGHT)]
    with session() as bus, crowds([Crowd(endpoint, JOB, WORKERS)]) as crew:
        turns = Turns(crew, runs, pairs, seconds, company)
        service = CoordinatorService(
            bus,
            turns.stop,
            job=JOB,
            queue=Several(runs),
            make_sink=lambda run: PlatformSink(run.shape),
            batch_size=BATCH,
            checked=0.0,  # results of stand-ins never agree
        )
        service.run(lambda now: turns.look(now, service))
    return turns.pairs


def compared(pairs: list[Pair], who: str) -> Iterator[ScaleFigure]:
    """The coordinator's figures beside company, over those alone."""
    cpu = [pair.beside.per_batch / pair.alone.per_batch for pair in pairs]
    put = [pair.beside.p99 / pair.alone.p99 for pair in pairs]
    batch, usual = (
        median(found) for found in zip(*((p.alone.per_batch, p.alone.p99) for p in pairs), strict=True)
    )
    remark = f"{_words(cpu)}; alone {batch:.0f} us"
    yield ScaleFigure(f"CPU of a batch beside {who}", median(cpu), "times", most=MOST_CPU, remark=remark)
    remark = f"{_words(put)}; alone {usual:.0f} us"
    yield ScaleFigure(f"p99 of a put beside {who}", median(put), "times", most=MOST_PUT, remark=remark)
    yield ScaleFigure(
        f"longest put beside {who}", max(pair.beside.longest for pair in pairs), "s", most=MOST_WAIT
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


class Stuck:
    """A process that subscribes to everything, has been sent much, and does not read before it is told to."""

    def __init__(self, endpoint: str) -> None:
        self._endpoint = endpoint
        self.lost: list[int] = []
        """Number of messages that it lost each time."""

    def come(self) -> Iterator[None]:
        context = multiprocessing.get_context("spawn")
        self._pipe, there = context.Pipe()
        self._process = context.Process(target=_be_stuck, args=(there, self._endpoint), daemon=True)
        self._process.start()
        there.close()
        while not self._pipe.poll():
            yield
        self._pipe.recv()

    def leave(self) -> Iterator[None]:
        self._pipe.send(None)
        while not self._pipe.poll():
            yield
        self.lost.append(self._pipe.recv())
        self._process.join()


def flood(bus: ZenohBus, key: str, messages: int) -> None:
    """Send much to those who subscribe to the feeds of jobs."""
    for _ in range(messages):
        bus.put(key, bytes(PIECE), encoding="application/json", channel=Channel.MONITOR)


def _be_stuck(pipe: Connection, endpoint: str) -> None:
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
        company = Stuck(endpoint)
        pairs = take_turns(
            lambda: Timed.connect(endpoint, 10.0, Stop()),
            endpoint,
            company,
            STUCK_PAIRS,
            min(seconds, STUCK_WINDOW),
        )
    yield from compared(pairs, "it")
    remark = f"of {FLOOD}: it is there, and stuck"
    is_stuck = [0 < lost < FLOOD for lost in company.lost]
    yield ScaleFigure("pairs in which it lost some", sum(is_stuck), "pairs", least=STUCK_PAIRS, remark=remark)


MONITORS = 20
MONITOR_PAIRS = 21
MONITOR_WINDOW = 1.5
"""Seconds at most: the router takes a client that is stopped for 4 s for dead."""
SETTLING = 0.7
"""Seconds in which those who are not stopped read what was sent to fill the others."""
BEHIND = 10
"""Niceness of monitors, so that the job's own processes come first."""
LOOK = 0.5
"""Seconds between two looks."""
MOST_MORE = 1.1
"""Factor within which the messages of two windows differ by chance."""
FLOOD = 300
"""Messages of 64 KiB that fill all buffers between the router and a stopped monitor."""


class Monitors:
    """Processes that watch any job that is there, when they are told to.

    Parameters
    ----------
    stopped
        How many of them are stopped while they do.
    """

    def __init__(self, crew: list[tuple[BaseProcess, Connection]], stopped: int) -> None:
        self._pipes = [pipe for _, pipe in crew]
        self._stopped = [process.pid for process, _ in crew[:stopped] if process.pid]

    def come(self) -> Iterator[None]:
        yield from self._tell("watch", self._pipes)
        for pid in self._stopped:
            os.kill(pid, signal.SIGSTOP)
        yield from self._tell("flood", self._pipes[-1:])
        until = time.monotonic() + SETTLING
        while time.monotonic() < until:
            yield

    def leave(self) -> Iterator[None]:
        for pid in self._stopped:
            os.kill(pid, signal.SIGCONT)
        yield from self._tell("leave", self._pipes)

    def _tell(self, what: str, pipes: list[Connection]) -> Iterator[None]:
        """Tell some of them, and yield until they have done it."""
        for pipe in pipes:
            pipe.send(what)
        while not all(pipe.poll() for pipe in pipes):
            yield
        for pipe in pipes:
            pipe.recv()


@contextmanager
def monitors(endpoint: str, count: int = MONITORS, stopped: int = MONITORS // 2) -> Iterator[Monitors]:
    """Processes of monitors; they end with the block."""
    context, crew = multiprocessing.get_context("spawn"), []
    for _ in range(count):
        here, there = context.Pipe()
        process = context.Process(target=_be_monitor, args=(there, endpoint), daemon=True)
        process.start()
        there.close()
        crew.append((process, here))
    try:
        for _, pipe in crew:
            pipe.recv()
        yield Monitors(crew, stopped)
    finally:
        for process, pipe in crew:
            pipe.close()
            process.join()


def _be_monitor(pipe: Connection, endpoint: str) -> None:
    os.nice(BEHIND)
    pipe.send("ready")
    try:
        while pipe.recv():
            _watch(pipe, endpoint)
    except EOFError:
        return


def _watch(pipe: Connection, endpoint: str) -> None:
    with ZenohBus.connect(endpoint, 10.0) as bus, Feed(bus) as feed:
        while not any(view.workers for view in feed.views()):
            feed.wait(LOOK)
        pipe.send("there")
        while (told := _told(pipe, feed)) != "leave":
            flood(bus, Keys(JOB).event(told), FLOOD)
            pipe.send("flooded")
    pipe.send("gone")


def _told(pipe: Connection, feed: Feed) -> str:
    """Read the feed now and then, until the next command comes."""
    while not pipe.poll(LOOK):
        feed.views()
    return str(pipe.recv())


def measure_monitors(seconds: float) -> Iterator[ScaleFigure]:
    with router() as (endpoint, _):
        yield from _beside(
            lambda: Timed.connect(endpoint, 10.0, Stop()), endpoint, seconds, "a router beside it"
        )
    endpoint = own_endpoint()
    yield from _beside(lambda: Timed.router(endpoint), endpoint, seconds, "the router within it")


def _beside(
    open_session: Callable[[], Timed], endpoint: str, seconds: float, where: str
) -> Iterator[ScaleFigure]:
    with monitors(endpoint) as company:
        pairs = take_turns(open_session, endpoint, company, MONITOR_PAIRS, min(seconds, MONITOR_WINDOW))
    yield from compared(pairs, f"{MONITORS} monitors, {where}")
    beside, alone = mean(pair.beside.shown for pair in pairs), mean(pair.alone.shown for pair in pairs)
    remark = f"alone {alone:.1f} /s"
    yield ScaleFigure(
        f"messages for monitors, {where}", beside / alone, "times", most=MOST_MORE, remark=remark
    )
    grown = median((pair.beside.memory - pair.alone.memory) / MONITORS / 1024 for pair in pairs)
    yield ScaleFigure(f"memory for a monitor, {where}", grown, "KiB", remark="of the coordinator's process")
