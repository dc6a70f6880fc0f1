"""The plan of a seed: the run that is disturbed, and which processes are struck when.

Both are functions of the seed alone. Time cannot be repeated: the progress of each process when
it is struck differs from one machine to the next.
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
GAPS = (1.0, 3.0)  # seconds from one blow to the next
DEAD = (0.1, 1.0)  # seconds until a killed process is started again
STILL = (5.5, 7.0)
"""Seconds that a process is stopped for: links end after 4 s without a sign of life, leases one later."""
PACE = 0.005  # seconds that a cheap evaluation takes at least
SCENE = {"gripper": "panda", "object": "tennis_ball"}


class Deed(StrEnum):
    """A kind of blow to a process."""

    KILL = "SIGKILL"
    STOP = "SIGSTOP"


@dataclass(frozen=True)
class Blow:
    """A blow to one process."""

    after: float
    """Seconds since the blow before, or since the first row was recorded."""
    victim: str
    deed: Deed
    seconds: float
    """Seconds until it is started again, or goes on."""

    def __str__(self) -> str:
        then = "started again" if self.deed is Deed.KILL else "SIGCONT"
        return f"{self.deed} {self.victim}, {then} after {self.seconds:.1f} s"


@dataclass(frozen=True)
class Course:
    """A kind of run to disturb."""

    method: str
    protocol: str
    population: int | None
    """None: the method's."""
    pace: float
    """Seconds that an evaluation takes at least, so that there is time to disturb it."""

    def spec(self, seed: int, evaluations: int) -> RunSpec:
        """The run of a seed."""
        values = SCENE | {"method": self.method, "protocol": self.protocol}
        values |= {"population": self.population} if self.population else {}
        return full_spec(values | {"seed": seed, "evaluations": evaluations})


COURSES = (
    Course("contact_rand", "paper", 200, PACE),
    Course("aimed", "paper", None, 0.0),
    Course("contact_me_scs", "paper", 200, PACE),
    Course("contact_cma_mae", "paper", None, PACE),
    Course("contact_rand", "robust", 200, PACE),
)
"""Kinds of runs; seeds in a row see every kind."""


def course(seed: int) -> Course:
    """The kind of run that a seed disturbs."""
    return COURSES[seed % len(COURSES)]


def bad_workers(seed: int, number: int) -> list[str]:
    """The kinds of `number` bad workers that join the run of a seed."""
    return random.Random(seed).sample(sorted(BAD), number)  # noqa: S311


def blows(seed: int, workers: int, gaps: tuple[float, float] = GAPS) -> Iterator[Blow]:
    """The blows in their order, without end.

    First each kind of process is killed and one process is stopped; then, round by round, every process is
    killed once and stopped once, in any order.
    """
    chance = random.Random(seed)  # noqa: S311 - dice, not secrets
    for number in count():
        for victim, deed in _round(chance, workers, is_first=number == 0):
            seconds = DEAD if deed is Deed.KILL else STILL
            yield Blow(chance.uniform(*gaps), victim, deed, chance.uniform(*seconds))


def opening(workers: int) -> int:
    """Number of blows in the first round."""
    return len(_round(random.Random(0), workers, is_first=True))  # noqa: S311


def _round(chance: random.Random, workers: int, *, is_first: bool) -> list[tuple[str, Deed]]:
    team = [f"worker-{number}" for number in range(workers)]
    everybody = [*team, *HEAD]
    if is_first:
        dealt = [(victim, Deed.KILL) for victim in (chance.choice(team), *HEAD)]
        dealt.append((chance.choice(everybody), Deed.STOP))
    else:
        dealt = [(victim, deed) for victim in everybody for deed in Deed]
    chance.shuffle(dealt)
    return dealt
