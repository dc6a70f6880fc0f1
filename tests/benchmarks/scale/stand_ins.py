"""Stand-ins: sessions on the bus that answer as workers do, with prepared results and without a simulator."""

import heapq
import multiprocessing
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection

import msgpack
from tests.benchmarks.scale.prepared import Answers

from qdgrasp_protocol import codec
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.errors import BusError, NoReply
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.messages import VERSION, Join, Joined, Result, Work
from qdgrasp_protocol.zenoh_bus import ZenohBus

PLATFORM = {"stand-in": "1"}
OPENING = 16
"""Sessions that a process opens at once."""
PATIENCE = 30.0
"""Seconds until the router must answer."""


@dataclass(frozen=True)
class Crowd:
    """So many stand-ins of a job."""

    endpoint: str
    job: str
    workers: int
    credit: int = 2
    seconds: float = 0.0
    """What a batch takes one of them; 0: nothing."""


class StandIn:
    """One session that answers.

    Parameters
    ----------
    later
        Calls a function at a time.
    """

    def __init__(self, number: int, crowd: Crowd, later: Callable[[float, Callable[[], None]], None]) -> None:
        self._number = number
        self.wid = secrets.token_hex(16)
        self._crowd = crowd
        self._later = later
        self._keys = Keys(crowd.job)
        self._doors = ExitStack()
        self._answers: dict[tuple[int, str, int], Answers] = {}
        self._free_at = 0.0

    def join(self) -> float:
        """Come up and join; when the answer was there."""
        self._bus = self._doors.enter_context(ZenohBus.connect(self._crowd.endpoint, PATIENCE, Stop()))
        self._doors.enter_context(self._bus.subscribe(self._keys.work(self.wid), self._take))
        self._doors.enter_context(self._bus.token(self._keys.worker_token(self.wid)))
        self._ask()
        return time.monotonic()

    def close(self) -> None:
        self._doors.close()

    def _ask(self) -> None:
        request = Join(
            versions=[VERSION],
            wid=self.wid,
            number=1,
            credit=self._crowd.credit,
            held=[],
            host="here",
            pid=1,
            platform=PLATFORM,
        )
        while True:
            try:
                codec.decode(self._bus.ask(self._keys.join, codec.encode(request), timeout=10.0), Joined)
            except NoReply:
                time.sleep(0.05)
            else:
                return

    def _take(self, sample: Sample) -> None:
        if sample.encoding != codec.encoding(Work):
            return
        if not self._crowd.seconds:
            self._answer(sample.payload)
            return
        self._free_at = max(self._free_at, time.monotonic()) + self._crowd.seconds
        self._later(self._free_at, lambda: self._answer(sample.payload))

    def _answer(self, payload: bytes) -> None:
        work = msgpack.unpackb(payload)
        kind = (work["epoch"], work["run"], work["n"])
        if kind not in self._answers:
            self._answers[kind] = Answers(self._number, self.wid, *kind, self._crowd.seconds)
        answer = self._answers[kind].to(work["generation"], work["batch"], work["attempt"])
        with suppress(BusError):  # the session is closed: nobody waits for it
            self._bus.put(self._keys.result(self.wid), answer, encoding=codec.encoding(Result))


class Clockwork:
    """Calls functions when their time has come, in a thread."""

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
def crowds(parts: list[Crowd]) -> Iterator["Ready"]:
    """Processes, a crowd each, that wait to be told to join; they end with the block."""
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
        yield Ready(pipes)


class Ready:
    """Processes of stand-ins that are there."""

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
        """When the last of them had its answer, by `time.monotonic`."""
        return max(pipe.recv() for pipe in self._pipes)


def _serve(pipe: Connection, crowd: Crowd) -> None:
    clockwork = Clockwork()
    members = [StandIn(number, crowd, clockwork.later) for number in range(crowd.workers)]
    pipe.send(None)
    if pipe.recv() is None:
        return
    with ThreadPoolExecutor(OPENING) as pool:
        pipe.send(max(pool.map(StandIn.join, members)))
        pipe.recv()
        list(pool.map(StandIn.close, members))
