"""The course of a measurement: a job on the bus of this machine, with workers as every run has them.

One worker first, then all. What is measured is what a run gets: processes started by the supervisor's crew,
batches leased by the coordinator, results sent back.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import Bundle, Scene
from qdgrasp_coordinator.bench.figures import Pace, SceneFigures, pace, run_seconds, scaling
from qdgrasp_coordinator.bench.node import peak_memory
from qdgrasp_coordinator.bench.regimes import PRIOR, Regime, Regimes
from qdgrasp_coordinator.bench.stopwatch import Stopwatch
from qdgrasp_coordinator.campaigns.programme import Single
from qdgrasp_coordinator.counts.stretch import Stretch
from qdgrasp_coordinator.folders.job_folder import RUN
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.runs.pipeline import Pipeline
from qdgrasp_coordinator.runs.preparation import scene_shape
from qdgrasp_coordinator.serving.record import Memory
from qdgrasp_coordinator.serving.service import CoordinatorService
from qdgrasp_coordinator.watching.progress import Display
from qdgrasp_coordinator.watching.watch import Watch
from qdgrasp_coordinator.watching.workers import hire_worker
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.crew import Crew
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.rows import Shape
from qdgrasp_protocol.spec import RunSpec, to_toml

JOB = "bench"
ENDLESS = 10**9
IN_FLIGHT = 4
"""Generations in flight: no worker waits for another one's batch."""
AHEAD = 0.2
"""What a generation is to take all workers [s]."""
FEWEST, MOST = 4, 1024
"""Genomes in a generation, for each worker."""
_END = object()


class Unkept(Memory):
    """A record that keeps the platform, and no row."""

    def __init__(self, shape: Shape) -> None:
        super().__init__(shape)
        self.platform: dict[str, str] = {}

    def push(self, stretch: Stretch) -> None:
        """Rows are of no use here."""

    def set_platform(self, platform: dict[str, str]) -> None:
        """Keep what the workers' results come from."""
        self.platform = platform


@dataclass(frozen=True)
class Measured:
    """What came of a course."""

    figures: SceneFigures
    platform: dict[str, str]


class Course:
    """A measurement of one scene.

    Parameters
    ----------
    workers
        How many processes there are in the end, 1 or more.
    seconds
        How long each regime is measured.
    """

    def __init__(
        self, spec: RunSpec, scene: Scene, bundle: Bundle, *, workers: int, seconds: float, display: Display
    ) -> None:
        self._spec = spec
        self._most = workers
        self._seconds = seconds
        self._display = display
        self._search = Regimes(layout(scene, PRIOR))
        self._stopwatch = Stopwatch()
        self._paces: list[Pace] = []
        self._start_seconds = 0.0
        self._memory = 0
        self._hired = 0
        shape = scene_shape(scene, PRIOR)
        self._record = Unkept(shape)
        pipeline = Pipeline(self._search, shape, ENDLESS, "count", IN_FLIGHT)
        self._assignment = Assignment(RUN, to_toml(spec).encode(), bundle, PRIOR, shape, pipeline, ENDLESS)

    def run(self, bus: Bus, endpoint: str, crew: Crew, stop: Stop) -> Measured | None:
        """Carry it out on a bus whose router listens on `endpoint`; None where it was asked to stop.

        Raises
        ------
        InputError
            A worker cannot work here; the reason is its own.
        """
        over = Stop()  # of this job alone
        stop.tell(lambda: over.set(0))
        watch, steps = Watch(crew, self._display), self._steps(crew, endpoint)

        def look(now: float) -> None:
            watch.progressed(service.figures(now))
            watch.look(now)
            if next(steps, _END) is _END:
                over.set(0)

        programme = Single(lambda: self._assignment, ENDLESS)
        service = CoordinatorService(
            bus, over, job=JOB, programme=programme, make_record=lambda _: self._record
        )
        with bus.subscribe(Keys(JOB).result(), self._stopwatch.take):
            service.run(look)
        return None if stop.is_set else Measured(self._figures, self._record.platform)

    def _steps(self, crew: Crew, endpoint: str) -> Iterator[None]:
        """What is done, one after the other; it yields where there is something to wait for."""
        began = time.monotonic()
        self._hire(crew, endpoint, 1)
        yield from _until(lambda: self._stopwatch.has_begun)
        self._start_seconds = time.monotonic() - began
        yield from _until(lambda: self._search.has_looked)
        for workers in sorted({1, self._most}):
            self._hire(crew, endpoint, workers)
            for regime in self._regimes:
                yield from self._measure(regime, workers)
        self._memory = max(map(peak_memory, crew.pids().values()), default=0)

    def _hire(self, crew: Crew, endpoint: str, workers: int) -> None:
        """Hire what is missing to so many workers."""
        for number in range(self._hired, workers):
            hire_worker(crew, number, ["--connect", endpoint, "--job", JOB])
        self._hired = workers

    @property
    def _regimes(self) -> list[Regime]:
        return [Regime.ANYWHERE, Regime.NEAR] if len(self._search.parents) else [Regime.ANYWHERE]

    def _measure(self, regime: Regime, workers: int) -> Iterator[None]:
        """Measure one regime from when all workers are at it."""
        search, stopwatch, began = self._search, self._stopwatch, time.monotonic()
        search.turn(regime, FEWEST * workers)
        while stopwatch.workers(search.since) < workers:
            yield
        begin = time.monotonic()
        while (
            time.monotonic() < begin + self._seconds or stopwatch.lap(search.since, begin).workers < workers
        ):
            rate = stopwatch.rows(search.since) / (time.monotonic() - began)
            search.population = round(min(max(AHEAD * rate, FEWEST * workers), MOST * workers))
            yield
        found = pace(regime, workers, stopwatch.lap(search.since, begin))
        self._paces.append(found)
        words = f"{workers} worker{'' if workers == 1 else 's'}, {regime.value}: {found.per_second:,.1f}/s"
        self._display.say(f"{self._spec.gripper} on {self._spec.object}, {words}")

    @property
    def _figures(self) -> SceneFigures:
        return SceneFigures(
            gripper=self._spec.gripper,
            object=self._spec.object,
            protocol=self._spec.protocol,
            start_seconds=self._start_seconds,
            memory_bytes=self._memory,
            paces=self._paces,
            scaling=scaling(self._paces),
            run_seconds=run_seconds(self._paces),
        )


def _until(condition: Callable[[], bool]) -> Iterator[None]:
    while not condition():
        yield
