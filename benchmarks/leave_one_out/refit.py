"""Choosing constants from the runs on some objects, and comparing them with today's on others.

The score of a run is its number of cells with a grasp that holds, divided by the mean over all variants on
that object, so that each object weighs the same.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from benchmarks.leave_one_out.grid import GRID, TODAY, VARIANTS, Values, variant
from benchmarks.leave_one_out.runs import HELD_OUT, HELD_OUT_SEEDS, Table, tuning_runs
from benchmarks.results.programme import TUNING

from qdgrasp_tools.report.bootstrap import (
    ConfidenceInterval,
    RunValues,
    difference_interval,
    mean_interval,
)

MARGIN = 0.05
"""A difference that is certainly less than this share changes nothing that matters."""
Runs = Mapping[tuple[str, str], RunValues]
"""Numbers of the runs (n,) of a variant on an object, by seed."""


def robust_cells(table: Table, evaluations: int) -> Runs:
    """Cells that hold of the runs of this budget."""
    found: dict[tuple[str, str], list[float]] = {}
    for key, row in sorted(table.items()):
        if key.evaluations == evaluations:
            found.setdefault((key.variant, key.scene), []).append(row.robust_cells)
    return {pair: np.array(values) for pair, values in found.items()}


def scores(found: Runs, scene: str) -> dict[str, RunValues]:
    """The scores of all variants on an object; none if one has no run, or no grasp holds."""
    there = {name: found[name, scene] for name in VARIANTS if (name, scene) in found}
    mean = np.mean([values.mean() for values in there.values()]) if len(there) == len(VARIANTS) else 0.0
    return {name: values / mean for name, values in there.items()} if mean else {}


Scores = Mapping[str, Mapping[str, RunValues]]
"""Scores by object and variant."""


def mean_score(known: Scores, name: str) -> float:
    """The mean over objects of a variant's means over runs."""
    return float(np.mean([each[name].mean() for each in known.values()]))


def standard_error(known: Scores) -> float:
    """Standard error of the difference of two mean scores.

    The variance between seeds on an object is the mean of those within each of the variants.
    """
    squares = [
        2.0 * np.mean([values.var(ddof=1) / len(values) for values in each.values()])
        for each in known.values()
    ]
    return math.sqrt(sum(squares)) / len(squares)


@dataclass(frozen=True)
class Refit:
    """Constants chosen from the runs on some objects."""

    values: Values
    """Constants that replace today's."""
    error: float
    """The standard error of the difference of two mean scores."""
    clear: tuple[str, ...]
    """Names of constants whose value is better than today's by more than that."""

    @property
    def variant(self) -> str:
        return variant(self.values)


def refit(known: Scores) -> Refit:
    """Choose the value of each constant with the best mean score, with the others as they are today.

    A difference counts however small it is, so that the choice depends on the objects as much as it can. Of
    equal values today's stays.
    """
    error, today = standard_error(known), mean_score(known, TODAY)
    gains, chosen = {}, {}
    for name, one in GRID.items():
        found = {value: mean_score(known, variant({name: value})) for value in one.others}
        best = max(found, key=found.__getitem__)
        if found[best] > today:
            chosen[name], gains[name] = best, found[best] - today
    return Refit(chosen, error, tuple(name for name, gain in gains.items() if gain > error))


Refits = Mapping[str, Refit]
"""Refits by the object that was left out; "" for none."""


def refits(table: Table, evaluations: int) -> Refits:
    """The constants chosen on all tuning objects, and without each.

    Empty until all runs are finished, and where no grasp holds on one of the objects.
    """
    found = robust_cells(table, evaluations)
    known = {scene: scores(found, scene) for scene in TUNING}
    if not all(known.values()) or any(key not in table for key in tuning_runs(evaluations)):
        return {}
    return {
        left_out: refit({scene: known[scene] for scene in TUNING if scene != left_out})
        for left_out in ("", *TUNING)
    }


@dataclass(frozen=True)
class HeldOutComparison:
    """Refitted constants beside today's, in cells that hold, as shares of today's mean on each object."""

    today: ConfidenceInterval
    """Today's constants, around 1."""
    difference: ConfidenceInterval
    """Mean of the refitted constants less that of today's."""

    @property
    def is_within(self) -> bool:
        """True if the refitted mean lies in the interval of today's."""
        return self.today.low < 1.0 + self.difference.value < self.today.high

    @property
    def is_equivalent(self) -> bool:
        """True if the whole interval of the difference is within `MARGIN` of 0."""
        return max(-self.difference.low, self.difference.high) < MARGIN


def compare(found: Runs, name: str) -> HeldOutComparison:
    """Compare a variant with today's constants on the held-out objects."""
    means = [found[TODAY, scene].mean() for scene in HELD_OUT]
    today, other = (
        [found[arm, scene] / mean for scene, mean in zip(HELD_OUT, means, strict=True)]
        for arm in (TODAY, name)
    )
    return HeldOutComparison(mean_interval(today), difference_interval(other, today))


def is_complete(found: Runs, name: str) -> bool:
    """Whether all runs that `compare` looks at are finished."""
    arms = product((TODAY, name), HELD_OUT)
    return all(len(found.get(arm, ())) == len(HELD_OUT_SEEDS) for arm in arms)
