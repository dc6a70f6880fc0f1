"""Twenty monitors watch a job, half of them stopped: what that costs its coordinator, pair by pair.

Monitors are processes with the feed of `qdgrasp-monitor`, which look twice a second and leave the cores to
the job, as monitors on other machines do; whoever is stopped is sent more than lies in any buffer. The router
is a process of its own first, as on several machines, then that of the coordinator, as in `qdgrasp run`.
"""

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from statistics import mean, median

from tests.benchmarks.scale.figures import Figure
from tests.benchmarks.scale.rig import JOB, router
from tests.benchmarks.scale.stuck import flood
from tests.benchmarks.scale.turns import Timed, compared, take_turns
from tests.endpoints import own_endpoint

from qdgrasp_coordinator.monitor.feed import Feed
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.zenoh_bus import ZenohBus

MONITORS = 20
PAIRS = 21
WINDOW = 1.5
"""Seconds at most: whoever is stopped for 4 s is taken for dead by the router."""
SETTLING = 0.7
"""Seconds in which those who are not stopped read what was sent to fill the others."""
BEHIND = 10
"""How nice monitors are to the job's own processes."""
LOOK = 0.5
"""Seconds between two looks."""
MOST_MORE = 1.1
"""Messages that a window has too many or too few by chance are within it."""
FLOOD = 300
"""So many messages of 64 KiB fill what lies between the router and a stopped monitor."""


class Monitors:
    """Processes that watch whatever job there is, when they are told to.

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
    """Look now and then, until there is something else to do."""
    while not pipe.poll(LOOK):
        feed.views()
    return str(pipe.recv())


def measure(seconds: float) -> Iterator[Figure]:
    with router() as (endpoint, _):
        yield from _beside(
            lambda: Timed.connect(endpoint, 10.0, Stop()), endpoint, seconds, "a router beside it"
        )
    endpoint = own_endpoint()
    yield from _beside(lambda: Timed.router(endpoint), endpoint, seconds, "the router within it")


def _beside(open_session: Callable[[], Timed], endpoint: str, seconds: float, where: str) -> Iterator[Figure]:
    with monitors(endpoint) as company:
        pairs = take_turns(open_session, endpoint, company, PAIRS, min(seconds, WINDOW))
    yield from compared(pairs, f"{MONITORS} monitors, {where}")
    beside, alone = mean(pair.beside.shown for pair in pairs), mean(pair.alone.shown for pair in pairs)
    remark = f"alone {alone:.1f} /s"
    yield Figure(f"messages for monitors, {where}", beside / alone, "times", most=MOST_MORE, remark=remark)
    grown = median((pair.beside.memory - pair.alone.memory) / MONITORS / 1024 for pair in pairs)
    yield Figure(f"memory for a monitor, {where}", grown, "KiB", remark="of the coordinator's process")
