"""A simulated world: coordinator, workers and recorder on a bus that loses, repeats, delays and reorders.

Time is a number, events are calls in a heap, all chance comes from one seed: a history is a function of its
`Plan`. The pure state machines of the coordinator run in it unchanged; the glue around them is the same few
lines that the service has. `reference` gives the journal that every history must end with.
"""

import hashlib
import heapq
import itertools
import random
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf

import numpy as np

from qdgrasp_coordinator.batch import Settlement
from qdgrasp_coordinator.dispatch import Dispatch
from qdgrasp_coordinator.outbox import Outbox
from qdgrasp_coordinator.pipeline import Pipeline
from qdgrasp_coordinator.search import Search
from qdgrasp_coordinator.service import MAX_PATIENCE
from qdgrasp_coordinator.stretch import Stretch
from qdgrasp_protocol.errors import RecorderFellBack
from qdgrasp_protocol.genome import Genomes
from qdgrasp_protocol.messages import Failure, Result, Work
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import RESULT, Rows, Shape, pack, unpack
from qdgrasp_protocol.spec import Overlaps

SHAPE = Shape(genes=4, joints=1)
PATIENCE = 20_000.0
"""Simulated seconds after which a history counts as stuck."""


# What is evaluated, by whom it is asked, and the journal that comes of it.


class Chain:
    """A search whose every ask depends on every bit of all tells: nothing can be told differently unseen."""

    def __init__(self, population: int, seed: int) -> None:
        self._population = population
        self._told = hashlib.sha256(seed.to_bytes(8, "little"))

    def ask(self, generation: int) -> Genomes:
        digest = self._told.copy()
        digest.update(f"ask {generation}".encode())
        generator = np.random.default_rng(list(digest.digest()))
        return generator.uniform(-1, 1, (self._population, SHAPE.genes)).astype(np.float32)

    def tell(self, generation: int, rows: Rows) -> None:
        self._told.update(f"tell {generation}".encode() + rows.tobytes())


def evaluate(rows: Rows) -> Rows:
    """The rows with results: a pure function of each genome and trial, poison (about 4 %) included."""
    found = rows.copy()
    genome = rows["genome"]
    share = ((genome[:, 0] + 1) / 2 + rows["trial"] * np.float32(0.37)) % 1
    found["outcome"] = np.searchsorted([0.04, 0.1, 0.5, 0.7, 0.75, 0.85, 0.95], share, side="right")
    found["fitness"] = np.maximum(found["outcome"].astype(np.float32) - Outcome.DROPPED, 0)
    found["proposals"] = 1
    found["descriptor"] = genome[:, 1:4] * np.float32(0.2)
    found["nu"] = genome[:, 1] * genome[:, 2]
    return np.where(found["outcome"] == Outcome.ERROR, rows, found)


@dataclass(frozen=True)
class Plan:
    """A history in brief. Probabilities are per message, rates per second."""

    seed: int = 0
    population: int = 6
    evaluations: int = 32
    overlaps: Overlaps = "count"
    in_flight: int = 1
    trials: int = 0
    batch_size: int | None = 2
    workers: int = 2
    credit: int = 2
    row_seconds: float = 0.05
    delay: float = 0.02
    loss: float = 0.0
    repeat: float = 0.0
    stall: float = 0.0
    """The probability that a message is delayed by up to 15 seconds."""
    hiccup: float = 0.0
    """The probability that the simulator fails on a row that is no poison, at most twice a row."""
    flap: float = 0.0
    """A worker's link goes down and comes up."""
    kill: float = 0.0
    """A worker dies and is replaced."""
    zombie: float = 0.0
    """A worker keeps its token, its work, and its peace, and is replaced by another; it may wake up."""
    link: float = 0.0
    """The coordinator's link goes down and comes up."""
    crash: float = 0.0
    """The coordinator dies and is started again."""
    recorder_crash: float = 0.0
    """The recorder dies with what it has not committed, and is started again."""
    restore: float = 0.0
    """The recorder comes back with an older disk."""
    calm_after: float = 60.0
    """Faults with a rate stop at this time."""
    search: Callable[[int, int], Search] = Chain
    """Makes the search from population and seed."""

    def pipeline(self) -> Pipeline:
        """A new pipeline of this run."""
        search = self.search(self.population, self.seed)
        return Pipeline(search, SHAPE, self.evaluations, self.overlaps, self.in_flight, self.trials)


def reference(plan: Plan) -> bytes:
    """The journal of a plan without a bus: written from the contract, not with the pipeline."""
    search = plan.search(plan.population, plan.seed)
    waiting = deque((g, search.ask(g)) for g in range(plan.in_flight))
    journal, counted, barren, idle = [], 0, 0, 0
    while True:
        number, genomes = waiting.popleft()
        rows = evaluate(rows_of(number, genomes))
        counts = rows["outcome"] >= (Outcome.MISSED if plan.overlaps == "redraw" else Outcome.ERROR)
        until = np.flatnonzero(counted + np.cumsum(counts) == plan.evaluations)[:1]
        is_last = len(until) > 0
        rows = rows[: until[0] + 1] if is_last else rows
        trials = [trials_of(row, plan.trials) for row in rows if row["outcome"] >= Outcome.DROPPED]
        journal += [rows.tobytes(), *(found.tobytes() for found in trials)]
        counted += int(counts.sum())
        barren, idle = (0, 0) if counts.any() else (barren + 1, idle + len(rows))
        if is_last or (barren >= 20 and idle >= 1000):
            return b"".join(journal)
        if plan.trials:
            sums = [float(sum(trial["fitness"] for trial in found)) for found in trials]
            rows["fitness"][rows["outcome"] >= Outcome.DROPPED] = sums
        search.tell(number, rows)
        waiting.append((number + plan.in_flight, search.ask(number + plan.in_flight)))


def trials_of(row: np.void, trials: int) -> Rows:
    """The trials of a nominal row, evaluated."""
    rows = SHAPE.empty(trials)
    rows["generation"], rows["index"], rows["genome"] = row["generation"], row["index"], row["genome"]
    rows["trial"] = np.arange(1, trials + 1)
    return evaluate(rows)


def rows_of(number: int, genomes: Genomes) -> Rows:
    """Rows of a whole generation, not evaluated."""
    rows = SHAPE.empty(len(genomes))
    rows["generation"], rows["index"], rows["genome"] = number, np.arange(len(genomes)), genomes
    return rows


# Who takes part.


@dataclass
class Worker:
    """A worker process: joins, evaluates one batch after the other, answers."""

    world: "World"
    wid: str
    number: int = 0
    work: dict[bytes, Work] = field(default_factory=dict)
    is_alive: bool = True
    is_zombie: bool = False
    is_linked: bool = True
    joined: bool = False
    busy: bool = False

    def join(self) -> None:
        """Ask to join until an answer comes."""
        self.number += 1
        self.joined = False
        number, held = self.number, list(self.work)
        self.world.send(self, lambda: self.world.hear_join(self, number, held))
        self.world.later(1.0 + self.world.chance.random(), lambda: self._join_again(number))

    def _join_again(self, number: int) -> None:
        if self.is_alive and not self.joined and number == self.number:
            self.join()

    def hear_joined(self, number: int, drop: list[bytes]) -> None:
        if self.is_alive and number == self.number:
            self.joined = True
            for batch_id in drop:
                self.work.pop(batch_id, None)

    def hear_work(self, work: Work) -> None:
        if self.is_alive and not self.is_zombie and work.join >= self.number:
            self.work[work.batch] = work
            self._begin()

    def _begin(self) -> None:
        if self.is_alive and not self.is_zombie and not self.busy and self.work:
            self.busy = True
            work = next(iter(self.work.values()))
            seconds = work.n * self.world.plan.row_seconds * self.world.chance.uniform(0.5, 2)
            self.world.later(seconds, lambda: self._finish(work))

    def _finish(self, work: Work) -> None:
        self.busy = False
        if not self.is_alive or self.is_zombie:
            return
        if self.work.pop(work.batch, None) is not None:
            result = self._result(work)
            self.world.send(self, lambda: self.world.hear_result(self.wid, result))
        self._begin()

    def _result(self, work: Work) -> Result:
        rows = SHAPE.empty(work.n)
        rows["genome"] = np.frombuffer(work.columns["genome"], "<f4").reshape(work.n, work.genes)
        rows["trial"] = np.frombuffer(work.columns["trial"], "<u2")
        found = evaluate(rows)
        failures = []
        for place, row in enumerate(found):
            if row["outcome"] == Outcome.ERROR or self.world.hiccup(
                row["genome"].tobytes() + row["trial"].tobytes()
            ):
                found[place] = np.zeros((), SHAPE.dtype)
                failures.append(Failure(row=place, reason="the child aborted"))
        self.world.evaluated[work.batch] += 1
        return Result(
            epoch=work.epoch,
            run=work.run,
            generation=work.generation,
            batch=work.batch,
            attempt=work.attempt,
            wid=self.wid,
            n=work.n,
            joints=SHAPE.joints,
            descriptors=SHAPE.descriptors,
            columns=pack(found, RESULT),
            cpu_seconds=work.n * self.world.plan.row_seconds,
            failures=failures,
        )


@dataclass
class Recorder:
    """A recorder: appends what follows, commits after a while, reports what is durable."""

    world: "World"
    journal: Rows = field(default_factory=lambda: SHAPE.empty(0))
    durable: int = 0
    is_alive: bool = True

    def hear(self, epoch: int, stretch: Stretch) -> None:
        if not self.is_alive or epoch != self.world.epoch:
            return
        if stretch.first <= len(self.journal) < stretch.stop:
            new = stretch.part(len(self.journal), stretch.stop)
            self.journal = np.concatenate([self.journal, new.rows])
            self.world.later(self.world.chance.uniform(0, 0.3), self.commit)
        else:
            self.report()

    def commit(self) -> None:
        if self.is_alive:
            self.durable = len(self.journal)
            self.report()

    def report(self) -> None:
        epoch, durable = self.world.epoch, self.durable
        self.world.send(None, lambda: self.world.hear_recorded(epoch, durable))

    def repeat(self) -> None:
        """Report at 1 Hz."""
        if self.is_alive and not self.world.is_over:
            self.report()
        self.world.later(1.0, self.repeat)

    def restart(self, durable: int) -> None:
        """Die with all that is not committed, and come back with so many rows."""
        self.is_alive = False
        self.durable = durable
        self.journal = self.journal[:durable]
        self.world.later(self.world.chance.uniform(0.1, 4), self._come_up)

    def _come_up(self) -> None:
        self.is_alive = True
        self.world.later(self.world.wait(), lambda: self.world.coordinator.recorder_up())


class Coordinator:
    """The service in miniature: carries out what pipeline, dispatch and outbox decide."""

    def __init__(self, world: "World", epoch: int, recorded: Rows) -> None:
        plan = world.plan
        self.world = world
        self.epoch = epoch
        self.is_alive = True
        self.pipeline = plan.pipeline()
        self.dispatch = Dispatch(epoch, batch_size=plan.batch_size)
        step = world.chance.randint(1, 7)
        for first in range(0, len(recorded), step):
            self.pipeline.replay(recorded[first : first + step])
        self.outbox = Outbox(len(recorded))
        self.fresh: Counter[bytes] = Counter()
        self.wake_at = float("inf")

    @property
    def is_done(self) -> bool:
        return self.is_alive and self.pipeline.finished is not None and self.outbox.is_empty

    def step(self) -> None:
        """Do everything that is possible now, and wake up when there may be more."""
        world = self.world
        if not self.is_alive:
            return
        now = world.now
        self.dispatch.tick(now)
        while not self.outbox.is_full and (rows := self.pipeline.ask()):
            self.dispatch.submit("run", "0" * 64, "p", rows.number, rows.indices, rows.trials, rows.genomes)
        if self.pipeline.finished:
            self.dispatch.withdraw("run")
        for lease in self.dispatch.leases(now):
            work, worker = lease.work(self.epoch), world.workers[lease.wid]
            world.send(worker, lambda worker=worker, work=work: worker.hear_work(work))
        for stretch in self.outbox.due(now):
            world.send(None, lambda stretch=stretch: world.recorder.hear(self.epoch, stretch))
        deadline = min(self.dispatch.next_deadline(), now + MAX_PATIENCE if self.outbox.unconfirmed else inf)
        if now < deadline < self.wake_at or self.wake_at <= now < deadline < float("inf"):
            self.wake_at = deadline
            world.later(deadline - now, self.step)

    def hear_join(self, worker: Worker, number: int, held: list[bytes]) -> None:
        drop = self.dispatch.join(worker.wid, number, self.world.plan.credit, held, self.world.now)
        self.world.send(worker, lambda: worker.hear_joined(number, drop))
        self.step()

    def hear_result(self, wid: str, result: Result) -> None:
        rows = unpack(SHAPE.empty(result.n), RESULT, result.columns, SHAPE)
        settled = self.dispatch.settle(wid, result, rows, self.world.now)
        if settled.superseded is not None:
            worker, batch = self.world.workers[settled.superseded], result.batch
            self.world.send(worker, lambda: worker.work.pop(batch, None))
        if settled.kind is Settlement.FRESH:
            self.fresh[result.batch] += 1
            assert settled.rows is not None
            final = self.pipeline.settle(settled.rows, settled.cpu_seconds, settled.failures)
            for failure in final.failures:
                assert failure.reason == "the child aborted"
                assert final.rows[failure.row]["outcome"] == Outcome.ERROR
            self.outbox.push(final)
        self.step()

    def hear_recorded(self, durable: int) -> None:
        try:
            self.outbox.durable(durable, self.world.now)
        except RecorderFellBack:
            self.world.crash()
        self.step()

    def hear_token(self, wid: str, alive: bool) -> None:
        change = self.dispatch.back if alive else self.dispatch.gone
        change(wid, self.world.now)
        self.step()

    def recorder_up(self) -> None:
        if self.is_alive:
            self.outbox.recorder_up(self.world.now)
            self.step()

    def check(self) -> None:
        """What holds at the end of every life."""
        assert all(times == 1 for times in self.fresh.values())


class World:
    """One history."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.now = 0.0
        self.chance = random.Random(plan.seed)  # noqa: S311 - dice, not secrets
        self.evaluated: Counter[bytes] = Counter()
        """How often each batch was evaluated."""
        self.epoch = 1
        self.link_is_up = True
        self.workers: dict[str, Worker] = {}
        self.recorder = Recorder(self)
        self.coordinator = Coordinator(self, self.epoch, SHAPE.empty(0))
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()
        self._hiccups: Counter[bytes] = Counter()
        self._token_at: dict[str, float] = {}

    @property
    def is_over(self) -> bool:
        return self.coordinator.is_done and self._is_recorded

    @property
    def _is_recorded(self) -> bool:
        return self.recorder.durable == self.coordinator.outbox.confirmed

    def _resume_if_lost(self) -> None:
        """An older disk may come back when all is done: then somebody resumes the run."""
        if self.coordinator.is_done and not self._is_recorded:
            self.crash()

    def run(self) -> bytes:
        """Play the history to its end; the recorder's journal."""
        for _ in range(self.plan.workers):
            self.start_worker()
        self.recorder.repeat()
        self._plan_faults()
        self.coordinator.step()
        while not self.is_over:
            self.now, _, call = heapq.heappop(self._events)
            assert self.now < PATIENCE, "the history is stuck"
            call()
            self._resume_if_lost()
        self.coordinator.check()
        return self.recorder.journal[: self.recorder.durable].tobytes()

    # The bus.

    def later(self, seconds: float, call: Callable[[], None]) -> None:
        heapq.heappush(self._events, (self.now + seconds, next(self._count), call))

    def wait(self) -> float:
        """How long a message takes."""
        if self.chance.random() < self.plan.stall:
            return self.chance.uniform(0, 15)
        return self.chance.expovariate(1 / self.plan.delay)

    def send(self, worker: Worker | None, call: Callable[[], None]) -> None:
        """Between the coordinator and a worker, or the recorder (None): lost, late or twice."""
        is_up = self.link_is_up and (worker is None or (worker.is_alive and worker.is_linked))
        if is_up and self.chance.random() >= self.plan.loss:
            self.later(self.wait(), call)
            if self.chance.random() < self.plan.repeat:
                self.later(self.wait(), call)

    def token(self, wid: str, alive: bool) -> None:
        """Tokens are kept by the router: heard late, but all of them and in order."""
        self._token_at[wid] = max(self.now + self.wait(), self._token_at.get(wid, 0.0))
        self.later(self._token_at[wid] - self.now, lambda: self._hear_token(wid, alive))

    def _hear_token(self, wid: str, alive: bool) -> None:
        if self.coordinator.is_alive:
            self.coordinator.hear_token(wid, alive)

    def hear_join(self, worker: Worker, number: int, held: list[bytes]) -> None:
        if self.coordinator.is_alive:
            self.coordinator.hear_join(worker, number, held)

    def hear_result(self, wid: str, result: Result) -> None:
        if self.coordinator.is_alive:
            self.coordinator.hear_result(wid, result)

    def hear_recorded(self, epoch: int, durable: int) -> None:
        if self.coordinator.is_alive and epoch == self.coordinator.epoch:
            self.coordinator.hear_recorded(durable)

    # What goes wrong.

    def hiccup(self, row: bytes) -> bool:
        if self._hiccups[row] < 2 and self.chance.random() < self.plan.hiccup:
            self._hiccups[row] += 1
            return True
        return False

    def _plan_faults(self) -> None:
        """Draw the times of all faults."""
        faults: dict[Callable[[], None], float] = {
            self.flap: self.plan.flap,
            self.kill: self.plan.kill,
            self.turn_zombie: self.plan.zombie,
            self.break_link: self.plan.link,
            self.crash: self.plan.crash,
            lambda: self._recorder_fails(old_disk=False): self.plan.recorder_crash,
            lambda: self._recorder_fails(old_disk=True): self.plan.restore,
        }
        for fault, rate in faults.items():
            at = self.chance.expovariate(rate) if rate else float("inf")
            while at < self.plan.calm_after:
                self.later(at, fault)
                at += self.chance.expovariate(rate)

    def start_worker(self) -> None:
        worker = Worker(self, f"{len(self.workers):032x}")
        self.workers[worker.wid] = worker
        self.token(worker.wid, True)
        worker.join()

    def _some_worker(self) -> Worker | None:
        well = [w for w in self.workers.values() if w.is_alive and not w.is_zombie and w.is_linked]
        return self.chance.choice(well) if well else None

    def flap(self) -> None:
        if worker := self._some_worker():
            worker.is_linked = False
            self.token(worker.wid, False)
            self.later(self.chance.uniform(0, 3), lambda: self._relink(worker))

    def _relink(self, worker: Worker) -> None:
        worker.is_linked = True
        if worker.is_alive:
            self.token(worker.wid, True)
            worker.join()

    def kill(self) -> None:
        if worker := self._some_worker():
            worker.is_alive = False
            self.token(worker.wid, False)
            self.later(self.chance.uniform(0.5, 3), self.start_worker)

    def turn_zombie(self) -> None:
        if worker := self._some_worker():
            worker.is_zombie = True
            self.start_worker()
            if self.chance.random() < 0.5:
                self.later(self.chance.uniform(1, 30), lambda: self._wake(worker))

    def _wake(self, worker: Worker) -> None:
        worker.is_zombie = False
        worker.busy = False
        worker._begin()

    def break_link(self) -> None:
        if self.link_is_up:
            self._set_link(False)
            self.later(self.chance.uniform(0.5, 20), lambda: self._set_link(True))

    def _set_link(self, up: bool) -> None:
        self.link_is_up = up
        if self.coordinator.is_alive:
            self.coordinator.dispatch.link(up, self.now)
            self.coordinator.step()
        for worker in self.workers.values():
            if worker.is_alive and worker.is_linked:
                self.token(worker.wid, up)

    def crash(self) -> None:
        """The coordinator dies; another one opens the journal as soon as there is a recorder."""
        if self.coordinator.is_alive:
            self.coordinator.check()
            self.coordinator.is_alive = False
            self.later(self.chance.uniform(0.1, 2), self._restart)

    def _restart(self) -> None:
        if not self.recorder.is_alive:
            self.later(0.5, self._restart)
            return
        self.epoch += 1
        self.recorder.commit()
        self.coordinator = Coordinator(self, self.epoch, self.recorder.journal.copy())
        self.coordinator.dispatch.link(self.link_is_up, self.now)
        self.coordinator.step()
        for worker in self.workers.values():
            if worker.is_alive and not worker.is_zombie:
                self.later(self.wait(), worker.join)

    def _recorder_fails(self, *, old_disk: bool) -> None:
        if self.recorder.is_alive:
            durable = self.recorder.durable
            self.recorder.restart(self.chance.randint(0, durable) if old_disk else durable)
