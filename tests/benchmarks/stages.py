"""What an evaluation spends its time on: the real path, watched from outside.

While a profile watches, methods of the worker are wrapped; the worker has no clock of its own. Watching takes
time too, so that shares are measured under a watch, and the time that they are shares of without.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import wraps
from typing import Any
from unittest.mock import patch

from tests.benchmarks.ledger import Ledger

from qdgrasp_worker.decode import Decoder
from qdgrasp_worker.episode import Episode
from qdgrasp_worker.overlap import OverlapFilter
from qdgrasp_worker.protocols import Shake
from qdgrasp_worker.ranking import Ranking
from qdgrasp_worker.reach import Reach
from qdgrasp_worker.world import World

REST = "rest"
"""What is in no stage: rows, lists and the loop."""
STEPS = ", steps"
"""Behind a stage's name: the simulator's own steps within it."""


def _shake(_: Episode, shake: Shake, *rest: object) -> str:
    return f"shake {shake.joint}"


STAGES: list[tuple[type, str, str | Callable[..., str]]] = [
    (Decoder, "__call__", "decode"),
    (OverlapFilter, "__call__", "overlap filter"),
    (Ranking, "features", "features"),
    (Reach, "misses", "never-touch filter"),
    (Episode, "overlaps", "place, overlap"),
    (Episode, "_close", "closing"),
    (Episode, "_holds_through", _shake),
]
"""The method of a class, and the stage that is spent in it, or what tells it from the arguments."""
ORDER = (
    "decode",
    "overlap filter",
    "features",
    "never-touch filter",
    "place, overlap",
    "closing",
    "shake z",
    "shake x",
    REST,
)
"""The stages in the order of an evaluation."""


class Profile:
    """Adds up what evaluations spend on each stage."""

    def __init__(self) -> None:
        self._ledger = Ledger()
        self._evaluations = 0
        self._steps = 0

    @contextmanager
    def watching(self, evaluations: int) -> Iterator[None]:
        """Watch so many evaluations that are made here."""
        self._evaluations += evaluations
        with ExitStack() as patches:
            for owner, name, stage in STAGES:
                patches.enter_context(patch.object(owner, name, self._within(getattr(owner, name), stage)))
            patches.enter_context(patch.object(World, "step", self._stepping(World.step)))
            with self._ledger.within(REST):
                yield

    def stages(self, microseconds: float) -> dict[str, float]:
        """An evaluation's time by stage, in an evaluation's order; it is so long without a watch."""
        seconds, whole = self._ledger.seconds, self._ledger.total
        names = [name for stage in ORDER for name in (stage, stage + STEPS) if name in seconds]
        return {name: microseconds * seconds[name] / whole for name in names}

    @property
    def steps_each(self) -> float:
        """The simulator's steps in an evaluation."""
        return self._steps / self._evaluations

    @property
    def step_share(self) -> float:
        """How much of all time is spent in the simulator's steps: the floor."""
        steps = sum(time for name, time in self._ledger.seconds.items() if name.endswith(STEPS))
        return steps / self._ledger.total

    def _within(self, method: Callable[..., Any], stage: str | Callable[..., str]) -> Callable[..., Any]:
        @wraps(method)
        def watched(*arguments: Any, **named: Any) -> Any:
            with self._ledger.within(stage if isinstance(stage, str) else stage(*arguments, **named)):
                return method(*arguments, **named)

        return watched

    def _stepping(self, step: Callable[[World], None]) -> Callable[[World], None]:
        @wraps(step)
        def watched(world: World) -> None:
            self._steps += 1
            self._ledger.enter(self._ledger.inmost + STEPS)
            step(world)
            self._ledger.leave()

        return watched
