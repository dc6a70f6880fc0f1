"""Measures a scene on this machine: a job on a local bus, with workers as in every run."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from benchmarks.benchmark_figures import (
    BENCH_PRIOR,
    PoseRegime,
    RegimeRate,
    RegimeSearch,
    SceneFigures,
    ThroughputMeter,
    peak_memory,
    regime_rate,
    run_seconds,
    scaling,
)

from qdgrasp_assets.genes import layout
from qdgrasp_coordinator.scheduler.coordinator_service import CoordinatorService
from qdgrasp_coordinator.scheduler.pipeline import Flight, Pipeline
from qdgrasp_coordinator.scheduler.recorder_client import MemorySink
from qdgrasp_coordinator.scheduler.run_plan import RunPlan, SingleRunQueue
from qdgrasp_coordinator.storage.journal_slice import JournalSlice
from qdgrasp_coordinator.storage.run_folder import PreparedScene
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.supervisor import ProcessSupervisor
from qdgrasp_protocol.text import counted
from qdgrasp_tools.local.progress import ProgressDisplay
from qdgrasp_tools.local.restart_policy import JobRestarts, start_worker

BENCH_JOB = "bench"
ENDLESS = 10**9
IN_FLIGHT = 4  # Generations in flight: no worker waits for another one's batch
GENERATION_SECONDS = 0.2  # Time that a generation is to take all workers [s]
LEAST_GENOMES, MOST_GENOMES = 4, 1024  # Genomes in a generation, for each worker
_END = object()


class PlatformSink(MemorySink):
    """A sink that keeps the platform, and no row."""

    def push(self, part: JournalSlice) -> None:
        """Drop the rows."""


@dataclass(frozen=True)
class SceneMeasurement:
    """Results of a measurement."""

    figures: SceneFigures
    platform: dict[str, str]


class SceneBenchmark:
    """A measurement of one scene with 1 to `workers` processes, `seconds` for each regime."""

    def __init__(
        self,
        spec: RunSpec,
        prepared: PreparedScene,
        *,
        workers: int,
        seconds: float,
        display: ProgressDisplay,
    ) -> None:
        self._spec = spec
        self._most = workers
        self._seconds = seconds
        self._display = display
        self._search = RegimeSearch(layout(prepared.scene, BENCH_PRIOR))
        self._meter = ThroughputMeter()
        self._rates: list[RegimeRate] = []
        self._start_seconds = 0.0
        self._memory = 0
        self._started = 0
        self._plan = RunPlan.of(
            spec,
            prepared,
            lambda shape: Pipeline(self._search, shape, ENDLESS, "count", Flight(IN_FLIGHT)),
            BENCH_PRIOR,
        )
        self._sink = PlatformSink(self._plan.shape)

    def run(
        self, bus: Bus, endpoint: str, processes: ProcessSupervisor, stop: Stop
    ) -> SceneMeasurement | None:
        """Measure on a bus whose router listens on `endpoint`; None where it was asked to stop.

        Raises InputError if a worker cannot work here; the reason is its own.
        """
        over = Stop()  # of this job alone
        stop.tell(lambda: over.set(0))
        restarts, steps = JobRestarts(processes, self._display), self._steps(processes, endpoint)

        def step(now: float) -> None:
            restarts.note_progress(service.status(now))
            restarts.check(now)
            if next(steps, _END) is _END:
                over.set(0)

        queue = SingleRunQueue(lambda: self._plan, ENDLESS)
        service = CoordinatorService(bus, over, job=BENCH_JOB, queue=queue, make_sink=lambda _: self._sink)
        with bus.subscribe(Keys(BENCH_JOB).result(), self._meter.add):
            service.run(step)
        if stop.is_set:
            return None
        figures = SceneFigures(
            gripper=self._spec.gripper,
            object=self._spec.object,
            protocol=self._spec.protocol,
            start_seconds=self._start_seconds,
            memory_bytes=self._memory,
            rates=self._rates,
            scaling=scaling(self._rates),
            run_seconds=run_seconds(self._rates),
        )
        return SceneMeasurement(figures, self._sink.platform)

    def _steps(self, processes: ProcessSupervisor, endpoint: str) -> Iterator[None]:
        """Carry out the measurement step by step; yield where there is something to wait for."""
        began = time.monotonic()
        self._start_workers(processes, endpoint, 1)
        yield from _wait_until(lambda: self._meter.has_begun)
        self._start_seconds = time.monotonic() - began
        yield from _wait_until(lambda: self._search.has_parents)
        near = [PoseRegime.NEAR] if len(self._search.parents) else []
        for workers in sorted({1, self._most}):
            self._start_workers(processes, endpoint, workers)
            for regime in [PoseRegime.ANYWHERE, *near]:
                yield from self._measure(regime, workers)
        self._memory = max(map(peak_memory, processes.pids().values()), default=0)

    def _start_workers(self, processes: ProcessSupervisor, endpoint: str, workers: int) -> None:
        for number in range(self._started, workers):
            start_worker(processes, number, lambda: ["--connect", endpoint, "--job", BENCH_JOB])
        self._started = workers

    def _measure(self, regime: PoseRegime, workers: int) -> Iterator[None]:
        """Measure one regime once every worker has given a result of it."""
        search, meter, began = self._search, self._meter, time.monotonic()
        search.start_regime(regime, LEAST_GENOMES * workers)
        while meter.workers(search.since) < workers:
            yield
        begin = time.monotonic()
        while (
            time.monotonic() < begin + self._seconds
            or meter.throughput(search.since, begin).workers < workers
        ):
            rate = meter.rows(search.since) / (time.monotonic() - began)
            search.population = round(
                min(max(GENERATION_SECONDS * rate, LEAST_GENOMES * workers), MOST_GENOMES * workers)
            )
            yield
        found = regime_rate(regime, workers, meter.throughput(search.since, begin))
        self._rates.append(found)
        words = f"{counted(workers, 'worker')}, {regime.value}: {found.per_second:,.1f}/s"
        self._display.say(f"{self._spec.gripper} on {self._spec.object}, {words}")


def _wait_until(condition: Callable[[], bool]) -> Iterator[None]:
    while not condition():
        yield
