"""A coordinator alone and beside company, in pairs of windows, each of the two first in every other pair."""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from statistics import median
from typing import Protocol

import numpy as np
from tests.benchmarks.scale.dispatching import BATCH, IN_FLIGHT, POPULATION, WARM_UP, WORKERS, Prepared, spec
from tests.benchmarks.scale.figures import Figure
from tests.benchmarks.scale.rig import JOB, Several, Watch, assignment, resident
from tests.benchmarks.scale.stand_ins import Crowd, Ready, crowds

from qdgrasp_coordinator.bench.course import Unkept
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.serving.service import CoordinatorService
from qdgrasp_protocol.bus import Channel
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
    """What the coordinator did in a time."""

    per_batch: float
    """CPU time of a batch [us]."""
    p99: float
    """Of its puts [us]."""
    longest: float
    """Of its puts [s]."""
    shown: float
    """Messages for monitors in a second."""
    memory: int
    """Of its process [bytes]."""


class Company(Protocol):
    """Those who listen in one window of each pair."""

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
        self, crew: Ready, runs: list[Assignment], pairs: int, seconds: float, company: Company
    ) -> None:
        super().__init__(crew, runs, WARM_UP, seconds)
        self._pairs = pairs
        self._company = company
        self.pairs: list[Pair] = []

    def _watch(self, warm_up: float, seconds: float) -> Iterator[None]:
        while not self._service._turn.epoch:
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
            programme=Several(runs),
            make_record=lambda run: Unkept(run.shape),
            batch_size=BATCH,
        )
        service.run(lambda now: turns.look(now, service))
    return turns.pairs


def compared(pairs: list[Pair], who: str) -> Iterator[Figure]:
    """The coordinator's figures beside company, over those alone."""
    cpu = [pair.beside.per_batch / pair.alone.per_batch for pair in pairs]
    put = [pair.beside.p99 / pair.alone.p99 for pair in pairs]
    batch, usual = (
        median(found) for found in zip(*((p.alone.per_batch, p.alone.p99) for p in pairs), strict=True)
    )
    remark = f"{_words(cpu)}; alone {batch:.0f} us"
    yield Figure(f"CPU of a batch beside {who}", median(cpu), "times", most=MOST_CPU, remark=remark)
    remark = f"{_words(put)}; alone {usual:.0f} us"
    yield Figure(f"p99 of a put beside {who}", median(put), "times", most=MOST_PUT, remark=remark)
    yield Figure(f"longest put beside {who}", max(pair.beside.longest for pair in pairs), "s", most=MOST_WAIT)


def _words(ratios: list[float]) -> str:
    """The bootstrap interval of the median of pairs."""
    random = np.random.default_rng(0)
    medians = np.median(random.choice(ratios, (RESAMPLES, len(ratios))), axis=1)
    low, high = np.quantile(medians, [0.025, 0.975])
    return f"median of {len(ratios)} pairs, 95 % interval {low:.3f} to {high:.3f}"
