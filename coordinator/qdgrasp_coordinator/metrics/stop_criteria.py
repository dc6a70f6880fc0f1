"""Stop criteria: the ends of a run besides its budget, judged row by row in journal order.

A criterion is met by one nominal row, with any workers and at any time: that is a function of the journal,
so that a run ends with the same row however many workers it has, and however often it was resumed. CPU
seconds differ from one run of a spec to the next; simulated evaluations stand for them (docs/campaigns.md).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.cells import cell_keys, cells, orientations
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import RunSpec

Flags = NDArray[np.bool_]
"""(n,): one for each row."""
Counts = NDArray[np.int64]
Floats = NDArray[np.float64]

LEAST_OUTCOMES = {"successes": Outcome.DROPPED, "grasps": Outcome.SHAKEN}
"""Least outcome of the rows that a criterion wants so many of, by its name."""
WINDOW = 1000  # Simulated evaluations whose rate of new niches is held against that of the whole run
DIGITS = 10_000  # A share in an error is rounded down to a fraction of this


@dataclass(frozen=True)
class StopCriteria:
    """Criteria that end a run before its budget is spent; None: no such criterion."""

    successes: int | None = None
    """Nominal successes after which it ends."""
    no_new_cell: int | None = None
    """Counted evaluations after which it ends, since the last new cell or since the beginning."""
    grasps: int | None = None
    """Nominal grasps after which it ends."""
    saturation: float | None = None
    """Rate of new niches lately, over that of the whole run, at which it ends."""
    by_orientation: bool = False
    """Whether the niches of that rate are orientations in cells, in place of cells."""
    window: int = WINDOW
    """Number of the simulated evaluations that are meant by lately."""

    @classmethod
    def of(cls, spec: RunSpec) -> "StopCriteria":
        """Return the goals of a run."""
        share = spec.saturation or None
        by_orientation = share is not None and spec.diversity in ("orientation", "posture")
        return cls(spec.successes, spec.no_new_cell, spec.grasps, share, by_orientation)


class StopTracker:
    """Progress of a run towards its goals; `cells` are the keys of cells with a success so far."""

    def __init__(self, goals: StopCriteria, cells: set[int]) -> None:
        self._goals = goals
        self._cells = cells
        self._wanted = {name: n for name in LEAST_OUTCOMES if (n := getattr(goals, name)) is not None}
        self._found = dict.fromkeys(self._wanted, 0)
        self._last = Outcome.ERROR  # of the last row
        self._stale = self._most_stale = 0  # evaluations since a new cell: now, and most before the last row
        self._rate = NicheRate(goals.window, by_orientation=goals.by_orientation)

    def count(self, rows: Rows, is_counted: Flags) -> None:
        """Count the next nominal rows (n,), before their cells are known."""
        if not len(rows):
            return
        self._found = {name: int(self._counts(name, rows)[-1]) for name in self._wanted}
        self._last = Outcome(rows["outcome"][-1])
        if self._goals.no_new_cell is not None:
            stale = self._staleness(rows, is_counted)
            self._most_stale = max(self._most_stale, self._stale, int(stale[:-1].max(initial=0)))
            self._stale = int(stale[-1])
        if self._goals.saturation is not None:
            self._rate.count(rows)

    @property
    def reached(self) -> str | None:
        """The goal that is reached, in words; None: no goal is."""
        for name, wanted in self._wanted.items():
            if self._found[name] >= wanted:
                return f"{wanted} {name} are found"
        if self._goals.no_new_cell is not None and self._stale >= self._goals.no_new_cell:
            return f"the last {self._goals.no_new_cell} evaluations found no new cell"
        if self._goals.saturation is not None and self._rate.share <= self._goals.saturation:
            return f"it is saturated: the last {self._goals.window} simulated evaluations found little new"
        return None

    def rows_until_stop(self, rows: Rows, is_counted: Flags) -> int:
        """Count the next nominal rows (n,) up to the first that reaches a goal; else all."""
        ends = [len(rows)]
        for name, wanted in self._wanted.items():
            ends.append(count_to_first(self._counts(name, rows) >= wanted))
        if self._goals.no_new_cell is not None:
            ends.append(count_to_first(self._staleness(rows, is_counted) >= self._goals.no_new_cell))
        if self._goals.saturation is not None:
            ends.append(count_to_first(self._rate.shares(rows) <= self._goals.saturation))
        return min(ends)

    def check(self) -> None:
        """Raise `ImpossibleValue` if a goal was reached before the last row that was counted."""
        for name, wanted in self._wanted.items():
            least = self._found[name] + (self._last < LEAST_OUTCOMES[name])
            if wanted < least:
                raise ImpossibleValue(name, wanted, f"at least {least}, which are recorded")
        if self._goals.no_new_cell is not None and self._goals.no_new_cell <= self._most_stale:
            raise ImpossibleValue(
                "no_new_cell",
                self._goals.no_new_cell,
                f"at least {self._most_stale + 1}: so long a stretch without a new cell is recorded",
            )
        if self._goals.saturation is not None and self._goals.saturation >= self._rate.least:
            bound = math.floor(self._rate.least * DIGITS) / DIGITS
            raise ImpossibleValue(
                "saturation", self._goals.saturation, f"less than {bound}: so small a share is recorded"
            )

    def _counts(self, name: str, rows: Rows) -> Counts:
        """Number of rows that a criterion wants so many of at each row: (n,)."""
        return self._found[name] + np.cumsum(rows["outcome"] >= LEAST_OUTCOMES[name])

    def _staleness(self, rows: Rows, is_counted: Flags) -> Counts:
        """Counted evaluations since the last new cell at each row: (n,)."""
        done = np.cumsum(is_counted)
        fresh = np.where(self._is_new(rows), done, -self._stale)
        return done - np.maximum.accumulate(fresh)

    def _is_new(self, rows: Rows) -> Flags:
        """Flag the rows that reach a new cell: (n,)."""
        found = np.flatnonzero(rows["outcome"] >= Outcome.DROPPED)
        reached, places = np.unique(cell_keys(cells(rows["descriptor"][found, :3])), return_index=True)
        is_unknown = [key not in self._cells for key in reached.tolist()]
        is_new = np.zeros(len(rows), dtype=bool)
        is_new[found[places[is_unknown]]] = True
        return is_new


class NicheRate:
    """Rate of new niches with a grasp: over the last simulated evaluations, and over all.

    The share of the one in the other falls as an object is saturated, and not where grasps are rare from the
    beginning. The last `window` evaluations are taken to have found one niche more: of few, chance decides.
    """

    def __init__(self, window: int, *, by_orientation: bool) -> None:
        self.share = math.inf
        """Share at the last row; infinite while the run is shorter than the window."""
        self.least = math.inf
        """Least share before the last row."""
        self._window = window
        self._by_orientation = by_orientation
        self._niches: set[tuple[int, int]] = set()  # Cell and orientation bin of each; 0 without these
        self._simulated = 0
        self._history = np.zeros(1, np.int64)  # Niches after each of the last simulated evaluations

    def count(self, rows: Rows) -> None:
        """Count the next nominal rows: (n,), n > 0."""
        shares, first = self.shares(rows), self._first_of_niche(rows)
        self.least = min(self.least, self.share, float(shares[:-1].min(initial=math.inf)))
        self.share = float(shares[-1])
        is_simulated = rows["outcome"] >= Outcome.MISSED
        self._history = self._extended_history(rows, first)[-self._window :]
        self._simulated += int(np.count_nonzero(is_simulated))
        self._niches |= first.keys()

    def shares(self, rows: Rows) -> Floats:
        """Share at each of the next nominal rows: (n,)."""
        history, known = self._extended_history(rows, self._first_of_niche(rows)), len(self._history)
        ends = np.arange(max(known, self._window), len(history))
        simulated = self._simulated + 1 + ends - known
        shares = np.full(len(history), math.inf)
        shares[known - 1] = self.share
        found = history[ends] - history[ends - self._window]
        shares[ends] = (found + 1) * simulated / (self._window * np.maximum(history[ends], 1))
        latest: Floats = shares[known - 1 + np.cumsum(rows["outcome"] >= Outcome.MISSED)]
        return latest

    def _extended_history(self, rows: Rows, first: dict[tuple[int, int], int]) -> Counts:
        is_new = np.zeros(len(rows), dtype=bool)
        is_new[list(first.values())] = True
        found = len(self._niches) + np.cumsum(is_new)
        return np.concatenate([self._history, found[rows["outcome"] >= Outcome.MISSED]])

    def _first_of_niche(self, rows: Rows) -> dict[tuple[int, int], int]:
        """Return the first row of each niche that is new with a grasp in it."""
        places = np.flatnonzero(rows["outcome"] >= Outcome.SHAKEN)
        found = cell_keys(cells(rows["descriptor"][places, :3])).tolist()
        kinds = [0] * len(found)
        if self._by_orientation:
            kinds = orientations(rows["base_to_object"][places, 3:]).tolist()
        first: dict[tuple[int, int], int] = {}
        for place, niche in zip(places.tolist(), zip(found, kinds, strict=True), strict=True):
            if niche not in self._niches:
                first.setdefault(niche, place)
        return first


def count_to_first(reached: Flags) -> int:
    """Count rows up to the first that reaches something, that one included; else all."""
    return int(reached.argmax()) + 1 if reached.any() else len(reached)
