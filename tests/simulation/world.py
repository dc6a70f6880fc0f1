"""A simulated world: time is a number, events are calls in a heap, all chance comes from one seed."""

import heapq
import itertools
import random
from collections.abc import Callable
from math import inf


class World:
    """Events in the order of their times."""

    def __init__(self, seed: int) -> None:
        self.now = 0.0
        self.chance = random.Random(seed)  # noqa: S311 - dice, not secrets
        self.events = 0
        self.trace: list[str] | None = None
        """What happened, a line each; None: it is not noted."""
        self.touched: list[object] = []
        """Whose state the present event may have changed."""
        self.look: Callable[[], None] = lambda: None
        """Called after every event that touched something: it checks what must always hold."""
        self._heap: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()

    def at(self, time: float, call: Callable[[], None]) -> None:
        """Let something happen at a time; infinite: never."""
        if time < inf:
            heapq.heappush(self._heap, (max(time, self.now), next(self._count), call))

    def later(self, seconds: float, call: Callable[[], None]) -> None:
        """Let something happen in so many seconds."""
        self.at(self.now + seconds, call)

    def run(self, is_over: Callable[[], bool]) -> None:
        """Let things happen until it is over."""
        goes_on = True
        while goes_on:
            self.now, _, call = heapq.heappop(self._heap)
            call()
            self.events += 1
            if self.touched:
                self.look()
                self.touched.clear()
                goes_on = not is_over()

    def note(self, who: str, what: str) -> None:
        """Note what happened."""
        if self.trace is not None:
            self.trace.append(f"{self.now:9.3f}  {who:<14}  {what}")

    def exponential(self, mean: float) -> float:
        """A time whose like is forgotten."""
        return self.chance.expovariate(1 / mean)


class Clock:
    """A machine's steady clock: it begins anywhere and goes a little fast or slow."""

    def __init__(self, world: World, offset: float = 0.0, rate: float = 1.0) -> None:
        self._world = world
        self._offset = offset
        self._rate = rate

    @property
    def now(self) -> float:
        """What it shows [s]."""
        return self._offset + self._rate * self._world.now

    def span(self, seconds: float) -> float:
        """How long it takes in the world until it shows so much more, never less."""
        return max(0.0, seconds) / self._rate + 1e-9
