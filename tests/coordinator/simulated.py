"""A simulated world: coordinator, workers and recorder on a bus that loses, repeats, delays and reorders.

Time is a number, events are calls in a heap, all chance comes from one seed: a history is a function of its
`Plan`. `plans.reference` gives the journal that every history must end with.
"""

import heapq
import itertools
import random
from collections import Counter
from collections.abc import Callable

from tests.coordinator.participants import Coordinator, Recorder, Worker
from tests.coordinator.plans import Plan

from qdgrasp_protocol.messages import Result

PATIENCE = 20_000.0
"""Simulated seconds after which a history counts as stuck."""


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
        self.recorder = Recorder(self, plan.task.shape.empty(0))
        self.coordinator = Coordinator(self, self.epoch, plan.task.shape.empty(0))
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
