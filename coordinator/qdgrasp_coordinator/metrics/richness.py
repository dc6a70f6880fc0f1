"""Estimates how many cells there are to find, from how many runs found each.

Runs are the sampling units, and a run has found a cell or has not (incidence data): it does not matter that a
run looks near what it found before, only that runs do not learn from each other. With m runs, Q1 cells that
one of them found and Q2 cells that two of them found, about (m - 1) / m Q1^2 / (2 Q2) cells were found by
none. That is Chao2, a lower bound (Chao 1987, "Estimating the population size for capture-recapture data with
unequal catchability"; for few units and Q2 = 0 as in Chao and Colwell 2017, "Thirty years of progeny from
Chao's inequality"). Assumptions and limits stand in docs/coverage.md.
"""

import math
from collections.abc import Callable

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

LEAST_RUNS = 2  # Of one run, every cell was found once: that says nothing of those that were not
NORMAL_QUANTILE = 1.959964  # Of 0.975, for an interval of 95 %


class RichnessEstimate(Struct, frozen=True, kw_only=True):
    """Estimated number of cells that runs like these can find."""

    runs: int
    """Sampling units, 2 or more."""
    seen: int
    """Cells that some run found, 1 or more."""
    once: int
    """Cells that one run alone found, Q1."""
    twice: int
    """Cells that two runs found, Q2."""
    unseen: float
    """Estimated number of cells that no run found: a lower bound."""
    total: float
    """`seen` and `unseen` together."""
    low: float | None
    """Lower end of the 95 % interval of `total`; None: no cell is estimated to be unseen."""
    high: float | None
    """Upper end. The logarithm of `unseen` is taken to be normal, so that all is above `seen` (Chao 1987)."""
    completeness: float
    """`seen` over `total`, above 0 to 1."""
    sample_coverage: float
    """Expected share of a further run's cells that have been seen, 0 to 1 (Chao and Jost 2012)."""

    def is_complete(self, share: float) -> bool:
        """Return whether at least this share of the estimated total has been seen."""
        return self.completeness >= share

    def further_runs(self, share: float) -> int:
        """Return how many more runs are expected to complete a share, below 1, of the total.

        A further run finds each unseen cell with the probability that the estimate implies (Chao et al. 2009,
        "Sufficient sampling for asymptotic minimum species richness estimators").
        """
        missing = share * self.total - self.seen
        if missing <= 0:
            return 0
        found_by_next = self.once / (self.runs * self.unseen + self.once)
        return math.ceil(math.log1p(-missing / self.unseen) / math.log1p(-found_by_next))

    def total_words(self, number: Callable[[float], str] = "{:.0f}".format) -> str:
        """The estimated total with its interval: "an estimated 8120 (7900 to 8400) or more"."""
        interval = ""
        if self.low is not None and self.high is not None:
            interval = f" ({number(self.low)} to {number(self.high)})"
        return f"an estimated {number(self.total)}{interval} or more"


def estimate_richness(found: NDArray[np.bool_]) -> RichnessEstimate | None:
    """Estimate how many cells there are from those that each run found, (runs, cells).

    Columns that are False throughout do not count. None with fewer than two runs, or without a cell.
    """
    runs, times = len(found), np.count_nonzero(found, axis=0)
    seen, once, twice = _frequencies(times)
    if runs < LEAST_RUNS or not seen:
        return None
    unseen, variance = _unseen_cells(runs, seen, once, twice)
    low = high = None
    if unseen:
        variance = max(variance, _jackknife_variance(found, times) if runs > LEAST_RUNS else 0.0)
        factor = math.exp(NORMAL_QUANTILE * math.sqrt(math.log1p(variance / unseen**2)))
        low, high = seen + unseen / factor, seen + unseen * factor
    return RichnessEstimate(
        runs=runs,
        seen=seen,
        once=once,
        twice=twice,
        unseen=unseen,
        total=seen + unseen,
        low=low,
        high=high,
        completeness=seen / (seen + unseen),
        sample_coverage=1.0 - once / int(times.sum()) * _rarity(runs, once, twice),
    )


def _frequencies(times: NDArray[np.integer]) -> tuple[int, int, int]:
    """Count the cells found at all, once and twice, from how often each was (n,)."""
    seen, once, twice = (np.count_nonzero(chosen) for chosen in (times > 0, times == 1, times == 2))
    return int(seen), int(once), int(twice)


def _unseen_cells(runs: int, seen: int, once: int, twice: int) -> tuple[float, float]:
    """Return the estimated number of unseen cells, and its variance for independent cells."""
    few = (runs - 1) / runs
    if twice:
        ratio = once / twice
        variance = twice * (few * ratio**2 / 2 + few**2 * ratio**3 + few**2 * ratio**4 / 4)
        return few * once * ratio / 2, variance
    if once < 2:
        return 0.0, 0.0
    unseen = few * once * (once - 1) / 2
    variance = unseen + few**2 * (once * (2 * once - 1) ** 2 - once**4 / (seen + unseen)) / 4
    return unseen, variance


def _jackknife_variance(found: NDArray[np.bool_], times: NDArray[np.integer]) -> float:
    """Return the variance of the estimated total, from leaving out each of three or more runs.

    A run finds neighbouring cells together, so that cells are not independent; runs are (Efron and Stein
    1981, "The jackknife estimate of variance").
    """
    runs, totals = len(found), []
    for its_own in found:
        seen, once, twice = _frequencies(times - its_own)
        totals.append(seen + _unseen_cells(runs - 1, seen, once, twice)[0])
    return float((runs - 1) * np.var(totals))


def _rarity(runs: int, once: int, twice: int) -> float:
    """Return the factor by which cells that were found once lower the sample coverage."""
    again = (runs - 1) * (once if twice else max(once - 1, 0))
    return again / (again + 2 * max(twice, 1))
