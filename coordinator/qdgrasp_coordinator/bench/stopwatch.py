"""The stopwatch: what workers do in a time, from the results that pass on the bus."""

import time
from dataclasses import astuple, dataclass
from typing import NamedTuple

import numpy as np

from qdgrasp_protocol import codec
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Result
from qdgrasp_protocol.outcome import Outcome


class Tick(NamedTuple):
    """A batch that came back."""

    at: float
    """[s], of any steady clock."""
    wid: str
    generation: int
    rows: int
    cpu_seconds: float
    overlaps: int
    successes: int


@dataclass(frozen=True)
class Lap:
    """What some workers did at the same time."""

    workers: int
    rows: int
    per_second: float
    """Rows in a second of the clock on the wall, of all workers together."""
    cpu_seconds: float
    overlaps: int
    successes: int


class Stopwatch:
    """Notes every result; told of them in threads of the bus."""

    def __init__(self) -> None:
        self._ticks: list[Tick] = []

    @property
    def has_begun(self) -> bool:
        """Whether any result came."""
        return bool(self._ticks)

    def take(self, sample: Sample) -> None:
        """Note a result; what is none is passed over."""
        try:
            result = codec.decode(sample.payload, Result)
        except MessageError:
            return
        self._ticks.append(tick(result, time.monotonic()))

    def workers(self, since: int) -> int:
        """How many workers gave a result of generation `since`, or of a later one."""
        return len(self._by_worker(since))

    def rows(self, since: int) -> int:
        """How many rows of generation `since` and of later ones came back."""
        return sum(tick.rows for ticks in self._by_worker(since) for tick in ticks)

    def lap(self, since: int, begin: float) -> Lap:
        """What was done from `begin` on, of generation `since` and of later ones.

        A worker's own time goes from its last result until then, or from its first one, to the last that
        came, so that no part of a batch is counted. Left out is who gave none in that time.
        """
        laps = [lap for ticks in self._by_worker(since) if (lap := _alone(ticks, begin))]
        nothing = Lap(0, 0, 0.0, 0.0, 0, 0)
        return Lap(*(sum(column) for column in zip(*map(astuple, [nothing, *laps]), strict=True)))

    def _by_worker(self, since: int) -> list[list[Tick]]:
        found: dict[str, list[Tick]] = {}
        for tick in list(self._ticks):
            if tick.generation >= since:
                found.setdefault(tick.wid, []).append(tick)
        return list(found.values())


def _alone(ticks: list[Tick], begin: float) -> Lap | None:
    """What one worker did; None: nothing that has both a beginning and an end."""
    start = max(sum(tick.at <= begin for tick in ticks), 1)
    done = ticks[start:]
    if not done:
        return None
    rows = sum(tick.rows for tick in done)
    return Lap(
        workers=1,
        rows=rows,
        per_second=rows / (done[-1].at - ticks[start - 1].at),
        cpu_seconds=sum(tick.cpu_seconds for tick in done),
        overlaps=sum(tick.overlaps for tick in done),
        successes=sum(tick.successes for tick in done),
    )


def tick(result: Result, now: float) -> Tick:
    """What there is to note of a result."""
    outcomes = np.frombuffer(result.columns.get("outcome", b""), np.uint8)
    overlaps, successes = (outcomes == Outcome.OVERLAP).sum(), (outcomes >= Outcome.DROPPED).sum()
    counts = int(overlaps), int(successes)
    return Tick(now, result.wid, result.generation, result.n, result.cpu_seconds, *counts)
