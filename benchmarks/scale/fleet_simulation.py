"""A simulated fleet: the coordinator's real decisions, and workers that take the time that rows take.

Time, messages and workers are simulated. Rows take their time as those of the default method do.
"""

import heapq
import itertools
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf, nan

import numpy as np
from numpy.typing import NDArray
from tests.fakes.messages import join_message, result_message

from qdgrasp_coordinator.scheduler.batch_dispatcher import Dispatcher
from qdgrasp_coordinator.scheduler.batch_queue import Lease, RunRef, Settlement
from qdgrasp_coordinator.scheduler.coordinator_service import MOST_WAIT
from qdgrasp_coordinator.scheduler.pipeline import Flight, Pipeline
from qdgrasp_coordinator.scheduler.worker_registry import WorkerRegistry
from qdgrasp_protocol.rows import Genomes, Outcome, Rows, RowShape

SHAPE = RowShape(genes=1, joints=0, descriptors=3)
CREDIT = 2
BEFORE, ALONE, IN_CAMPAIGN = Flight(2), Flight(2, 24), Flight(8)
"""Generations of 50 in flight: of a run until version 0.2.0, of a run alone, and of one among many."""
MANY = 10**9
LATENCY = 0.002
"""Seconds that a message takes."""
HANDLING = 80e-6
"""Time of the coordinator's thread per batch [s]: one of 64 rows, less its rows (docs/speed.md)."""
SEARCHING = 17e-6
"""Time of the coordinator's thread per genome [s], of the default method (docs/speed.md)."""
UNTRIED = 0.4
"""Share of genomes of which no pose is simulated: on the cube .32, on the drill .41."""
SCREENED = 0.3
"""Time of such a genome, as a share of the mean."""
SHAPES = (9.0, 16.0)
"""Shapes of the gamma distributions of both times: 99.9 % are below three times the mean."""
SLOW = 10.0
"""Time of a slow row, as a multiple of its usual time: the machine was busy, or something was made first."""
GENOMES = 16_700
"""Genomes of a run of 10 000 evaluations."""
AT_ONCE = 256
"""Messages that it takes between two rounds of leases."""
LEASE = 4.0
"""Seconds after which a frozen worker's token vanishes."""
REPLACED, FROZEN = 5.0, 20.0
"""Seconds until a worker that died is replaced, and that one is frozen."""


@dataclass(frozen=True)
class WorkerProfile:
    """Number, speed and failures of the simulated workers."""

    workers: int
    row_seconds: float = 0.05
    """The mean time of a row [s]."""
    spread: float = 0.0
    """The deviation of the logarithm of the workers' speeds."""
    life: float = inf
    """The mean time until a worker dies [s]; another one joins after `REPLACED` seconds."""
    freeze: float = inf
    """The mean time until a worker is frozen for `FROZEN` seconds [s]."""
    slow: float = 2e-4
    """Share of slow rows; there was one in 4500 and 6800."""


@dataclass(frozen=True)
class Task:
    """The runs that the workers carry out."""

    runs: int = 1
    population: int = 50
    flight: Flight = BEFORE
    batch_size: int | None = None
    genomes: int = MANY
    """Genomes of a run, after which another one is opened in its place; of the first runs any share."""
    build: float = 0.0
    """Time for which a worker builds an object's shape before its run is opened [s]."""
    shards: int = 1
    """Coordinators that share runs and workers evenly."""


@dataclass
class Figures:
    """Measured figures of a fleet."""

    utilisation: float
    """The share of the workers' time that went into rows that count."""
    age: float
    """The median time from the ask of a generation to its tell [s]; NaN: none was told."""
    outstanding: float
    """Batches leased and not settled, on average."""
    rows_per_second: float
    rows_per_batch: float


class TimedSearch:
    """A search that notes when it is asked and told."""

    def __init__(self, population: int, fleet: "FleetSimulation") -> None:
        self._genomes = np.zeros((population, SHAPE.genes), dtype=np.float32)
        self._fleet = fleet
        self._asked: deque[float] = deque()

    def ask(self, generation: int) -> Genomes:
        self._asked.append(self._fleet.now)
        return self._genomes

    def tell(self, generation: int, rows: Rows) -> None:
        self._fleet.ages.append((self._fleet.now, self._fleet.now - self._asked.popleft()))


@dataclass(eq=False)
class SimulatedWorker:
    """A worker that finishes its batches one after the other."""

    wid: str
    speed: float
    number: int = 1
    free_at: float = 0.0
    pending: dict[bytes, float] = field(default_factory=dict)
    """Time at which the result of each of its batches is ready [s]."""
    is_over: bool = False


class FleetSimulation:
    """The dispatch of one job to simulated workers, on a simulated clock."""

    def __init__(self, profile: WorkerProfile, task: Task, seed: int = 0) -> None:
        self.now = 0.0
        self.ages: list[tuple[float, float]] = []
        self._profile = profile
        self._chance = np.random.default_rng(seed)
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()
        self._inbox: deque[Callable[[], None]] = deque()
        self._is_busy = False
        self._wakes_at = inf
        self._useful: list[tuple[float, float, int]] = []
        """Of settled batches: the time of settling, the time that they took, and their rows."""
        self._leased: list[tuple[float, int]] = []
        self._workers = WorkerRegistry()
        self._dispatcher = Dispatcher(1, self._workers, task.batch_size)
        self._task = task
        self._opened = itertools.count()
        self._pipelines: dict[str, Pipeline] = {}
        self._askable: set[str] = set()
        """Runs that may have genomes to ask."""
        for _ in range(task.runs):
            share = 1.0 if task.runs == 1 else self._chance.random()
            self._open_run(int(min(task.genomes, MANY) * share))
        self._rows = 0
        self._simulated: dict[str, SimulatedWorker] = {}
        for _ in range(profile.workers):
            self._at(self._first_join(), self._start_worker)

    def run(self, seconds: float, most: int, since: float = 0.5) -> Figures:
        """Figures of the second half of so many seconds, or of so many settled batches if sooner.

        It ends with the last run. `since` is the share of the time that does not count.
        """
        while self.now < seconds and len(self._useful) < most and self._pipelines:
            self.now, _, call = heapq.heappop(self._events)
            call()
        return self._figures(self.now * since, self.now)

    def _open_run(self, genomes: int) -> None:
        name, task = f"run-{next(self._opened)}", self._task
        search = TimedSearch(task.population, self)
        self._pipelines[name] = Pipeline(search, SHAPE, max(1, genomes), "count", task.flight)
        self._askable.add(name)

    def _end_run(self, name: str) -> None:
        """Let a run go, and open another one when the worker that has least to do has built its shape."""
        del self._pipelines[name]
        self._dispatcher.withdraw(name)
        self._askable.discard(name)
        if self._task.runs > 1:
            worker = min(self._simulated.values(), key=lambda each: each.free_at)
            worker.free_at = max(worker.free_at, self.now) + self._task.build
            self._at(worker.free_at, lambda: self._send(lambda: self._open_run(self._task.genomes)))

    def _figures(self, begin: float, end: float) -> Figures:
        useful = [(min(took, at - begin), rows) for at, took, rows in self._useful if at > begin]
        rows = sum(n for _, n in useful)
        ages = [age for time, age in self.ages if time >= begin] or [nan]
        return Figures(
            utilisation=sum(took for took, _ in useful) / (end - begin) / self._profile.workers,
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
        """Send a message to the coordinator."""
        self._at(self.now + LATENCY, lambda: self._arrive(call))

    def _arrive(self, call: Callable[[], None]) -> None:
        self._inbox.append(call)
        if not self._is_busy:
            self._is_busy = True
            self._at(self.now, self._handle_messages)

    # The coordinator.

    def _handle_messages(self) -> None:
        """Process the messages, and act on them as the service does."""
        n, before = min(len(self._inbox), AT_ONCE), self._rows
        for _ in range(n):
            self._inbox.popleft()()
        self._at(self.now + n * HANDLING + (self._rows - before) * SEARCHING, self._step)

    def _step(self) -> None:
        for lost in self._workers.overdue(self.now):
            self._dispatcher.requeue(lost.worker.wid, lost.batches)
        for result in self._dispatcher.take_released(self.now):
            self._take_rows(result.run.run, result.rows, result.reply.cpu_seconds)
        self._ask()
        for lease in self._dispatcher.leases(self.now):
            self._at(self.now + LATENCY, lambda lease=lease: self._take(lease))  # type: ignore[misc]
        self._leased.append((self.now, self._dispatcher.counters["leased"] - len(self._useful)))
        self._is_busy = bool(self._inbox)
        if self._inbox:
            self._at(self.now, self._handle_messages)
        else:
            self._wake_by(min(self.now + MOST_WAIT, max(self.now, self._workers.next_deadline()) + 0.01))

    def _wake_by(self, time: float) -> None:
        """Have the coordinator do its next step at this time at the latest."""
        if time < self._wakes_at:
            self._wakes_at = time
            self._at(time, self._wake_up)

    def _wake_up(self) -> None:
        self._wakes_at = inf
        if not self._is_busy:
            self._is_busy = True
            self._step()

    def _ask(self) -> None:
        """Queue the genomes that may be asked; the cost of rows is known from the first one on."""
        waiting = self._dispatcher._queue._runs
        is_first = not waiting
        askable, self._askable = self._askable, set()
        for run in sorted(askable):
            while (asked := self._pipelines[run].ask()) is not None:
                self._dispatcher.submit(RunRef(run, "scene", "prior"), asked)
        for rows in waiting.values() if is_first else ():
            rows.sizer.measure(50, 50 * self._profile.row_seconds)

    def _settle(self, worker: SimulatedWorker, lease: Lease, seconds: float) -> None:
        batch = lease.batch
        rows = SHAPE.empty(len(batch))
        rows["outcome"] = Outcome.MISSED
        named = {"run": batch.run.run, "generation": batch.rows.number, "batch": batch.id, "n": len(batch)}
        more = {"attempt": lease.attempt, "wid": worker.wid, "joints": 0, "cpu_seconds": seconds}
        result = result_message(**named, **more)
        settled = self._dispatcher.settle(worker.wid, result, rows, self.now)
        self._rows += len(batch)
        if settled.kind is Settlement.FRESH and batch.check is None:
            self._useful.append((self.now, seconds, len(batch)))
        if settled.rows is not None:
            self._take_rows(batch.run.run, settled.rows, seconds)
        for other in self._simulated.keys() & settled.superseded:
            self._simulated[other].pending.pop(batch.id, None)

    def _take_rows(self, run: str, rows: Rows, seconds: float) -> None:
        if (pipeline := self._pipelines.get(run)) is None:
            return
        pipeline.settle(rows, seconds)
        self._askable.add(run)
        if pipeline.finished is not None:
            self._end_run(run)

    # The workers.

    def _start_worker(self) -> None:
        wid = f"{next(self._count):032x}"
        speed = float(np.exp(self._chance.normal(0, self._profile.spread)))
        worker = self._simulated[wid] = SimulatedWorker(wid, speed)
        self._join(worker)
        self._at(self.now + self._time(self._profile.life), lambda: self._die(worker))
        self._at(self.now + self._time(self._profile.freeze), lambda: self._freeze(worker))

    def _first_join(self) -> float:
        """Time at which a first worker joins [s]: at once, or when its freeze ends."""
        is_frozen = self._chance.random() < FROZEN / (FROZEN + self._profile.freeze)
        return float(self._chance.uniform(0, FROZEN)) if is_frozen else 0.0

    def _time(self, mean: float) -> float:
        return float(self._chance.exponential(mean)) if mean < inf else inf

    def _join(self, worker: SimulatedWorker) -> None:
        self._send(lambda: self._admit(worker))

    def _admit(self, worker: SimulatedWorker) -> None:
        self._workers.on_token(worker.wid, True, self.now)
        join = join_message(worker.wid, worker.number, CREDIT, list(worker.pending))
        for batch in self._dispatcher.join(join, self.now):
            worker.pending.pop(batch, None)

    def _take(self, lease: Lease) -> None:
        """A worker evaluates a batch, after those that it has."""
        worker = self._simulated.get(lease.wid)
        if worker is None or lease.join != worker.number:
            return
        times = row_times(self._chance, len(lease.batch), self._profile.slow)
        seconds = float(times.sum()) * self._profile.row_seconds * worker.speed
        worker.free_at = max(worker.free_at, self.now) + seconds
        worker.pending[lease.batch.id] = worker.free_at
        self._at(worker.free_at, lambda: self._finish(worker, lease, seconds))

    def _finish(self, worker: SimulatedWorker, lease: Lease, seconds: float) -> None:
        due = worker.pending.get(lease.batch.id)
        if worker.is_over or due is None:
            return
        if self.now < due:  # it was frozen meanwhile
            self._at(due, lambda: self._finish(worker, lease, seconds))
            return
        del worker.pending[lease.batch.id]
        self._send(lambda: self._settle(worker, lease, seconds))

    def _die(self, worker: SimulatedWorker) -> None:
        worker.is_over = True
        del self._simulated[worker.wid]
        self._send(lambda: self._lose_token(worker))
        self._at(self.now + REPLACED, self._start_worker)

    def _lose_token(self, worker: SimulatedWorker) -> None:
        self._workers.on_token(worker.wid, False, self.now)

    def _freeze(self, worker: SimulatedWorker) -> None:
        """Freeze a worker: its token vanishes, and it joins again when it is back."""
        if worker.is_over:
            return
        worker.pending = {batch: due + FROZEN for batch, due in worker.pending.items()}
        worker.free_at = max(worker.free_at, self.now) + FROZEN
        self._at(self.now + LEASE, lambda: self._send(lambda: self._lose_token(worker)))
        self._at(self.now + FROZEN, lambda: self._unfreeze(worker))
        self._at(self.now + FROZEN + self._time(self._profile.freeze), lambda: self._freeze(worker))

    def _unfreeze(self, worker: SimulatedWorker) -> None:
        if not worker.is_over:
            worker.number += 1
            self._join(worker)


def row_times(chance: np.random.Generator, n: int, slow: float = 0.0) -> NDArray[np.float64]:
    """Draw times of rows (n,), 1 on average; `slow` is the share of slow ones."""
    is_untried = chance.random(n) < UNTRIED
    mean = np.where(is_untried, SCREENED, (1.0 - UNTRIED * SCREENED) / (1.0 - UNTRIED))
    shape = np.where(is_untried, *SHAPES)
    is_slow = chance.random(n) < slow
    times: NDArray[np.float64] = mean * chance.gamma(shape) / shape * np.where(is_slow, SLOW, 1.0)
    return times / (1.0 + slow * (SLOW - 1.0))
