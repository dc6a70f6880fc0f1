"""The plan of a seed: the run that is disturbed, and which processes are killed or stopped when.

Both are functions of the seed alone. Time cannot be repeated: the progress of each process when
that happens differs from one machine to the next.
"""

import random
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import count

from tests.chaos.simulator import BAD

from qdgrasp_coordinator.scheduler.run_plan import full_spec
from qdgrasp_protocol.spec import RunSpec

HEAD = ("recorder", "coordinator", "router")
INTERVALS = (1.0, 3.0)  # seconds from one fault to the next
RESTART_SECONDS = (0.1, 1.0)  # seconds until a killed process is started again
STOP_SECONDS = (5.5, 7.0)
"""Seconds that a process is stopped for: links end after 4 s without a sign of life, leases one later."""
ROW_SECONDS = 0.005  # seconds that a cheap evaluation takes at least
SCENE = {"gripper": "panda", "object": "tennis_ball"}


class FaultKind(StrEnum):
    """A signal that a process gets."""

    KILL = "SIGKILL"
    STOP = "SIGSTOP"


@dataclass(frozen=True)
class Fault:
    """A signal to one process."""

    after: float
    """Seconds since the fault before, or since the first row was recorded."""
    process: str
    kind: FaultKind
    seconds: float
    """Seconds until it is started again, or goes on."""

    def __str__(self) -> str:
        then = "started again" if self.kind is FaultKind.KILL else "SIGCONT"
        return f"{self.kind} {self.process}, {then} after {self.seconds:.1f} s"


@dataclass(frozen=True)
class RunKind:
    """A kind of run to disturb."""

    method: str
    protocol: str
    population: int | None
    """None: the method's."""
    row_seconds: float
    """Seconds that an evaluation takes at least, so that there is time to disturb it."""

    def spec(self, seed: int, evaluations: int) -> RunSpec:
        """The run of a seed."""
        values = SCENE | {"method": self.method, "protocol": self.protocol}
        values |= {"population": self.population} if self.population else {}
        return full_spec(values | {"seed": seed, "evaluations": evaluations})


RUN_KINDS = (
    RunKind("contact_rand", "paper", 200, ROW_SECONDS),
    RunKind("portfolio", "paper", None, 0.0),
    RunKind("contact_me_scs", "paper", 200, ROW_SECONDS),
    RunKind("contact_cma_mae", "paper", None, ROW_SECONDS),
    RunKind("contact_rand", "robust", 200, ROW_SECONDS),
)
"""Kinds of runs; seeds in a row see every kind."""


def run_kind(seed: int) -> RunKind:
    """The kind of run that a seed disturbs."""
    return RUN_KINDS[seed % len(RUN_KINDS)]


def bad_workers(seed: int, number: int) -> list[str]:
    """The kinds of `number` bad workers that join the run of a seed."""
    return random.Random(seed).sample(sorted(BAD), number)  # noqa: S311


def faults(seed: int, workers: int, intervals: tuple[float, float] = INTERVALS) -> Iterator[Fault]:
    """The faults in their order, without end.

    First each kind of process is killed and one process is stopped; then, round by round, every process is
    killed once and stopped once, in any order.
    """
    chance = random.Random(seed)  # noqa: S311 - dice, not secrets
    for number in count():
        for process, kind in _round(chance, workers, is_first=number == 0):
            seconds = RESTART_SECONDS if kind is FaultKind.KILL else STOP_SECONDS
            yield Fault(chance.uniform(*intervals), process, kind, chance.uniform(*seconds))


def first_round(workers: int) -> int:
    """Number of faults in the first round."""
    return len(_round(random.Random(0), workers, is_first=True))  # noqa: S311


def _round(chance: random.Random, workers: int, *, is_first: bool) -> list[tuple[str, FaultKind]]:
    names = [f"worker-{number}" for number in range(workers)]
    processes = [*names, *HEAD]
    if is_first:
        drawn = [(process, FaultKind.KILL) for process in (chance.choice(names), *HEAD)]
        drawn.append((chance.choice(processes), FaultKind.STOP))
    else:
        drawn = [(process, kind) for process in processes for kind in FaultKind]
    chance.shuffle(drawn)
    return drawn
