"""Rates of a coordinator: genomes, sessions and rows per second."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from benchmarks.benchmark_figures import BENCH_METHOD
from benchmarks.measure import spread
from benchmarks.node_benchmark import PlatformSink, SceneBenchmark
from benchmarks.scale.rig import (
    ENDLESS,
    JOB,
    SHAPE,
    CoordinatorMeasurement,
    ScaleFigure,
    StandInGroup,
    coordinate,
    make_run_plan,
    resident,
    router,
    start_stand_ins,
)
from tests.coordinator.search.synthetic_scene import plain

from qdgrasp_coordinator.scheduler.recorder_client import RecorderClient
from qdgrasp_coordinator.scheduler.run_plan import (
    RUN_DEFAULTS,
    RunPlan,
    full_spec,
    plan_run,
    prepare_scene,
)
from qdgrasp_coordinator.scheduler.run_registry import ActiveRun
from qdgrasp_coordinator.search.base import SearchAlgorithm
from qdgrasp_coordinator.search.registry import method
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.rows import Genomes, Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.supervisor import ProcessSupervisor
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.local.progress import LineProgress

WORKERS = 8
BATCH = 64
POPULATION = 512
IN_FLIGHT = 4
WARM_UP = 1.0
"""Seconds before anything is counted."""


class ConstantSearch:
    """A search that asks the same genomes again and again, and learns nothing."""

    def __init__(self, population: int) -> None:
        self._genomes = np.random.default_rng(0).uniform(-1, 1, (population, SHAPE.genes)).astype(np.float32)

    def ask(self, generation: int) -> Genomes:
        return self._genomes

    def tell(self, generation: int, rows: Rows) -> None:
        """Ignore the rows."""


def spec(method: str, population: int, evaluations: int = ENDLESS) -> RunSpec:
    return RunSpec(
        gripper="panda", object="mug", method=method, population=population, evaluations=evaluations
    )


def measure_dispatch(seconds: float) -> Iterator[ScaleFigure]:
    runs = [make_run_plan("run", spec("contact_rand", POPULATION), ConstantSearch(POPULATION), IN_FLIGHT)]
    with router() as (endpoint, _), start_stand_ins([StandInGroup(endpoint, JOB, WORKERS)]) as stand_ins:
        measurement = CoordinatorMeasurement(stand_ins, runs, WARM_UP, seconds)
        coordinate(endpoint, runs, lambda _: lambda run: PlatformSink(run.shape), measurement, BATCH)
    found = measurement.window
    remark = f"{found.per_batch:.0f} us of CPU a batch, threads of the bus included"
    yield ScaleFigure(
        "batches of 64 genomes a second", found.batches / found.seconds, "/s", 5_000, remark=remark
    )
    yield ScaleFigure("genomes a second", found.rows / found.seconds, "/s", 300_000)
    yield ScaleFigure("CPU of a genome", found.microseconds, "us")
    room = 1e6 / found.microseconds
    yield ScaleFigure("genomes in a CPU second", room, "/s", remark="what the coordinator's own core allows")


METHODS = {"contact_me_scs": (500, 4.0), "cma_mae": (540, 30.0), "contact_rand": (500, None)}
"""Genomes in a generation, and the most that one may cost [us]."""


class CallSeconds:
    """CPU time of this thread within calls."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def timed(self, call: Callable[..., Any]) -> Callable[..., Any]:
        """The call, with its time added to these seconds."""

        def run(*arguments: Any, **named: Any) -> Any:
            began = time.thread_time()
            try:
                return call(*arguments, **named)
            finally:
                self.seconds += time.thread_time() - began

        return run


class ProfiledSearch:
    """A search whose time is counted, and pyribs' own in it."""

    def __init__(self, search: SearchAlgorithm) -> None:
        self.whole, self.ribs, self.rows = CallSeconds(), CallSeconds(), 0
        for part, names in _parts_of_ribs(search):
            for name in names:
                setattr(part, name, self.ribs.timed(getattr(part, name)))
        self._ask, self._tell = self.whole.timed(search.ask), self.whole.timed(search.tell)

    def ask(self, generation: int) -> Genomes:
        return self._ask(generation)  # type: ignore[no-any-return]

    def tell(self, generation: int, rows: Rows) -> None:
        self.rows += len(rows)
        self._tell(generation, rows)

    @property
    def remark(self) -> str:
        whole, ribs = (1e6 * part.seconds / self.rows for part in (self.whole, self.ribs))
        return f"ask and tell {whole:.2f} us" + (f", of which pyribs {ribs:.2f} us" if ribs else "")


def _parts_of_ribs(search: Any) -> list[tuple[Any, tuple[str, ...]]]:
    """The pyribs objects of a search, with the methods that it calls."""
    if not hasattr(search, "_emitters"):
        return []
    return [(search._archive, ("add",)), *((emitter, ("ask", "tell")) for emitter in search._emitters)]


def measure_searching(seconds: float) -> Iterator[ScaleFigure]:
    for name, (population, most) in METHODS.items():
        asked = spec(name, population)
        search = ProfiledSearch(method(name).build(asked, plain(SHAPE.genes)))
        runs = [make_run_plan("run", asked, search)]
        with router() as (endpoint, _), start_stand_ins([StandInGroup(endpoint, JOB, WORKERS)]) as stand_ins:
            measurement = CoordinatorMeasurement(stand_ins, runs, WARM_UP, seconds)
            coordinate(endpoint, runs, lambda _: lambda run: PlatformSink(run.shape), measurement, BATCH)
        cells = runs[0].pipeline.tally.cells
        remark = f"population {population}, {cells:,} cells with a success at the end; {search.remark}"
        yield ScaleFigure(
            f"CPU of a genome, {name}", measurement.window.microseconds, "us", most=most, remark=remark
        )


SESSIONS = 1000
PROCESSES = 2
SECONDS = 1.0
"""Time that a stand-in takes for a batch [s]."""
SESSION_BATCH = 16
RUNS = 4
"""A generation of one run holds 4096 genomes at most: too few for so many sessions."""
SESSION_IN_FLIGHT = 4


def measure_sessions(seconds: float) -> Iterator[ScaleFigure]:
    population = SESSIONS * SESSION_BATCH // RUNS
    asked = spec("contact_rand", population)
    runs = [
        make_run_plan(f"run-{run}", asked, ConstantSearch(population), SESSION_IN_FLIGHT)
        for run in range(RUNS)
    ]
    with router() as (endpoint, pid):
        parts = [
            StandInGroup(endpoint, JOB, SESSIONS // PROCESSES, seconds=SECONDS) for _ in range(PROCESSES)
        ]
        with start_stand_ins(parts) as stand_ins:
            measurement = CoordinatorMeasurement(stand_ins, runs, 2 * SECONDS, max(seconds, 5 * SECONDS))
            memory: list[tuple[int, int]] = []
            measurement.at_join = measurement.at_end = lambda: memory.append((resident(), resident(pid)))
            memory.append((resident(), resident(pid)))
            coordinate(
                endpoint, runs, lambda _: lambda run: PlatformSink(run.shape), measurement, SESSION_BATCH
            )
    found, (before, *_, after) = measurement.window, memory
    share = min(100.0, 100 * found.batches * SECONDS / found.seconds / SESSIONS)  # late results come too
    own, its = ((late - early) / SESSIONS / 1024 for early, late in zip(before, after, strict=True))
    yield ScaleFigure("until 1000 sessions have joined", measurement.join_seconds, "s", most=10.0)
    core = found.cpu_seconds / found.seconds
    remark = f"batches of {SECONDS:g} s; the coordinator takes {core:.0%} of a core"
    yield ScaleFigure("served, of the ideal rate", share, "%", 97.0, remark=remark)
    yield ScaleFigure(
        "CPU of a batch", found.per_batch, "us", remark=f"{SESSIONS} workers, {SESSION_BATCH} genomes"
    )
    yield ScaleFigure("memory of the coordinator for a worker", own, "KiB")
    yield ScaleFigure("memory of the router for a worker", its, "KiB")


SLEEPING_WORKERS, ROW_SECONDS, IDLE_SECONDS = 40, 0.05, 10.0
"""Workers that sleep so long for a row [s], of one run of the default method; how long it goes on before."""


def measure_sleeping_workers(seconds: float) -> Iterator[ScaleFigure]:
    """Utilisation of 40 workers whose rows take 50 ms, by one run of the default method."""
    scene = {"gripper": "panda", "object": "rubiks_cube", "evaluations": ENDLESS}
    asked = full_spec(RUN_DEFAULTS | scene)
    run = plan_run(asked, prepare_scene(asked))
    with router() as (endpoint, _):
        group = StandInGroup(
            endpoint, JOB, SLEEPING_WORKERS, row_seconds=ROW_SECONDS, sleeps=True, shape=run.shape
        )
        with start_stand_ins([group]) as stand_ins:
            measurement = CoordinatorMeasurement(
                stand_ins, [run], IDLE_SECONDS, max(seconds, 4 * IDLE_SECONDS)
            )
            coordinate(endpoint, [run], lambda _: lambda run: PlatformSink(run.shape), measurement, None)
    found = measurement.window
    share = 100 * found.rows * ROW_SECONDS / found.seconds / SLEEPING_WORKERS
    remark = f"rows of 50 ms, from {IDLE_SECONDS:g} s on; {found.per_batch:.0f} us of CPU a batch"
    yield ScaleFigure("40 workers asleep on one run, busy", share, "%", 90.0, remark=remark)


ROWS = 1_000_000
RECORDED_METHODS = {"contact_rand": 50_000, "contact_me_scs": None}
"""The rows in a second that are wanted."""
RECORDED_POPULATION, RECORDED_BATCH = 500, 50


def measure_recorded(seconds: float) -> Iterator[ScaleFigure]:
    for name, least in RECORDED_METHODS.items():
        with (
            tempfile.TemporaryDirectory(dir=Path.cwd(), prefix=".scale-") as folder,
            router() as (endpoint, _),
        ):
            out = Path(folder) / "job"
            yield from _record(name, least, endpoint, out)
            yield from _resume(name, endpoint, out)


def _record(name: str, least: float | None, endpoint: str, out: Path) -> Iterator[ScaleFigure]:
    runs = [_run(name)]
    with (
        _recorder(endpoint, out) as recorder,
        start_stand_ins([StandInGroup(endpoint, JOB, WORKERS)]) as stand_ins,
    ):
        measurement = CoordinatorMeasurement(stand_ins, runs, 0.0, float("inf"))
        began, cpu = time.perf_counter(), time.process_time()
        coordinate(
            endpoint,
            runs,
            lambda bus: lambda run: RecorderClient(bus, JOB, run.shape),
            measurement,
            RECORDED_BATCH,
        )
        seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
        memory = resident(recorder.pid)
    size = sum(path.stat().st_size for path in out.rglob("run.sqlite*"))
    remark = f"{name}, a million, each on the disk; the coordinator {1e6 * cpu / ROWS:.1f} us of CPU each"
    yield ScaleFigure("recorded rows a second", ROWS / seconds, "/s", least, remark=remark)
    yield ScaleFigure(
        "journal of a row", size / ROWS, "bytes", remark=f"the recorder takes {memory / 1e6:.0f} MB"
    )


def _resume(name: str, endpoint: str, out: Path) -> Iterator[ScaleFigure]:
    with _recorder(endpoint, out), ZenohBus.connect(endpoint, 10.0, Stop()) as bus:
        active_run = ActiveRun(_run(name), RecorderClient(bus, JOB, SHAPE))
        began, cpu = time.perf_counter(), time.process_time()
        active_run.open(0, lambda: time.sleep(0.05))
        seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
    assert active_run.tally.rows == ROWS
    remark = f"{name}: replayed through ask and tell; {cpu:.1f} CPU s of the coordinator"
    yield ScaleFigure("resume at a million rows", seconds, "s", remark=remark)


def _run(name: str) -> RunPlan:
    asked = spec(name, RECORDED_POPULATION, ROWS)
    return make_run_plan("run", asked, method(name).build(asked, plain(SHAPE.genes)))


@contextmanager
def _recorder(endpoint: str, out: Path) -> Iterator[subprocess.Popen[bytes]]:
    """The real recorder, in a process of its own."""
    command = [sys.executable, "-m", "qdgrasp_tools.cli.recorder_process"]
    command += ["--connect", endpoint, "--job", JOB, "--out", str(out)]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


PAIRS = 5
PAIR_WORKERS = 2
LEAST = 1.8


def measure_pairs(seconds: float) -> Iterator[ScaleFigure]:
    pairs = [_pair(seconds) for _ in range(PAIRS)]
    for regime in pairs[0]:
        found = [pair[regime] for pair in pairs]
        remark = f"{PAIRS} pairs: {spread(found)}; Panda on the mug"
        yield ScaleFigure(f"two workers over one, {regime}", median(found), "times", LEAST, remark=remark)


def _pair(seconds: float) -> dict[str, float]:
    """Ratio of the speed of two workers to that of one, by regime."""
    spec = full_spec({"gripper": "panda", "object": "mug", "method": BENCH_METHOD}, "scale")
    benchmark = SceneBenchmark(
        spec, prepare_scene(spec), workers=PAIR_WORKERS, seconds=seconds, display=LineProgress("scale")
    )
    with ExitStack() as stack:
        logs = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="qdgrasp-")))
        bus, endpoint = ZenohBus.embedded(None)
        stack.enter_context(bus)
        found = benchmark.run(bus, endpoint, stack.enter_context(ProcessSupervisor(logs)), Stop())
    assert found is not None
    return found.figures.scaling
