"""Rates of work done per second, and tables of them."""

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from statistics import median
from typing import Any, Protocol

import msgspec
import numpy as np
from benchmarks.benchmark_figures import node_info
from rich.table import Table


class StageTimer:
    """Adds up the CPU seconds of stages by name."""

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self._open: list[str] = []
        self._mark = 0.0

    @property
    def total(self) -> float:
        """CPU seconds."""
        return sum(self.seconds.values())

    @contextmanager
    def within(self, name: str) -> Iterator[None]:
        """Count the time of this block under `name`."""
        self.enter(name)
        try:
            yield
        finally:
            self.leave()

    def enter(self, name: str) -> None:
        self._add_elapsed()
        self._open.append(name)

    def leave(self) -> None:
        self._add_elapsed()
        self._open.pop()

    @property
    def current(self) -> str:
        """The innermost open name, to which time is counted now."""
        return self._open[-1]

    def _add_elapsed(self) -> None:
        now = time.process_time()
        if self._open:
            self.seconds[self._open[-1]] += now - self._mark
        self._mark = now


ROUNDS = 5
"""Times that each workload is measured."""
Clock = Callable[[], float]
CLOCKS: dict[str, Clock] = {"cpu": time.process_time, "wall": time.perf_counter}


@dataclass(frozen=True)
class Figure:
    """A number of things done, and the seconds that they took."""

    name: str
    count: float
    seconds: float
    clock: str = "cpu"
    """Clock, "cpu" or "wall"; "none": the count alone is meant."""
    remark: str = ""
    rates: tuple[float, ...] = ()
    """Things per second in each round; empty where there was but one."""
    published: tuple[float, ...] = ()
    """Time of the public code's calls for the same things over ours, in each round."""
    stages: Mapping[str, float] = field(default_factory=dict)
    """Microseconds of one thing by stage."""

    @property
    def per_second(self) -> float:
        """The median over rounds."""
        return median(self.rates) if self.rates else self.count / self.seconds

    @property
    def microseconds(self) -> float:
        return 1e6 / self.per_second

    def ratios(self, other: "Figure") -> tuple[float, ...]:
        """Ratios to another's rates, round by round where they took turns."""
        if len(self.rates) == len(other.rates) and self.rates:
            return tuple(own / its for own, its in zip(self.rates, other.rates, strict=True))
        return (self.per_second / other.per_second,)

    def as_dict(self) -> dict[str, Any]:
        found = {
            "name": self.name,
            "count": self.count,
            "seconds": self.seconds,
            "clock": self.clock,
            "per_second": self.per_second,
            "remark": self.remark,
        }
        if self.rates:
            found["interval"] = interval(self.rates)
        if self.published:
            found["published"] = {"times": median(self.published), "interval": interval(self.published)}
        return found | ({"stages_us": dict(self.stages)} if self.stages else {})


def interval(values: Sequence[float]) -> tuple[float, float]:
    """The quartiles."""
    low, high = np.percentile(values, [25, 75]).tolist()
    return low, high


def spread(values: Sequence[float], digits: int = 3) -> str:
    """Median and quartiles in words."""
    if len(values) < 2:
        return number(values[0], digits) if values else ""
    low, high = (number(value, digits) for value in interval(values))
    return f"{number(median(values), digits)} [{low}, {high}]"


def number(value: float, digits: int = 3) -> str:
    """A number to so many digits, without an exponent where it is large."""
    rounded = float(f"{value:.{digits}g}")
    return f"{rounded:,.0f}" if rounded >= 10 ** (digits - 1) else f"{rounded:.{digits}g}"


def duration_text(microseconds: float) -> str:
    """A time in the unit that suits it."""
    for unit, size in (("s", 1e6), ("ms", 1e3)):
        if microseconds >= size:
            return f"{microseconds / size:.3g} {unit}"
    return f"{microseconds:.3g} \u00b5s"


class Meter:
    """Sums the seconds within its `running` blocks."""

    def __init__(self, clock: str = "cpu") -> None:
        self.seconds = 0.0
        self._clock = CLOCKS[clock]

    @contextmanager
    def running(self) -> Iterator[None]:
        began = self._clock()
        yield
        self.seconds += self._clock() - began


class Workload(Protocol):
    """One of several workloads that are measured in turns."""

    def __call__(self, meter: Meter) -> float:
        """Do some of the work, count its time, and return its amount."""

    @property
    def remark(self) -> str:
        """A remark on the whole measurement, for the table."""

    @property
    def stages(self) -> Mapping[str, float]:
        """Microseconds of one thing by stage; empty where unknown."""


@dataclass
class TimedWork:
    """A workload, and what it did in each of its rounds."""

    name: str
    work: Workload
    clock: str = "cpu"
    counts: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def measure_round(self, seconds: float) -> None:
        """Do the work for a time, and note how much was done."""
        meter, count = Meter(self.clock), 0.0
        while meter.seconds < seconds:
            count += self.work(meter)
        self.counts.append(count)
        self.seconds.append(meter.seconds)

    @property
    def figure(self) -> Figure:
        rates = tuple(count / taken for count, taken in zip(self.counts, self.seconds, strict=True))
        total = sum(self.counts), sum(self.seconds)
        return Figure(self.name, *total, self.clock, self.work.remark, rates, stages=self.work.stages)


def measure_in_turns(workloads: Sequence[TimedWork], seconds: float, rounds: int = ROUNDS) -> list[Figure]:
    """Measure workloads in turns, each for so many seconds."""
    for _ in range(rounds):
        for workload in workloads:
            workload.measure_round(seconds / rounds)
    return [workload.figure for workload in workloads]


def machine() -> dict[str, Any]:
    """Name of the machine that this is measured on."""
    values: dict[str, Any] = msgspec.to_builtins(node_info())
    return values


def table(name: str, figures: Sequence[Figure]) -> Table:
    """A part for a terminal."""
    heads, *rows = lines(figures)
    shown = Table(*heads, title=name, title_justify="left")
    for row in rows:
        shown.add_row(*row)
    return shown


def markdown(name: str, figures: Sequence[Figure]) -> str:
    """A part as a section."""
    heads, *rows = lines(figures)
    cells = [heads, ["---"] * len(heads), *rows]
    return "\n".join([f"## {name.capitalize()}", "", *(f"| {' | '.join(row)} |" for row in cells)])


def lines(figures: Sequence[Figure]) -> list[list[str]]:
    """The head of a part's table, and its rows."""
    has_published = any(figure.published for figure in figures)
    heads = [
        "what",
        "per second",
        "one takes",
        "public code's calls, times" if has_published else "first line, times",
    ]
    return [[*heads, "remark"], *(_line(figure, figures[0], has_published) for figure in figures)]


def _line(figure: Figure, first: Figure, has_published: bool) -> list[str]:
    if figure.clock == "none":
        return [figure.name, "", number(figure.count), "", figure.remark]
    times = figure.published if has_published else figure.ratios(first)
    rate = spread(figure.rates or [figure.per_second])
    return [figure.name, rate, duration_text(figure.microseconds), spread(times), figure.remark]
