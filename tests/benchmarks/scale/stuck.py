"""Somebody subscribes to `qdgrasp/**` and never reads: what that costs the coordinator, pair by pair."""

import multiprocessing
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection

import zenoh
from tests.benchmarks.scale.figures import Figure
from tests.benchmarks.scale.rig import router
from tests.benchmarks.scale.turns import Timed, compared, take_turns

from qdgrasp_protocol.bus import Channel
from qdgrasp_protocol.endpoint import parse_all
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.session import settings, to_json5
from qdgrasp_protocol.zenoh_bus import ZenohBus

PAIRS = 21
WINDOW = 2.0
"""Seconds at most: whoever does not read for 4 s takes the router for dead, and is stuck no longer."""
FLOOD, PIECE = 1000, 64 << 10
"""So many messages of so many bytes fill every buffer on the way to somebody who never reads."""


class Stuck:
    """A process that subscribes to everything, has been sent much, and does not read before it is told to."""

    def __init__(self, endpoint: str) -> None:
        self._endpoint = endpoint
        self.lost: list[int] = []
        """How many messages it lost each time."""

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
    """Send much to those who hear what jobs show."""
    for _ in range(messages):
        bus.put(key, bytes(PIECE), encoding="application/json", channel=Channel.MONITOR)


def _be_stuck(pipe: Connection, endpoint: str) -> None:
    key = Keys("other").stat("flood")
    chosen = settings("client", connect=parse_all(endpoint), seconds=10.0)
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


def measure(seconds: float) -> Iterator[Figure]:
    with router() as (endpoint, _):
        company = Stuck(endpoint)
        pairs = take_turns(
            lambda: Timed.connect(endpoint, 10.0, Stop()), endpoint, company, PAIRS, min(seconds, WINDOW)
        )
    yield from compared(pairs, "it")
    remark = f"of {FLOOD}: it is there, and stuck"
    is_stuck = [0 < lost < FLOOD for lost in company.lost]
    yield Figure("pairs in which it lost some", sum(is_stuck), "pairs", least=PAIRS, remark=remark)
