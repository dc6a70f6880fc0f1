"""Bootstrap: intervals for means and ratios over scenes and the runs on them.

Runs of one scene resemble each other more than runs of two, so that both are drawn again, scenes first and
then in each drawn scene its runs, with replacement (a hierarchical bootstrap; Efron and Tibshirani 1993,
chapters 8 and 13). Intervals are of percentiles. With one scene they speak of that scene alone, and with few
runs they are too narrow: of two runs, the interval of the mean reaches from one to the other.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

RESAMPLES = 5000
LEVEL = 0.95
SEED = 0
Values = NDArray[np.float64]
Arm = Sequence[Values]
"""For each scene the values of its runs (n,)."""


@dataclass(frozen=True)
class Interval:
    """A number with its bootstrap interval."""

    value: float
    low: float
    """NaN, as `high`: there is nothing to draw from, or only one run in each scene of only one scene."""
    high: float
    scenes: int
    runs: tuple[int, ...]
    """Of each arm, over all scenes."""

    @property
    def is_known(self) -> bool:
        """Whether there is an interval at all."""
        return not np.isnan(self.low)


def mean(values: Arm, seed: int = SEED) -> Interval:
    """The mean over scenes of the means over runs; scenes without a run are left out."""
    some = [found for found in values if len(found)]
    return _interval([(found,) for found in some], lambda arms: arms[..., 0].mean(axis=-1), 1, seed)


def ratio(upper: Arm, lower: Arm, seed: int = SEED) -> Interval:
    """The ratio of two arms, their means in each scene scaled to a mean of 1 over both.

    So each scene weighs the same, however large its numbers are, and exchanging the arms gives the
    reciprocal. Scenes where an arm has no run, or where both found nothing, are left out. Infinite where the
    lower arm found nothing.
    """
    some = [
        (a, b) for a, b in zip(upper, lower, strict=True) if len(a) and len(b) and a.mean() + b.mean() > 0
    ]
    scaled = [tuple(2 * arm / (a.mean() + b.mean()) for arm in (a, b)) for a, b in some]
    return _interval(scaled, _quotient, 2, seed)


def _quotient(arms: Values) -> Values:
    above, below = arms.sum(axis=-2)[..., 0], arms.sum(axis=-2)[..., 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        quotient: Values = np.where((above == 0) & (below == 0), 1.0, above / below)
    return quotient


def _interval(
    scenes: Sequence[tuple[Values, ...]], statistic: Callable[[Values], Values], arms: int, seed: int
) -> Interval:
    runs = tuple(sum(len(scene[arm]) for scene in scenes) for arm in range(arms))
    if not scenes:
        return Interval(np.nan, np.nan, np.nan, 0, runs)
    means = np.array([[arm.mean() for arm in scene] for scene in scenes])
    value = float(statistic(means))
    if len(scenes) == 1 and min(runs) < 2:
        return Interval(value, np.nan, np.nan, 1, runs)
    tail = (1 - LEVEL) / 2
    drawn = statistic(resampled(scenes, RESAMPLES, np.random.default_rng(seed)))
    low, high = np.quantile(drawn, (tail, 1 - tail), method="inverted_cdf")  # of infinite ones too
    return Interval(value, float(low), float(high), len(scenes), runs)


def resampled(scenes: Sequence[tuple[Values, ...]], resamples: int, random: np.random.Generator) -> Values:
    """Means of each arm in each drawn scene: (resamples, scenes, arms)."""
    chosen = random.integers(len(scenes), size=(resamples, len(scenes)))
    means = np.empty((*chosen.shape, len(scenes[0])))
    for number, scene in enumerate(scenes):
        places = chosen == number
        for arm, values in enumerate(scene):
            drawn = random.integers(len(values), size=(int(places.sum()), len(values)))
            means[..., arm][places] = values[drawn].mean(axis=1)
    return means
