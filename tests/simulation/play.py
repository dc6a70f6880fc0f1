"""Plays histories: from a number to a verdict, with the faults that are drawn for it."""

import logging
import random
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import chain
from unittest.mock import patch

import structlog
from tests.simulation.coordinator import Coordinator
from tests.simulation.invariants import InvariantViolated
from tests.simulation.plan import History, some_history
from tests.simulation.process import Process
from tests.simulation.recorder import SimulatedRecorder
from tests.simulation.simulation import P, Simulation, SimulationChecker
from tests.simulation.worker import Worker

from qdgrasp_coordinator.recorder import run_writer
from qdgrasp_coordinator.scheduler import batch_dispatcher, recorder_client


class Faults:
    """Injects the faults of a simulation until it is calm."""

    def __init__(self, stage: Simulation) -> None:
        self._stage = stage
        self._world = stage.world
        self._chance = stage.world.chance
        self.table: dict[str, Callable[[], None]] = {
            "a worker is killed": lambda: self._kill(Worker),
            "a worker's machine loses its power": lambda: self._strike_some(Worker, Worker.lose_power),
            "a worker is asked to leave": lambda: self._strike_some(Worker, Worker.leave),
            "a worker joins": stage.start_worker,
            "a worker is frozen": lambda: self._freeze(Worker),
            "a simulator is killed": lambda: self._strike_some(Worker, Worker.lose_simulator),
            "a link is cut": lambda: self._cut(0.0),
            "half of the links are cut": lambda: self._cut(0.5),
            "the router restarts": self._restart_router,
            "the coordinator is killed": lambda: self._kill(Coordinator),
            "the coordinator is frozen": self._freeze_coordinator,
            "the coordinator is frozen and replaced": self._replace_coordinator,
            "another coordinator is started": stage.start_coordinator,
            "the recorder is killed": lambda: self._kill(SimulatedRecorder),
            "the recorder is frozen": lambda: self._freeze(SimulatedRecorder),
            "another recorder is started": stage.start_recorder,
            "everything is killed": self._kill_all,
            "the disk is full": self._fill_disk,
            "the disk is replaced by an older copy": self._restore_disk,
            "results are forged": stage.start_forger,
            "old messages are repeated": self._repeat,
            "every simulator fails for a while": self._fail_all,
        }

    def plan(self) -> None:
        """Draw the times of all faults."""
        end = self._stage.history.calm_after
        for name, rate in self._stage.history.faults.items():
            at = self._chance.expovariate(rate)
            while at < end:
                self._world.at(at, lambda name=name: self._strike(name))  # type: ignore[misc]
                at += self._chance.expovariate(rate)
        self._world.at(end, self._calm)

    def _strike(self, name: str) -> None:
        self._world.note("fault", name)
        self.table[name]()

    def _calm(self) -> None:
        self._world.note("fault", "none any more")
        self._stage.is_calm = True
        self._stage.calm_since = self._world.now

    def _strike_some(self, kind: type[P], act: Callable[[P], None]) -> None:
        if process := self._stage.some(kind):
            act(process)

    def _kill(self, kind: type[Process]) -> None:
        self._strike_some(kind, lambda process: process.end(flushed=self._chance.random() < 0.5))

    def _freeze(self, kind: type[Process]) -> None:
        if process := self._stage.some(kind):
            process.freeze(self._chance.choice([0.5, 3.0, 8.0, 20.0]) * self._chance.uniform(0.5, 1.5))

    def _cut(self, share: float) -> None:
        """Cut one link, or a share of all."""
        sessions = self._stage.network.sessions
        n = max(1, int(share * len(sessions)))
        for session in self._chance.sample(sessions, min(n, len(sessions))):
            self._stage.network.cut(
                session, self._chance.choice([0.3, 3.0, 10.0]) * self._chance.uniform(0.5, 1.5)
            )

    def _restart_router(self) -> None:
        if not self._stage.history.is_embedded:
            self._stage.network.restart(self._chance.uniform(0.05, 3.0))

    def _freeze_coordinator(self) -> None:
        """Freeze a coordinator, and with it the router where that is in its process."""
        coordinator = self._stage.some(Coordinator)
        if coordinator is None:
            return
        seconds = self._chance.choice([0.5, 3.0, 10.0]) * self._chance.uniform(0.5, 1.5)
        coordinator.freeze(seconds)
        for session in self._stage.network.sessions if self._stage.history.is_embedded else ():
            self._stage.network.cut(session, seconds)

    def _replace_coordinator(self) -> None:
        self._freeze_coordinator()
        self._world.later(self._chance.uniform(0, 8), self._stage.start_coordinator)

    def _kill_all(self) -> None:
        """Kill the coordinator, the recorder and half of the workers together."""
        workers = [worker for worker in self._stage.of(Worker) if self._chance.random() < 0.5]
        for process in chain(self._stage.of(Coordinator), self._stage.of(SimulatedRecorder), workers):
            process.end(flushed=self._chance.random() < 0.5)

    def _repeat(self) -> None:
        """Repeat an old message, except work: only the coordinator may send that."""
        recent = [entry for entry in self._stage.network.recent if "/@work/" not in entry[0].key]
        if recent:
            self._stage.network.repeat(*self._chance.choice(recent))

    def _fail_all(self) -> None:
        """Have every simulator fail on every row for a while, once."""
        failures = self._stage.failures
        if failures.down_until == 0.0:
            failures.down_until = self._world.now + self._chance.uniform(5.0, 60.0)

    def _fill_disk(self) -> None:
        disk = self._stage.disk
        if not disk.is_full:
            disk.is_full = True
            self._world.later(self._chance.uniform(1, 30), disk.make_room)

    def _restore_disk(self) -> None:
        """Stop the recorder, and put back an older copy of its disk."""
        for recorder in self._stage.of(SimulatedRecorder):
            recorder.end()
        self._stage.disk.restore(self._chance)


SMALL_BOUNDS = [
    (recorder_client, "MESSAGE_ROWS", 4),
    (recorder_client, "MOST_UNCONFIRMED", 8),
    (recorder_client, "REPLAY_ROWS", 7),
    (batch_dispatcher, "MOST_SETTLED", 30),
    (run_writer, "GROUP_ROWS", 6),
    (run_writer, "MOST_WAITING", 150),
]
"""Bounds that small histories reach."""


@dataclass
class Verdict:
    """Result of a history."""

    history: History
    violated: InvariantViolated | None = None
    seconds: float = 0.0
    """Its duration in its world."""
    events: int = 0
    counters: dict[str, int] = field(default_factory=dict)
    """The counters of the last coordinator's dispatcher."""
    journals: dict[str, bytes] = field(default_factory=dict)
    """The bytes on the disk of each run."""
    trace: list[str] = field(default_factory=list)


@contextmanager
def small_and_quiet() -> Iterator[None]:
    """Bounds that small histories reach, and no logs."""
    quiet = structlog.make_filtering_bound_logger(logging.CRITICAL)
    before = structlog.get_config()
    structlog.configure(wrapper_class=quiet, cache_logger_on_first_use=False)
    try:
        with ExitStack() as stack:
            for module, name, value in SMALL_BOUNDS:
                stack.enter_context(patch.object(module, name, value))
            yield
    finally:
        structlog.configure(**before)


def play(history: History | int, *, trace: bool = False) -> Verdict:
    """Play a history to its end, or to the first violation."""
    if isinstance(history, int):
        history = some_history(history)
    with small_and_quiet():
        return _play(history, trace)


def _play(history: History, trace: bool) -> Verdict:
    random.seed(history.number)  # the jitter of workers
    stage = Simulation(history)
    checker = SimulationChecker(stage)
    world = stage.world
    world.check = checker.check
    world.trace = [] if trace else None
    verdict = Verdict(history)
    try:
        stage.open()
        Faults(stage).plan()
        world.run(lambda: stage.is_over)
    except InvariantViolated as violated:
        verdict.violated = violated
    except Exception as error:  # noqa: BLE001 - whatever it is, a machine failed
        verdict.violated = InvariantViolated("no machine fails", f"{type(error).__name__}: {error}")
        verdict.violated.__cause__ = error
    verdict.seconds, verdict.events, verdict.trace = world.now, world.events, world.trace or []
    coordinators = stage.of(Coordinator, living=False)
    verdict.counters = coordinators[-1].scheduler.dispatcher.counters if coordinators else {}
    verdict.journals = {run: file.journal for run, file in stage.disk.files.items()}
    return verdict
