"""Somebody subscribes to `qdgrasp/**` and never reads: what that costs the coordinator, pair by pair."""

import multiprocessing
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from statistics import median

import numpy as np
import zenoh
from tests.benchmarks.scale.dispatching import BATCH, IN_FLIGHT, POPULATION, WARM_UP, WORKERS, Prepared, spec
from tests.benchmarks.scale.figures import Figure
from tests.benchmarks.scale.rig import JOB, Several, Watch, assignment, router
from tests.benchmarks.scale.stand_ins import Crowd, Ready, crowds

from qdgrasp_coordinator.bench.course import Unkept
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.serving.service import CoordinatorService
from qdgrasp_protocol.bus import Channel
from qdgrasp_protocol.endpoint import parse_all
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.session import settings, to_json5
from qdgrasp_protocol.zenoh_bus import ZenohBus

PAIRS = 21
WINDOW = 2.0
"""Seconds at most: whoever does not read for 4 s takes the router for dead, and is stuck no longer."""
PAUSE = 0.5
"""Seconds before a window."""
MOST_CPU, MOST_PUT, MOST_WAIT = 1.05, 1.5, 1.0
FLOOD, PIECE = 1000, 64 << 10
"""So many messages of so many bytes fill every buffer on the way to somebody who never reads."""
RESAMPLES = 10_000


class Timed(ZenohBus):
    """A session that notes how long each put takes [s]."""

    def put(self, key: str, payload: bytes, *, encoding: str, channel: Channel = Channel.DATA) -> None:
        began = time.perf_counter()
        super().put(key, payload, encoding=encoding, channel=channel)
        self.took.append(time.perf_counter() - began)

    took: list[float] = []  # noqa: RUF012 - one session, one list


@dataclass(frozen=True)
class Stretch:
    """What the coordinator did in a time."""

    per_batch: float
    """CPU time of a batch [us]."""
    p99: float
    """Of its puts [us]."""
    longest: float
    """Of its puts [s]."""


class Turns(Watch):
    """Measures pairs of windows, with and without a stuck subscriber; each is first in every other pair."""

    def __init__(self, crew: Ready, runs: list[Assignment], seconds: float, endpoint: str) -> None:
        super().__init__(crew, runs, WARM_UP, seconds)
        self._endpoint = endpoint
        self.pairs: list[tuple[Stretch, Stretch]] = []
        self.lost: list[int] = []

    def _watch(self, warm_up: float, seconds: float) -> Iterator[None]:
        while not self._service._turn.epoch:
            yield
        self._crew.join()
        while not self._crew.have_joined:
            yield
        self._crew.last_join()
        yield from self._wait(warm_up)
        for pair in range(PAIRS):
            found: dict[bool, Stretch] = {}
            for is_stuck in (False, True) if pair % 2 == 0 else (True, False):
                found[is_stuck] = yield from (self._beside(seconds) if is_stuck else self._alone(seconds))
            self.pairs.append((found[False], found[True]))

    def _alone(self, seconds: float) -> Iterator[None]:
        yield from self._wait(PAUSE)
        Timed.took.clear()
        cpu, batches = time.process_time(), self._count()[1]
        yield from self._wait(seconds)
        cpu, batches = time.process_time() - cpu, self._count()[1] - batches
        took = np.array(Timed.took)
        return Stretch(1e6 * cpu / batches, 1e6 * float(np.quantile(took, 0.99)), float(took.max()))

    def _beside(self, seconds: float) -> Iterator[None]:
        with stuck(self._endpoint) as pipe:
            while not pipe.poll():
                yield
            pipe.recv()
            found = yield from self._alone(seconds)
            pipe.send(None)
            while not pipe.poll():
                yield
            self.lost.append(pipe.recv())
        return found


@contextmanager
def stuck(endpoint: str) -> Iterator[Connection]:
    """A process that subscribes to everything, has been sent much, and does not read before it is told to."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_be_stuck, args=(there, endpoint), daemon=True)
    process.start()
    there.close()
    try:
        yield here
    finally:
        process.join()


def _be_stuck(pipe: Connection, endpoint: str) -> None:
    key = Keys("other").stat("flood")
    chosen = settings("client", connect=parse_all(endpoint), seconds=10.0)
    with (
        zenoh.open(zenoh.Config.from_json5(to_json5(chosen, "stuck"))) as session,
        ZenohBus.connect(endpoint, 10.0) as other,
    ):
        subscriber = session.declare_subscriber("qdgrasp/**", zenoh.handlers.FifoChannel(1))
        time.sleep(0.5)  # until the router knows of it
        for _ in range(FLOOD):
            other.put(key, bytes(PIECE), encoding="application/json", channel=Channel.MONITOR)
        pipe.send(None)
        pipe.recv()
        heard, until = 0, time.monotonic() + 1.0
        while time.monotonic() < until:
            sample = subscriber.try_recv()
            heard += sample is not None and str(sample.key_expr) == key
        pipe.send(FLOOD - heard)


def measure(seconds: float) -> Iterator[Figure]:
    runs = [assignment("run", spec("contact_rand", POPULATION), Prepared(POPULATION), IN_FLIGHT)]
    with router() as (endpoint, _), crowds([Crowd(endpoint, JOB, WORKERS)]) as crew:
        turns = Turns(crew, runs, min(seconds, WINDOW), endpoint)
        with Timed.connect(endpoint, 10.0, Stop()) as bus:
            service = CoordinatorService(
                bus,
                turns.stop,
                job=JOB,
                programme=Several(runs),
                make_record=lambda run: Unkept(run.shape),
                batch_size=BATCH,
            )
            service.run(lambda now: turns.look(now, service))
    cpu = [beside.per_batch / alone.per_batch for alone, beside in turns.pairs]
    put = [beside.p99 / alone.p99 for alone, beside in turns.pairs]
    longest = max(beside.longest for _, beside in turns.pairs)
    usual = median(alone.p99 for alone, _ in turns.pairs)
    yield Figure("CPU of a batch beside it", median(cpu), "times", most=MOST_CPU, remark=_words(cpu))
    remark = f"{_words(put)}; alone {usual:.0f} us"
    yield Figure("p99 of a put beside it", median(put), "times", most=MOST_PUT, remark=remark)
    yield Figure("longest put beside it", longest, "s", most=MOST_WAIT)
    remark = f"of {FLOOD}: it is there, and stuck"
    is_stuck = [0 < lost < FLOOD for lost in turns.lost]
    yield Figure("pairs in which it lost some", sum(is_stuck), "pairs", least=PAIRS, remark=remark)


def _words(ratios: list[float]) -> str:
    """The bootstrap interval of the median of pairs."""
    random = np.random.default_rng(0)
    medians = np.median(random.choice(ratios, (RESAMPLES, len(ratios))), axis=1)
    low, high = np.quantile(medians, [0.025, 0.975])
    return f"median of {len(ratios)} pairs, 95 % interval {low:.3f} to {high:.3f}"
