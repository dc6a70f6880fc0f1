"""Evaluations per second of this machine's workers, by regime of poses.

Anywhere, most poses overlap or miss, and are rejected soon; near grasps, most are shaken to the end. A run
is a mixture of both, so that these two regimes say what any run takes.
"""

import importlib.metadata
import os
import platform
import time
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from enum import Enum
from math import pi
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from qdgrasp_coordinator.search.base import keyed_generator
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.engines import ENGINE_PACKAGES
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Result
from qdgrasp_protocol.rows import Genomes, Layout, Outcome, Rows
from qdgrasp_protocol.text import counted

BENCH_METHOD, BENCH_PRIOR = "contact_rand", "contact"
GREATEST_NU = pi / 4  # The greatest nu of poses among which grasps are looked for: the approach prior's
PARENTS = 24  # Grasps around which poses are drawn
MOST_LOOKED_AT = 2048  # Poses among which they are looked for, at most
GENE_SIGMA = 0.02  # Standard deviation of each gene around those of a grasp
FIRST_POPULATION = 64  # Genomes in a generation while grasps are looked for


class PoseRegime(Enum):
    """Region that poses are drawn from."""

    FACING = "facing the surface"
    """At most 45 degrees from the normal: here grasps are looked for."""
    ANYWHERE = "anywhere"
    """Uniform genomes."""
    NEAR = "near grasps"
    """Around the first grasps that were found."""


class RegimeSearch:
    """Asks genomes of the prior `contact` in the current regime.

    The grasps are a function of the layout alone: they are looked for in generations of the same size.
    """

    def __init__(self, layout: Layout) -> None:
        self.regime = PoseRegime.FACING
        self.population = FIRST_POPULATION  # Genomes in a generation
        self.since = 0  # The first generation of the current regime
        self._layout = layout
        self._parents: list[Genomes] = []
        self._asked = 0
        self._looked_at = 0

    def start_regime(self, regime: PoseRegime, population: int) -> None:
        """From the next generation on, ask `population` genomes of another regime at a time."""
        self.regime, self.population, self.since = regime, population, self._asked

    @property
    def has_parents(self) -> bool:
        """True if enough grasps are known, or enough poses were looked at."""
        return len(self.parents) == PARENTS or self._looked_at >= MOST_LOOKED_AT

    @property
    def parents(self) -> Genomes:
        """The first grasps found: (n, d), at most `PARENTS`."""
        none = np.zeros((0, len(self._layout)), np.float32)
        return np.concatenate([none, *self._parents])[:PARENTS]

    def ask(self, generation: int) -> Genomes:
        """Return the next generation: (population, d)."""
        self._asked = generation + 1
        random = keyed_generator(0, self.regime.value, generation)
        if self.regime is PoseRegime.NEAR:
            chosen = self.parents[random.integers(len(self.parents), size=self.population)]
            moved = chosen + random.normal(0.0, GENE_SIGMA, chosen.shape)
            return np.clip(moved, -1.0, 1.0).astype(np.float32)
        genomes = random.uniform(-1.0, 1.0, (self.population, len(self._layout)))
        if self.regime is PoseRegime.FACING:  # nu's gene from -1 to what stands for the greatest nu
            nu = self._layout.names.index("nu")
            genomes[:, nu] *= GREATEST_NU / pi
            genomes[:, nu] -= 1.0 - GREATEST_NU / pi
        return genomes.astype(np.float32)

    def tell(self, generation: int, rows: Rows) -> None:
        """Collect the first grasps."""
        if not self.has_parents:
            self._looked_at += len(rows)
            self._parents.append(rows["genome"][rows["outcome"] >= Outcome.SHAKEN])


class ReturnedBatch(NamedTuple):
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
class Throughput:
    """Work of some workers at the same time."""

    workers: int
    rows: int
    per_second: float
    """Rows in a second of the clock on the wall, of all workers together."""
    cpu_seconds: float
    overlaps: int
    successes: int


class ThroughputMeter:
    """Collects the results that come back; called in threads of the bus."""

    def __init__(self) -> None:
        self._batches: list[ReturnedBatch] = []

    @property
    def has_begun(self) -> bool:
        """True if any result came."""
        return bool(self._batches)

    def add(self, sample: Sample) -> None:
        """Note a result; anything else is passed over."""
        try:
            result = messages.decode(sample.payload, Result)
        except MessageError:
            return
        self._batches.append(returned_batch(result, time.monotonic()))

    def workers(self, since: int) -> int:
        """Count the workers that gave a result of generation `since` or a later one."""
        return len(self._by_worker(since))

    def rows(self, since: int) -> int:
        """Count the rows of generation `since` and of later ones that came back."""
        return sum(batch.rows for batches in self._by_worker(since) for batch in batches)

    def throughput(self, since: int, begin: float) -> Throughput:
        """Return the work done from `begin` on, of generation `since` and of later ones.

        A worker's own time goes from its last result until then, or from its first one, to the last that
        came, so that no part of a batch is counted. Workers that gave no result in that time are left out.
        """
        each = [one for batches in self._by_worker(since) if (one := _worker_throughput(batches, begin))]
        nothing = Throughput(0, 0, 0.0, 0.0, 0, 0)
        return Throughput(*map(sum, zip(*map(astuple, [nothing, *each]), strict=True)))

    def _by_worker(self, since: int) -> list[list[ReturnedBatch]]:
        found: dict[str, list[ReturnedBatch]] = {}
        for batch in list(self._batches):
            if batch.generation >= since:
                found.setdefault(batch.wid, []).append(batch)
        return list(found.values())


def _worker_throughput(batches: list[ReturnedBatch], begin: float) -> Throughput | None:
    """Return the work of one worker; None: nothing that has both a beginning and an end."""
    start = max(sum(batch.at <= begin for batch in batches), 1)
    done = batches[start:]
    if not done:
        return None
    rows = sum(batch.rows for batch in done)
    return Throughput(
        workers=1,
        rows=rows,
        per_second=rows / (done[-1].at - batches[start - 1].at),
        cpu_seconds=sum(batch.cpu_seconds for batch in done),
        overlaps=sum(batch.overlaps for batch in done),
        successes=sum(batch.successes for batch in done),
    )


def returned_batch(result: Result, now: float) -> ReturnedBatch:
    """Return the record of a result that came at `now`."""
    outcomes = np.frombuffer(result.columns.get("outcome", b""), np.uint8)
    counts = (outcomes == Outcome.OVERLAP).sum(), (outcomes >= Outcome.DROPPED).sum()
    return ReturnedBatch(now, result.wid, result.generation, result.n, result.cpu_seconds, *map(int, counts))


PACKAGES = ("qdgrasp", *ENGINE_PACKAGES.values(), "numpy", "scipy", "ribs", "eclipse-zenoh")


class NodeInfo(Struct, frozen=True, kw_only=True):
    """A machine, and the software on it."""

    processor: str
    cores: int
    """CPU cores that this process may use."""
    load: float
    """Processes that wanted to run in the last minute: above 0, others had a share of the cores."""
    memory_bytes: int
    system: str
    python: str
    packages: dict[str, str]

    @property
    def words(self) -> str:
        """One line for a person."""
        cores, memory = counted(self.cores, "core"), self.memory_bytes / 2**30
        return f"{cores} of {self.processor}, {memory:.0f} GiB, load {self.load:.1f}"


def node_info() -> NodeInfo:
    """Describe the node that this process is on."""
    return NodeInfo(
        processor=_processor_name(),
        cores=len(os.sched_getaffinity(0)),
        load=os.getloadavg()[0],
        memory_bytes=os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
        system=platform.platform(),
        python=platform.python_version(),
        packages={name: package_version(name) for name in PACKAGES},
    )


def package_version(name: str) -> str:
    """Return the version of an installed package; "absent" where it is not installed."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "absent"


def peak_memory(pid: int) -> int:
    """Return the peak memory of a process and those it started [bytes]; 0: it is not known."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        started = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return 0
    own = next((1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM")), 0)
    return own + sum(peak_memory(int(child)) for child in started)


def _processor_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or platform.machine())


RUN_EVALUATIONS = 10_000  # Evaluations of the run whose time is predicted


class RegimeRate(Struct, frozen=True, kw_only=True):
    """Speed of evaluations of one regime."""

    regime: str
    workers: int
    evaluations: int
    per_second: float
    """Evaluations in a second of the clock on the wall, of all workers together."""
    per_cpu_second: float
    """Evaluations in a CPU second of a worker."""
    core_share: float
    """CPU seconds of a worker per second; below 1: others had its core, or it waited for work."""
    overlap_share: float
    success_share: float
    """A finger touches the object after closing."""


class SceneFigures(Struct, frozen=True, kw_only=True):
    """Speed, memory and start time of a node's workers with one scene."""

    gripper: str
    object: str
    protocol: str
    start_seconds: float
    """Time from the start of a worker's process to its first result."""
    memory_bytes: int
    """Peak memory of a worker and the processes it started."""
    rates: list[RegimeRate]
    scaling: dict[str, float]
    """By regime: evaluations per second of all workers over those of one."""
    run_seconds: dict[str, float]
    """By regime: time that 10 000 evaluations take all workers."""


def regime_rate(regime: PoseRegime, workers: int, work: Throughput) -> RegimeRate:
    """Return the speed of so many workers in one regime."""
    return RegimeRate(
        regime=regime.value,
        workers=workers,
        evaluations=work.rows,
        per_second=work.per_second,
        per_cpu_second=work.rows / work.cpu_seconds,
        core_share=work.per_second * work.cpu_seconds / work.rows / workers,
        overlap_share=work.overlaps / work.rows,
        success_share=work.successes / work.rows,
    )


def scaling(rates: Sequence[RegimeRate]) -> dict[str, float]:
    """Return the speed of the most workers over that of one, by regime; empty with one worker."""
    alone = {rate.regime: rate.per_second for rate in rates if rate.workers == 1}
    return {rate.regime: rate.per_second / alone[rate.regime] for rate in rates if rate.workers > 1}


def run_seconds(rates: Sequence[RegimeRate]) -> dict[str, float]:
    """Return the time that a run takes the most workers if all poses are of a regime [s]."""
    most = max(rate.workers for rate in rates)
    return {rate.regime: RUN_EVALUATIONS / rate.per_second for rate in rates if rate.workers == most}
