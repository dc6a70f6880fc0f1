"""The figures of a node: what `qdgrasp bench` prints, as a table and as JSON."""

from collections.abc import Iterator, Sequence

from msgspec import Struct

from qdgrasp_coordinator.bench.node import Node
from qdgrasp_coordinator.bench.regimes import Regime
from qdgrasp_coordinator.bench.stopwatch import Lap

RUN = 10_000
"""Evaluations of the run whose time is foretold."""
DIGITS = 12
"""Of a sha256, in the table."""


class Pace(Struct, frozen=True, kw_only=True):
    """How fast evaluations of one regime are."""

    regime: str
    workers: int
    evaluations: int
    """That were counted for it."""
    per_second: float
    """Evaluations in a second of the clock on the wall, of all workers together."""
    per_cpu_second: float
    """Evaluations in a CPU second of a worker."""
    core_share: float
    """CPU seconds of a worker in a second: less than 1 where others had its core, or it waited for work."""
    overlap_share: float
    success_share: float
    """A finger touches the object after closing."""


class SceneFigures(Struct, frozen=True, kw_only=True):
    """What a node makes of one scene."""

    gripper: str
    object: str
    protocol: str
    start_seconds: float
    """From the start of a worker's process to its first result."""
    memory_bytes: int
    """The most that a worker has had."""
    paces: list[Pace]
    scaling: dict[str, float]
    """By regime: evaluations per second of all workers over those of one."""
    run_seconds: dict[str, float]
    """By regime: what 10 000 evaluations take all workers."""

    @property
    def lines(self) -> Iterator[str]:
        """The scene's part of the table."""
        counts = sorted({pace.workers for pace in self.paces})
        heads = [f"{n} worker{'' if n == 1 else 's'}" for n in counts]
        yield _line(f"{self.gripper} on {self.object}", *heads, "scaling" if len(counts) > 1 else "")
        for regime in dict.fromkeys(pace.regime for pace in self.paces):
            paces = [pace for pace in self.paces if pace.regime == regime]
            scaling = [f"x {self.scaling[regime]:.2f}"] if regime in self.scaling else []
            yield _line(f"  {regime}, a second", *(_number(pace.per_second) for pace in paces), *scaling)
            yield _line("    a CPU second", *(_number(pace.per_cpu_second) for pace in paces))
            yield _line("    of a core each", *(f"{pace.core_share:.0%}" for pace in paces))
            yield _line("    successes", *(f"{pace.success_share:.1%}" for pace in paces))
        yield f"  A worker starts in {self.start_seconds:.1f} s and takes {self.memory_bytes / 1e6:.0f} MB."
        yield f"  {self.foretold}"

    @property
    def foretold(self) -> str:
        """How long a run would take, in words."""
        times = [f"{duration(time)} if all are {regime}" for regime, time in self.run_seconds.items()]
        return f"{RUN:,} evaluations take {', '.join(times)}{'; a search lies between' * (len(times) > 1)}."


class NodeFigures(Struct, frozen=True, kw_only=True):
    """What `qdgrasp bench` found."""

    date: str
    """UTC, ISO 8601."""
    node: Node
    platform: dict[str, str]
    """What decides the bits of results (docs/reproducibility.md)."""
    scenes: list[SceneFigures]

    @property
    def table(self) -> str:
        """The figures for a person."""
        digests = {name: value[:DIGITS] for name, value in self.platform.items() if len(value) == 64}
        versions = {name: value for name, value in self.platform.items() if name not in digests}
        words = (", ".join(f"{name} {value}" for name, value in part.items()) for part in (versions, digests))
        parts = ["\n".join(scene.lines) for scene in self.scenes]
        return "\n\n".join(["\n".join([f"{self.date}: {self.node.words}", *words]), *parts])


def pace(regime: Regime, workers: int, lap: Lap) -> Pace:
    """The pace of so many workers in one regime."""
    return Pace(
        regime=regime.value,
        workers=workers,
        evaluations=lap.rows,
        per_second=lap.per_second,
        per_cpu_second=lap.rows / lap.cpu_seconds,
        core_share=lap.per_second * lap.cpu_seconds / lap.rows / workers,
        overlap_share=lap.overlaps / lap.rows,
        success_share=lap.successes / lap.rows,
    )


def scaling(paces: Sequence[Pace]) -> dict[str, float]:
    """How many times as fast the most workers are as one, by regime; empty where there is but one."""
    alone = {pace.regime: pace.per_second for pace in paces if pace.workers == 1}
    return {pace.regime: pace.per_second / alone[pace.regime] for pace in paces if pace.workers > 1}


def run_seconds(paces: Sequence[Pace]) -> dict[str, float]:
    """What a run takes the most workers, if all its poses are of one regime."""
    most = max(pace.workers for pace in paces)
    return {pace.regime: RUN / pace.per_second for pace in paces if pace.workers == most}


def duration(seconds: float) -> str:
    """A time in words, to two figures or so."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _number(value: float) -> str:
    return f"{value:,.0f}" if value >= 20 else f"{value:.1f}"


def _line(name: str, *cells: str) -> str:
    return f"{name:<36}{''.join(f'{cell:>12}' for cell in cells)}".rstrip()
