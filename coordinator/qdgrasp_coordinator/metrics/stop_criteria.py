"""Stop criteria: the ends of a run besides its budget, judged row by row in journal order.

A criterion is met by one nominal row, with any workers and at any time: that is a function of the journal,
so that a run ends with the same row however many workers it has, and however often it was resumed. CPU
seconds differ from one run of a spec to the next; simulated evaluations stand for them (docs/campaigns.md).
"""

import math

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.cells import cell_keys, cells, orientations
from qdgrasp_coordinator.metrics.contact_niches import contact_niches
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import DiversityName, RunSpec

Flags = NDArray[np.bool_]
"""(n,): one for each row."""
Counts = NDArray[np.int64]
Floats = NDArray[np.float64]

WINDOW = 1000  # Simulated evaluations whose rate of new niches is held against that of the whole run


class StopTracker:
    """Progress of a run towards the goals of its spec: grasps, and a saturation other than 0."""

    def __init__(self, spec: RunSpec) -> None:
        self._least_grasps, self._saturation = spec.grasps, spec.saturation or None
        self._grasps, self.is_passed = 0, False  # Whether rows go on behind a goal
        self._rate = NicheRate(spec.diversity)

    def count(self, rows: Rows) -> None:
        """Count the next nominal rows (n,)."""
        self.is_passed |= (0 if self.reached else self.rows_until_stop(rows)) < len(rows)
        self._grasps += int(np.count_nonzero(rows["outcome"] >= Outcome.SHAKEN))
        if self._saturation is not None and len(rows):
            self._rate.count(rows)

    @property
    def reached(self) -> str | None:
        """The goal that is reached, in words; None: no goal is."""
        if self._least_grasps is not None and self._grasps >= self._least_grasps:
            return f"{self._least_grasps} grasps are found"
        if self._saturation is not None and self._rate.share <= self._saturation:
            return f"it is saturated: the last {self._rate.window} simulated evaluations found little new"
        return None

    def rows_until_stop(self, rows: Rows) -> int:
        """Count the next nominal rows (n,) up to the first that reaches a goal; else all."""
        ends = [len(rows)]
        if self._least_grasps is not None:
            found = self._grasps + np.cumsum(rows["outcome"] >= Outcome.SHAKEN)
            ends.append(count_to_first(found >= self._least_grasps))
        if self._saturation is not None:
            ends.append(count_to_first(self._rate.shares(rows) <= self._saturation))
        return min(ends)


class NicheRate:
    """Rate of new niches with a grasp: over the last simulated evaluations, and over all.

    The share of the one in the other falls as an object is saturated, and not where grasps are rare from the
    beginning. The last `WINDOW` evaluations are taken to have found one niche more: of few, chance decides.
    """

    def __init__(self, by: DiversityName | None) -> None:
        self.share = math.inf
        """Share at the last row; infinite while the run is shorter than the window."""
        self.window = WINDOW
        self._by = by
        self._niches: set[tuple[int, int]] = set()  # Cell and orientation bin of each, 0 without these
        self._simulated = 0
        self._history = np.zeros(1, np.int64)  # Niches after each of the last simulated evaluations

    def count(self, rows: Rows) -> None:
        """Count the next nominal rows: (n,), n > 0."""
        first = self._first_of_niche(rows)
        self.share = float(self.shares(rows)[-1])
        is_simulated = rows["outcome"] >= Outcome.MISSED
        self._history = self._extended_history(rows, first)[-self.window :]
        self._simulated += int(np.count_nonzero(is_simulated))
        self._niches |= first.keys()

    def shares(self, rows: Rows) -> Floats:
        """Share at each of the next nominal rows: (n,)."""
        history, known = self._extended_history(rows, self._first_of_niche(rows)), len(self._history)
        ends = np.arange(max(known, self.window), len(history))
        simulated = self._simulated + 1 + ends - known
        shares = np.full(len(history), math.inf)
        shares[known - 1] = self.share
        found = history[ends] - history[ends - self.window]
        shares[ends] = (found + 1) * simulated / (self.window * np.maximum(history[ends], 1))
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
        is_contact = self._by == "contact"
        found = (
            contact_niches(rows[places]) if is_contact else cell_keys(cells(rows["descriptor"][places, :3]))
        ).tolist()
        kinds = [0] * len(found)
        if self._by == "orientation":
            kinds = orientations(rows["base_to_object"][places, 3:]).tolist()
        first: dict[tuple[int, int], int] = {}
        for place, niche in zip(places.tolist(), zip(found, kinds, strict=True), strict=True):
            if niche not in self._niches:
                first.setdefault(niche, place)
        return first


def count_to_first(reached: Flags) -> int:
    """Count rows up to the first that reaches something, that one included; else all."""
    return int(reached.argmax()) + 1 if reached.any() else len(reached)
