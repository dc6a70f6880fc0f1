"""Contents of a history, drawn from its number: runs, machines, bus and faults."""

import random
from dataclasses import dataclass, field, replace

from tests.coordinator.scheduler.search_plans import Plan
from tests.simulation.network import LinkQuality

FAULTS = {
    "a worker is killed": 0.3,
    "a worker's machine loses its power": 0.1,
    "a worker is asked to leave": 0.2,
    "a worker joins": 0.2,
    "a worker is frozen": 0.2,
    "a simulator is killed": 0.1,
    "a link is cut": 0.3,
    "half of the links are cut": 0.05,
    "the router restarts": 0.08,
    "the coordinator is killed": 0.1,
    "the coordinator is frozen": 0.05,
    "the coordinator is frozen and replaced": 0.05,
    "another coordinator is started": 0.05,
    "the recorder is killed": 0.1,
    "the recorder is frozen": 0.05,
    "another recorder is started": 0.05,
    "everything is killed": 0.02,
    "the disk is full": 0.05,
    "the disk is replaced by an older copy": 0.03,
    "results are forged": 0.05,
    "old messages are repeated": 0.5,
}
"""Faults, and their greatest rates [1/s]."""


BAD = {
    "sick": "its simulator fails on every row",
    "silent": "it shows progress, and takes a minute for a row",
    "slow": "it takes forty times as long as others",
}
"""Kinds of bad workers."""
HARMLESS = (
    *("a worker joins", "the recorder is killed", "the recorder is frozen", "another recorder is started"),
    *("the disk is full", "results are forged", "old messages are repeated"),
)
"""Faults that leave other workers there, without whom bad ones are not noticed."""


@dataclass(frozen=True)
class History:
    """A history in brief."""

    number: int
    runs: tuple[Plan, ...]
    workers: int
    batch_size: int | None
    row_seconds: float
    spread: float
    """The slowest worker takes so many times as long as the fastest."""
    quality: LinkQuality
    latency: float
    """The mean time of a commit [s]."""
    failure_rate: float
    """The probability that a simulator fails on a row that is no poison, at most twice a row."""
    is_embedded: bool
    """The router is in the coordinator's process."""
    faults: dict[str, float] = field(default_factory=dict)
    """Rates [1/s]."""
    calm_after: float = 20.0
    """Faults end at this time [s]."""
    has_shapes: bool = False
    """True if each run waits for a shape that a worker builds."""
    builders: float = 1.0
    """Share of the workers that build shapes."""
    bad: tuple[str, ...] = ()
    """Kinds of bad workers that join when others are there: of `BAD`."""
    bad_first: bool = False
    """True if the bad workers join before all others."""

    @property
    def rows(self) -> int:
        """Rows of the runs at most, roughly."""
        return sum((run.evaluations + 1000) * (1 + run.trials) for run in self.runs)


def draw(number: int) -> History:
    """The history of a number."""
    chance = random.Random(number)  # noqa: S311 - dice, not secrets
    many = chance.random() < 0.1
    workers = chance.randint(5, 30) if many else chance.randint(1, 5)
    runs = chance.choice([1, 1, 1, 2, 3])
    history = History(
        number=number,
        runs=tuple(_run(chance, number * 10 + place, many) for place in range(runs)),
        workers=workers,
        batch_size=chance.choice([None, 1, 2, 3, 5]),
        row_seconds=chance.choice([0.05, 0.2, 0.5]),
        spread=chance.choice([1, 2, 10]),
        quality=_quality(chance),
        latency=chance.choice([0.01, 0.01, 0.1, 1.0]),
        failure_rate=chance.choice([0.0, 0.0, 0.1]),
        is_embedded=chance.random() < 0.5,
        faults=_faults(chance),
        has_shapes=chance.random() < 0.5,
        builders=chance.choice([1.0, 1.0, 0.5, 0.0]),
    )
    more = range(runs, 3 if history.has_shapes else runs)  # others are evaluated while shapes are built
    return replace(
        history, runs=history.runs + tuple(_run(chance, number * 10 + place, many) for place in more)
    )


def wild(number: int) -> History:
    """The history of a number, with every fault there is, and often."""
    return replace(draw(number), faults={name: 2 * rate for name, rate in FAULTS.items()})


def some_history(number: int) -> History:
    """The history of a number; every eighth has bad workers."""
    return with_bad_workers(number) if number % 8 == 7 else draw(number)


def with_bad_workers(number: int) -> History:
    """The history of a number, with bad workers among at least two good ones, and faults that spare these."""
    history = wild(number)
    chance = random.Random(number)  # noqa: S311 - dice, not secrets
    return replace(
        history,
        workers=max(2, history.workers),
        runs=tuple(replace(run, evaluations=120, grasps=None, saturation=None) for run in history.runs),
        quality=LinkQuality(delay=history.quality.delay),
        faults={name: rate for name, rate in history.faults.items() if name in HARMLESS},
        has_shapes=False,
        failure_rate=0.0,
        bad=tuple(chance.sample(sorted(BAD), chance.choice([1, 1, 2]))),
    )


def _run(chance: random.Random, seed: int, many: bool) -> Plan:
    return Plan(
        seed=seed,
        population=chance.choice([10, 25] if many else [1, 3, 6, 9]),
        evaluations=chance.choice([40, 60] if many else [1, 7, 20, 30]),
        overlaps=chance.choice(["count", "count", "count", "redraw"]),
        in_flight=(in_flight := chance.choice([1, 1, 2, 3])),
        most_in_flight=6 if in_flight == 3 else 0,
        trials=chance.choice([0, 0, 0, 2, 4]),
        grasps=chance.choice([None, None, None, 3]),
        **chance.choice([{}, {}, {}, {"saturation": 0.9, "window": 4}]),
    )


def _quality(chance: random.Random) -> LinkQuality:
    if chance.random() < 0.7:
        return LinkQuality(delay=chance.choice([0.001, 0.02, 0.2]))
    return LinkQuality(
        delay=chance.choice([0.001, 0.02, 0.2]),
        loss=chance.choice([0.0, 0.01, 0.05]),
        repeat=chance.choice([0.0, 0.1, 0.3]),
        stall=chance.choice([0.0, 0.0, 0.0, 0.01]),
        in_order=chance.random() < 0.5,
    )


def _faults(chance: random.Random) -> dict[str, float]:
    """Some of the faults, some of them often: each history has its own kind of trouble."""
    share = chance.choice([0.0, 0.1, 0.25, 0.5, 1.0])
    factor = chance.choice([0.5, 1.0, 3.0])
    return {name: factor * rate for name, rate in FAULTS.items() if chance.random() < share}
