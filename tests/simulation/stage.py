"""The stage of a history: its world, its processes, and the keeper that starts again what has ended."""

import hashlib
from functools import lru_cache
from math import inf
from typing import TYPE_CHECKING, TypeVar

from tests.coordinator.runs.plans import Plan, reference
from tests.simulation.coordinator import Coordinator
from tests.simulation.formula import Mishaps, Speed
from tests.simulation.network import Network
from tests.simulation.paper import Disk
from tests.simulation.plan import History
from tests.simulation.process import Process
from tests.simulation.recorder import Recorder
from tests.simulation.searching import Watched
from tests.simulation.worker import Forger, Worker
from tests.simulation.world import World

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.counts.goals import Goals
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.runs.pipeline import Pipeline
from qdgrasp_protocol.spec import RunSpec, to_toml

if TYPE_CHECKING:
    from tests.simulation.watch import Watch

LOOK = 1.0
"""The keeper looks so often [s]."""
P = TypeVar("P", bound=Process)


@lru_cache(maxsize=256)
def journal_of(plan: Plan) -> bytes:
    """The journal of a run that nothing disturbs."""
    return reference(plan)


class Stage:
    """Everything that takes part in a history."""

    def __init__(self, history: History) -> None:
        self.history = history
        self.world = World(history.number)
        self.network = Network(self.world, history.terms)
        self.disk = Disk()
        self.mishaps = Mishaps(self.world.chance, history.hiccup)
        self.processes: list[Process] = []
        self.task = history.runs[0].task
        """What is evaluated, the same in all runs."""
        names = ["run"] if len(history.runs) == 1 else [f"run-{n}" for n in range(len(history.runs))]
        self.plans = dict(zip(names, history.runs, strict=True))
        self.journals = {run: journal_of(plan) for run, plan in self.plans.items()}
        """What each run's journal is to be."""
        self.lengths = {
            run: len(journal) // self.task.shape.dtype.itemsize for run, journal in self.journals.items()
        }
        self.is_done = False
        """A coordinator has carried out all runs."""
        self.is_calm = False
        """Nothing goes wrong any more."""
        self.calm_since = inf
        self.watch: Watch
        """Set by the watch itself."""
        self._started = 0
        if history.is_embedded:
            self.network.go_down()

    def open(self) -> None:
        """Start the processes of the beginning, in any order."""
        for start in [
            self.start_recorder,
            self.start_coordinator,
            *[self.start_worker] * self.history.workers,
        ]:
            self.world.later(self.world.chance.uniform(0, 2), start)
        self.world.later(2.0, self._keep)

    # How far it is.

    @property
    def is_over(self) -> bool:
        """All runs are on the disk, and a coordinator knows."""
        return self.is_done and self.is_recorded

    @property
    def is_recorded(self) -> bool:
        """All runs are on the disk."""
        return self.disk.counts() == self.lengths

    @property
    def calm_seconds(self) -> float:
        """How long nothing went wrong."""
        return max(0.0, self.world.now - self.calm_since)

    @property
    def is_lossy(self) -> bool:
        """Messages are lost, repeated or overtaken even on links that hold."""
        terms = self.history.terms
        repeats = terms.repeat or "old messages are repeated" in self.history.faults
        return bool(terms.loss or repeats or terms.stall or not terms.in_order)

    # Who is there.

    def of(self, kind: type[P], *, living: bool = True) -> list[P]:
        """The processes of a kind."""
        return [p for p in self.processes if isinstance(p, kind) and not (living and p.is_over)]

    def some(self, kind: type[P]) -> P | None:
        """Any one of the running processes of a kind; None where there is none."""
        running = [process for process in self.of(kind) if process.is_running]
        return self.world.chance.choice(running) if running else None

    # Processes are started.

    def start_forger(self) -> None:
        """Start somebody who forges results."""
        self.processes.append(Forger(self.world, self.network, f"{self._next():032x}"))

    def start_worker(self) -> None:
        """Start a worker on a machine that may be slow."""
        history, wid = self.history, f"{self._next():032x}"
        slowness = history.spread ** self.world.chance.random()
        speed = Speed(
            history.row_seconds * slowness / history.spread**0.5, self.world.chance.choice([1, 2, 16])
        )
        self.processes.append(Worker(self.world, self.network, wid, self.task, self.mishaps, speed))

    def start_recorder(self) -> None:
        """Start a recorder; while another one holds the folder it waits."""
        name = f"recorder {self._next()}"
        recorder = Recorder(
            self.world,
            self.network,
            name,
            self.disk,
            self.history.latency,
            opened=self.watch.opened,
            reports=self.watch.reported,
        )
        self.processes.append(recorder)

    def start_coordinator(self) -> None:
        """Start a coordinator; the router may be in it."""
        if self.history.is_embedded:
            if self.of(Coordinator):
                return
            self.network.come_up()
        name = f"coordinator {self._next()}"
        coordinator = Coordinator(
            self.world,
            self.network,
            name,
            list(self.plans),
            self._assignment,
            self.history.batch_size,
            met=self.watch.began,
        )
        coordinator.session.is_local = self.history.is_embedded
        self.processes.append(coordinator)

    def _next(self) -> int:
        self._started += 1
        return self._started

    def _assignment(self, run: str) -> Assignment:
        """A run, with a new search."""
        plan, digest = self.plans[run], hashlib.sha256(run.encode()).hexdigest()
        spec = to_toml(RunSpec(gripper="hand", object="thing", seed=plan.seed, evaluations=plan.evaluations))
        search, shape = Watched(plan.task.search(plan.population, plan.seed), plan.in_flight), self.task.shape
        goals = Goals(plan.successes, plan.no_new_cell)
        budget = (plan.evaluations, plan.overlaps, plan.in_flight, plan.trials)
        pipeline = Pipeline(search, shape, *budget, goals)
        return Assignment(run, spec.encode(), Bundle(b"", digest), "none", shape, pipeline, plan.evaluations)

    # What has ended is started again.

    def _keep(self) -> None:
        """Look after the processes, as init systems and people do."""
        chance = self.world.chance
        if not self.of(Recorder) and chance.random() < 0.5:
            self.start_recorder()
        if not self.of(Coordinator):
            if self.history.is_embedded:
                self.network.go_down()
            if chance.random() < 0.5:
                self.start_coordinator()
        wanted = 1 if self.is_calm else self.history.workers
        if len(self.of(Worker)) < wanted and chance.random() < 0.4:
            self.start_worker()
        self.world.later(LOOK, self._keep)
