"""A simulator that is a formula: it says what a simulator says, takes its time, and sometimes dies."""

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random
from signal import SIGABRT, SIGKILL
from typing import TYPE_CHECKING

import numpy as np
from tests.coordinator.runs.plans import Task

from qdgrasp_protocol.messages import Failure
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import RESULT, Rows, pack
from qdgrasp_worker.serving.frames import Begun, Evaluate, Frame, Lacking, Part, Ready, Said
from qdgrasp_worker.serving.limits import CLOCK_OVER
from qdgrasp_worker.serving.simulator import Ended, Heard, News
from qdgrasp_worker.serving.vitals import Vitals

if TYPE_CHECKING:
    from tests.simulation.process import Process

PLATFORM = {"evaluation": "a formula"}
LOADING = 0.05
"""Seconds until a scene stands."""
START = 0.3
"""Seconds until the probes are evaluated."""


@dataclass
class Mishaps:
    """Rows on which simulators fail now and then, each at most twice: no poison."""

    chance: Random
    rate: float
    failed: Counter[bytes] = field(default_factory=Counter)

    def strikes(self, row: np.void) -> bool:
        """Whether a simulator fails on a row now."""
        key = row["genome"].tobytes() + row["trial"].tobytes()
        if self.failed[key] < 2 and self.chance.random() < self.rate:
            self.failed[key] += 1
            return True
        return False


@dataclass(frozen=True)
class Speed:
    """How fast a simulator is."""

    row_seconds: float
    rows_at_once: int


class Formula:
    """What a worker has of a simulator's process.

    Parameters
    ----------
    host
        The worker's process.
    task
        What it evaluates.
    hear
        Takes its news.
    """

    def __init__(
        self, host: "Process", task: Task, speed: Speed, mishaps: Mishaps, hear: Callable[[News], None]
    ) -> None:
        self._host = host
        self._task = task
        self._speed = speed
        self._mishaps = mishaps
        self._hear = hear
        self._queue: deque[Evaluate] = deque()
        self._scenes: set[str] = set()
        self._is_over = False
        self._is_busy = False
        self._steps = 0
        self._later(START, lambda: self._say(Ready(platform=PLATFORM)))

    @property
    def vitals(self) -> Vitals:
        """What it has taken of the processor and the memory."""
        return Vitals(float(self._steps), 0)

    def say(self, frame: Frame) -> None:
        """Take a batch."""
        assert isinstance(frame, Evaluate)
        self._queue.append(frame)
        self._begin()

    def stop(self) -> None:
        """Be ended for having said nothing."""
        self._die(-CLOCK_OVER)

    def close(self) -> None:
        """Be gone."""
        self._is_over = True

    def _later(self, seconds: float, call: Callable[[], None]) -> None:
        self._host.world.later(seconds, lambda: None if self._is_over or self._host.is_over else call())

    def _say(self, frame: Said) -> None:
        self._hear(Heard(self, frame))  # type: ignore[arg-type]

    def _die(self, code: int) -> None:
        self._is_over = True
        self._hear(Ended(self, code))  # type: ignore[arg-type]

    # Batches, slice by slice.

    def _begin(self) -> None:
        if self._is_busy or not self._queue:
            return
        batch = self._queue.popleft()
        if batch.bundle is None and batch.scene not in self._scenes:
            self._say(Lacking())
            self._begin()
            return
        self._is_busy = True
        if batch.bundle is None:
            self._go_on(batch, 0)
        else:
            self._later(LOADING, lambda: self._load(batch))

    def _load(self, batch: Evaluate) -> None:
        self._scenes.add(batch.scene)
        self._say(Begun())
        self._go_on(batch, 0)

    def _go_on(self, batch: Evaluate, start: int) -> None:
        """Evaluate the next slice, or the next batch."""
        if start == batch.n:
            self._is_busy = False
            self._begin()
            return
        n = min(1 if batch.is_careful else self._speed.rows_at_once, batch.n - start)
        seconds = n * self._speed.row_seconds * self._host.world.chance.uniform(0.5, 2)
        self._later(seconds, lambda: self._finish(batch, start, n))

    def _finish(self, batch: Evaluate, start: int, n: int) -> None:
        self._steps += n
        rows = self._task.shape.empty(batch.n)
        rows["genome"] = np.frombuffer(batch.columns["genome"], "<f4").reshape(batch.n, batch.genes)
        rows["trial"] = np.frombuffer(batch.columns["trial"], "<u2")
        found = self._task.evaluate(rows[start : start + n])
        failed = [place for place, row in enumerate(found) if self._fails(row)]
        ends = [place for place in failed if found["genome"][place, 1] > 0]
        if ends:
            self._die(-SIGABRT if found["genome"][ends[0], 2] > 0 else 1)
            return
        self._say(self._part(found, failed))
        self._go_on(batch, start + n)

    def _fails(self, row: np.void) -> bool:
        return bool(row["outcome"] == Outcome.ERROR) or self._mishaps.strikes(row)

    def _part(self, found: Rows, failed: list[int]) -> Part:
        found[failed] = np.zeros((), found.dtype)
        return Part(
            n=len(found),
            joints=self._task.shape.joints,
            descriptors=self._task.shape.descriptors,
            columns=pack(found, RESULT),
            failures=[Failure(row=place, reason="it raised") for place in failed],
            cpu_seconds=len(found) * self._speed.row_seconds,
        )

    def be_killed(self) -> None:
        """Be killed from outside, for memory."""
        if not self._is_over:
            self._die(-SIGKILL)
