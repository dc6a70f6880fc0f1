"""A fleet: the real dispatch and pipelines with up to 10 000 workers, for how busy they are and how stale.

There is no bus and no recorder here: messages take a fixed time, the coordinator is a thread that handles one
batch after the other, and workers are queues. What is asked, cut, leased, queued again and told is decided by
the machines themselves.
"""

import heapq
import itertools
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf, nan

import numpy as np

from qdgrasp_coordinator.dispatching.batch import Lease
from qdgrasp_coordinator.dispatching.dispatch import Dispatch
from qdgrasp_coordinator.runs.pipeline import Pipeline
from qdgrasp_protocol.genome import Genomes
from qdgrasp_protocol.messages import Result
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows, Shape

SHAPE = Shape(genes=1, joints=0, descriptors=3)
CREDIT = 2
LATENCY = 0.002
"""Seconds that a message takes."""
HANDLING = 50e-6
"""What a batch takes of the coordinator's thread [s]."""
AT_ONCE = 256
"""Messages that it takes between two looks at what may be leased."""
LEASE = 4.0
"""Seconds after which a frozen worker's token vanishes."""
REPLACED, FROZEN = 5.0, 20.0
"""Seconds until a worker that died is replaced, and that one is frozen."""
MANY = 10**9


@dataclass(frozen=True)
class Crew:
    """The workers."""

    workers: int
    row_seconds: float = 0.02
    """The mean time of a row [s]."""
    spread: float = 0.0
    """The deviation of the logarithm of the workers' speeds."""
    life: float = inf
    """The mean time until a worker dies [s]; another one joins after `REPLACED` seconds."""
    freeze: float = inf
    """The mean time until a worker is frozen for `FROZEN` seconds [s]."""


@dataclass(frozen=True)
class Task:
    """What they work on."""

    runs: int = 1
    population: int = 500
    in_flight: int = 1
    batch_size: int | None = None


@dataclass
class Figures:
    """What was seen of a fleet."""

    utilisation: float
    """The share of the workers' time that went into rows that count."""
    age: float
    """The median time from the ask of a generation to its tell [s]; NaN: none was told."""
    outstanding: float
    """Batches leased and not settled, on average."""
    rows_per_second: float
    rows_per_batch: float


class Timed:
    """A search that notes when it is asked and told."""

    def __init__(self, population: int, fleet: "Fleet") -> None:
        self._genomes = np.zeros((population, SHAPE.genes), dtype=np.float32)
        self._fleet = fleet
        self._asked: deque[float] = deque()

    def ask(self, generation: int) -> Genomes:
        self._asked.append(self._fleet.now)
        return self._genomes

    def tell(self, generation: int, rows: Rows) -> None:
        self._fleet.ages.append((self._fleet.now, self._fleet.now - self._asked.popleft()))


@dataclass(eq=False)
class Hand:
    """A worker, as a queue."""

    wid: str
    speed: float
    number: int = 1
    free_at: float = 0.0
    pending: dict[bytes, float] = field(default_factory=dict)
    """When the result of each batch it holds is there."""
    is_over: bool = False


class Fleet:
    """A job's coordinator and its workers."""

    def __init__(self, crew: Crew, task: Task, seed: int = 0) -> None:
        self.now = 0.0
        self.ages: list[tuple[float, float]] = []
        self._crew = crew
        self._chance = np.random.default_rng(seed)
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()
        self._inbox: deque[Callable[[], None]] = deque()
        self._is_at_work = False
        self._useful: list[tuple[float, float, int]] = []
        """When batches were settled, what they took, and their rows."""
        self._leased: list[tuple[float, int]] = []
        self._dispatch = Dispatch(1, task.batch_size)
        self._pipelines = {
            f"run-{n}": Pipeline(Timed(task.population, self), SHAPE, MANY, "count", task.in_flight)
            for n in range(task.runs)
        }
        self._told = set(self._pipelines)
        """Runs that may have something to ask."""
        self._hands: dict[str, Hand] = {}
        for _ in range(crew.workers):
            self._at(self._begin(), self._hire)

    def play(self, seconds: float, most: int) -> Figures:
        """Figures of the second half of so many seconds, or of so many settled batches if sooner."""
        while self.now < seconds and len(self._useful) < most:
            self.now, _, call = heapq.heappop(self._events)
            call()
        return self._figures(self.now / 2, self.now)

    def _figures(self, begin: float, end: float) -> Figures:
        useful = [(min(took, at - begin), rows) for at, took, rows in self._useful if at > begin]
        rows = sum(n for _, n in useful)
        ages = [age for time, age in self.ages if time >= begin] or [nan]
        return Figures(
            utilisation=sum(took for took, _ in useful) / (end - begin) / self._crew.workers,
            age=float(np.median(ages)),
            outstanding=float(np.mean([n for time, n in self._leased if time >= begin])),
            rows_per_second=rows / (end - begin),
            rows_per_batch=rows / max(1, len(useful)),
        )

    # Time.

    def _at(self, time: float, call: Callable[[], None]) -> None:
        if time < inf:
            heapq.heappush(self._events, (time, next(self._count), call))

    def _send(self, call: Callable[[], None]) -> None:
        """Let the coordinator hear something."""
        self._at(self.now + LATENCY, lambda: self._arrive(call))

    def _arrive(self, call: Callable[[], None]) -> None:
        self._inbox.append(call)
        if not self._is_at_work:
            self._is_at_work = True
            self._at(self.now, self._turn)

    # The coordinator.

    def _turn(self) -> None:
        """Hear what came, and do what can be done, as the service does."""
        n = min(len(self._inbox), AT_ONCE)
        for _ in range(n):
            self._inbox.popleft()()
        self._at(self.now + n * HANDLING, self._step)

    def _step(self) -> None:
        self._dispatch.tick(self.now)
        self._ask()
        for lease in self._dispatch.leases(self.now):
            self._at(self.now + LATENCY, lambda lease=lease: self._take(lease))  # type: ignore[misc]
        self._leased.append((self.now, self._dispatch.counters["leased"] - len(self._useful)))
        self._is_at_work = bool(self._inbox)
        if self._inbox:
            self._at(self.now, self._turn)
        elif self._dispatch.next_deadline() < inf:
            self._at(max(self.now, self._dispatch.next_deadline()) + 0.01, lambda: self._arrive(_nothing))

    def _ask(self) -> None:
        """Queue what may be asked; what rows cost is known from the first one on."""
        is_first = not self._dispatch._backlog._queues
        told, self._told = self._told, set()
        for run in sorted(told):
            while (asked := self._pipelines[run].ask()) is not None:
                self._dispatch.submit(
                    run, "scene", "prior", asked.number, asked.indices, asked.trials, asked.genomes
                )
        for queue in self._dispatch._backlog._queues.values() if is_first else ():
            queue.pace.measure(50, 50 * self._crew.row_seconds)

    def _settle(self, hand: Hand, lease: Lease, seconds: float) -> None:
        batch = lease.batch
        rows = SHAPE.empty(len(batch))
        rows["outcome"] = Outcome.MISSED
        result = Result(
            epoch=1,
            run=batch.run,
            generation=batch.generation,
            batch=batch.id,
            attempt=lease.attempt,
            wid=hand.wid,
            n=len(batch),
            joints=0,
            descriptors=3,
            columns={},
            cpu_seconds=seconds,
        )
        settled = self._dispatch.settle(hand.wid, result, rows, self.now)
        if settled.rows is not None:
            self._pipelines[batch.run].settle(settled.rows, seconds)
            self._told.add(batch.run)
            self._useful.append((self.now, seconds, len(batch)))
        if settled.superseded is not None and settled.superseded in self._hands:
            self._hands[settled.superseded].pending.pop(batch.id, None)

    # The workers.

    def _hire(self) -> None:
        wid = f"{next(self._count):032x}"
        hand = self._hands[wid] = Hand(wid, float(np.exp(self._chance.normal(0, self._crew.spread))))
        self._join(hand)
        self._at(self.now + self._time(self._crew.life), lambda: self._die(hand))
        self._at(self.now + self._time(self._crew.freeze), lambda: self._freeze(hand))

    def _begin(self) -> float:
        """When a worker of the beginning is there: at once, or when it thaws."""
        is_frozen = self._chance.random() < FROZEN / (FROZEN + self._crew.freeze)
        return float(self._chance.uniform(0, FROZEN)) if is_frozen else 0.0

    def _time(self, mean: float) -> float:
        return float(self._chance.exponential(mean)) if mean < inf else inf

    def _join(self, hand: Hand) -> None:
        self._send(lambda: self._admit(hand))

    def _admit(self, hand: Hand) -> None:
        for batch in self._dispatch.join(hand.wid, hand.number, CREDIT, list(hand.pending), self.now):
            hand.pending.pop(batch, None)
        self._dispatch.back(hand.wid, self.now)

    def _take(self, lease: Lease) -> None:
        """A worker evaluates a batch, behind what it has."""
        hand = self._hands.get(lease.wid)
        if hand is None or lease.join != hand.number:
            return
        n = len(lease.batch)
        noise = self._chance.gamma(n) / n
        seconds = n * self._crew.row_seconds * hand.speed * noise
        hand.free_at = max(hand.free_at, self.now) + seconds
        hand.pending[lease.batch.id] = hand.free_at
        self._at(hand.free_at, lambda: self._finish(hand, lease, seconds))

    def _finish(self, hand: Hand, lease: Lease, seconds: float) -> None:
        due = hand.pending.get(lease.batch.id)
        if hand.is_over or due is None:
            return
        if self.now < due:  # it was frozen meanwhile
            self._at(due, lambda: self._finish(hand, lease, seconds))
            return
        del hand.pending[lease.batch.id]
        self._send(lambda: self._settle(hand, lease, seconds))

    def _die(self, hand: Hand) -> None:
        hand.is_over = True
        del self._hands[hand.wid]
        self._send(lambda: self._dispatch.gone(hand.wid, self.now))
        self._at(self.now + REPLACED, self._hire)

    def _freeze(self, hand: Hand) -> None:
        """Stand still; the token vanishes, and with the link back the worker joins again."""
        if hand.is_over:
            return
        hand.pending = {batch: due + FROZEN for batch, due in hand.pending.items()}
        hand.free_at = max(hand.free_at, self.now) + FROZEN
        self._at(self.now + LEASE, lambda: self._send(lambda: self._dispatch.gone(hand.wid, self.now)))
        self._at(self.now + FROZEN, lambda: self._thaw(hand))
        self._at(self.now + FROZEN + self._time(self._crew.freeze), lambda: self._freeze(hand))

    def _thaw(self, hand: Hand) -> None:
        if not hand.is_over:
            hand.number += 1
            self._join(hand)


def _nothing() -> None:
    """Nothing happened but time."""
