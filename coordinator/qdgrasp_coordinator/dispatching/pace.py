"""Pace: how many rows make a batch, and how long a lease may take, from what was measured."""

from collections import deque
from math import ceil, sqrt

BATCH_SECONDS = 0.25
"""What a batch is to take on a worker."""
LEAST_SECONDS = 0.02
"""Sharing the end of a generation makes no batches that take less."""
HANDLING_SECONDS = 50e-6
"""What a batch takes of the coordinator's one thread."""
FIRST_ROWS = 4
"""Rows in a batch while nothing is known about their cost."""
MOST_ROWS = 512
LEASE_SECONDS = 10.0
"""The shortest time without a sign of progress after which a lease is over."""
LEASE_TURNS = 10
"""A lease may take so many times the 95th percentile of turnarounds, if that is longer."""
_MEMORY = 0.9
_TURNS = 256


class Pace:
    """The size of one run's batches.

    Parameters
    ----------
    fixed
        Rows in a batch; None: measured.
    """

    def __init__(self, fixed: int | None = None) -> None:
        self._fixed = fixed
        self._seconds = 0.0
        self._rows = 0.0

    @property
    def seconds_per_row(self) -> float | None:
        """CPU seconds that a row costs, the latest batches counting most; None before the first."""
        return self._seconds / self._rows if self._rows else None

    def measure(self, rows: int, cpu_seconds: float) -> None:
        """Learn what a batch cost."""
        self._seconds = _MEMORY * self._seconds + cpu_seconds
        self._rows = _MEMORY * self._rows + rows

    def rows(self, remaining: int, workers: int, runs: int = 1) -> int:
        """Rows in the next batch.

        Parameters
        ----------
        remaining
            Rows of the generation that are not leased; at least 1.
        workers
            Workers that share these and as many rows of the other runs: none is to get more than its part of
            half of them, so that all of them are done at about the same time.
        runs
            How many runs are under way; at least 1.
        """
        if self._fixed is not None:
            return min(self._fixed, remaining)
        cost = self.seconds_per_row
        wanted = FIRST_ROWS if cost is None else _within(BATCH_SECONDS, cost)
        least = 1 if cost is None else self._least(remaining * runs, workers, cost)
        share = ceil(remaining * runs / (2 * max(workers, 1)))
        return min(remaining, max(least, min(wanted, share)))

    def _least(self, rows: int, workers: int, cost: float) -> int:
        """As few rows as are worth a batch: handing all of them out is to take no longer than doing them."""
        handling = HANDLING_SECONDS / max(cost, 1e-9)
        worth = min(sqrt(rows * handling), workers * handling)
        return max(_within(LEAST_SECONDS, cost), min(MOST_ROWS, int(worth)))


def _within(seconds: float, cost: float) -> int:
    """Rows that fit into a time, 1 to `MOST_ROWS`."""
    return max(1, min(MOST_ROWS, int(seconds / max(cost, 1e-9))))


class Patience:
    """How long the coordinator waits for a sign of progress from a worker that holds leases."""

    def __init__(self) -> None:
        self._turns: deque[float] = deque(maxlen=_TURNS)
        self._limit: float | None = LEASE_SECONDS

    def measure(self, seconds: float) -> None:
        """Learn how long a batch was away, from lease to result."""
        self._turns.append(seconds)
        self._limit = None

    @property
    def limit(self) -> float:
        """max(10 s, 10 x the 95th percentile of turnarounds) (docs/bus.md, rule 4)."""
        if self._limit is None and LEASE_TURNS * max(self._turns) <= LEASE_SECONDS:
            self._limit = LEASE_SECONDS
        if self._limit is None:
            turns = sorted(self._turns)
            self._limit = max(LEASE_SECONDS, LEASE_TURNS * turns[ceil(0.95 * len(turns)) - 1])
        return self._limit
