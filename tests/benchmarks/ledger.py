"""A ledger: CPU time by what it was spent on; of two things, one within the other, the inner one counts."""

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager


class Ledger:
    """Adds up the CPU seconds of entries by name."""

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
        """What is done here is spent on `name`."""
        self.enter(name)
        try:
            yield
        finally:
            self.leave()

    def enter(self, name: str) -> None:
        self._pass()
        self._open.append(name)

    def leave(self) -> None:
        self._pass()
        self._open.pop()

    @property
    def inmost(self) -> str:
        """What time is spent on now."""
        return self._open[-1]

    def _pass(self) -> None:
        now = time.process_time()
        if self._open:
            self.seconds[self._open[-1]] += now - self._mark
        self._mark = now
