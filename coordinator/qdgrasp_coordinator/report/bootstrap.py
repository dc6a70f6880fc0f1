"""Bootstrap intervals of means, differences and ratios over scenes and runs.

A hierarchical bootstrap with studentised intervals (Efron and Tibshirani 1993, chapter 12; Davison and
Hinkley 1997, section 3.8): scenes are drawn with replacement, and on each its runs. Percentile intervals,
corrected for bias and acceleration or not, hold the true value less often than they say where there are five
runs or few scenes (docs/analysis.md has how often each does).

Arms are never paired: searches that begin with the same seed share no stream of random numbers.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

RESAMPLES = 10_000
CONFIDENCE_LEVEL = 0.95
RESAMPLING_SEED = 0
LEAST_RUNS = 5
"""Runs of each arm on each scene without which nothing is said of chance: of fewer, draws repeat one run."""
RunValues = NDArray[np.float64]
ScenesOfRuns = Sequence[RunValues]  # For each scene the values of its runs (n,)
ArmEstimates = tuple[RunValues, RunValues]
"""Mean of each arm on each scene, and the variance of that mean: (..., scenes, arms)."""
SceneEffect = Callable[[RunValues, RunValues], ArmEstimates]
"""Makes of these the effect on each scene, and its variance: (..., scenes)."""


@dataclass(frozen=True)
class ConfidenceInterval:
    """A number with its bootstrap interval."""

    value: float
    low: float
    """NaN, as `high` and `p_value`, where an arm has fewer than five runs on a scene."""
    high: float
    scenes: int
    runs: tuple[int, ...]
    """Number of runs of each arm, over all scenes."""
    p_value: float = np.nan
    """Two-sided p-value of the hypothesis that the number is `null`."""
    null: float = 0.0
    """The number without an effect: 0, of a ratio 1."""

    @property
    def is_known(self) -> bool:
        """True if there is an interval at all."""
        return not np.isnan(self.low)


def mean_interval(values: ScenesOfRuns, seed: int = RESAMPLING_SEED) -> ConfidenceInterval:
    """Mean over scenes of means over runs; scenes without a run are left out."""
    some = [(found,) for found in values if len(found)]
    return _interval(some, 1, lambda mean, variance: (mean[..., 0], variance[..., 0]), seed)


def difference_interval(
    upper: ScenesOfRuns, lower: ScenesOfRuns, seed: int = RESAMPLING_SEED
) -> ConfidenceInterval:
    """Mean over scenes of the upper arm's mean less the lower's.

    Scenes where an arm has no run are left out.
    """
    some = [(a, b) for a, b in zip(upper, lower, strict=True) if len(a) and len(b)]
    return _interval(
        some, 2, lambda mean, variance: (mean[..., 0] - mean[..., 1], variance.sum(axis=-1)), seed
    )


def ratio_interval(
    upper: ScenesOfRuns, lower: ScenesOfRuns, seed: int = RESAMPLING_SEED
) -> ConfidenceInterval:
    """Ratio of two arms, their means in each scene scaled to a mean of 1 over both.

    So each scene weighs the same, however large its numbers are, and exchanging the arms gives the
    reciprocal. The interval is that of the upper arm's share in the sum of both. Scenes where an arm has no
    run, or where both found nothing, are left out. Infinite where the lower arm found nothing.
    """
    some = [
        (a, b) for a, b in zip(upper, lower, strict=True) if len(a) and len(b) and a.mean() + b.mean() > 0
    ]
    found = _interval(some, 2, _upper_share, seed, null=0.5)
    ratio, low, high = (_ratio_of(share) for share in (found.value, found.low, found.high))
    return ConfidenceInterval(ratio, low, high, found.scenes, found.runs, found.p_value, null=1.0)


def _upper_share(mean: RunValues, variance: RunValues) -> ArmEstimates:
    """The upper arm's share in both, 0 to 1, and its variance to first order."""
    (a, b), (var_a, var_b) = np.moveaxis(mean, -1, 0), np.moveaxis(variance, -1, 0)
    total = a + b
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(total > 0, a / total, 0.5)
        spread = np.where(total > 0, (b**2 * var_a + a**2 * var_b) / total**4, 0.0)
    return share, spread


def _ratio_of(share: float) -> float:
    within = min(max(share, 0.0), 1.0)
    return np.nan if np.isnan(share) else np.inf if within == 1 else within / (1 - within)


def _interval(
    scenes: Sequence[tuple[RunValues, ...]], arms: int, effect: SceneEffect, seed: int, null: float = 0.0
) -> ConfidenceInterval:
    """The studentised interval of the mean effect over scenes, and its p-value against `null`."""
    runs = tuple(sum(len(scene[arm]) for scene in scenes) for arm in range(arms))
    if not scenes:
        return ConfidenceInterval(np.nan, np.nan, np.nan, 0, runs)
    mean, variance = (
        np.array([[of(arm) for arm in scene] for scene in scenes]) for of in (np.mean, _variance_of_mean)
    )
    value, error = (float(number) for number in _estimate(*effect(mean, variance)))
    if min(len(arm) for scene in scenes for arm in scene) < LEAST_RUNS:
        return ConfidenceInterval(value, np.nan, np.nan, len(scenes), runs)
    drawn, errors = _estimate(*effect(*resample(scenes, RESAMPLES, np.random.default_rng(seed))))
    pivots = _pivots(drawn - value, errors)
    tail = (1 - CONFIDENCE_LEVEL) / 2
    least, most = np.quantile(pivots, (tail, 1 - tail), method="inverted_cdf")  # of infinite ones too
    low, high = (value - pivot * error if error else value for pivot in (most, least))
    return ConfidenceInterval(
        value, float(low), float(high), len(scenes), runs, _p_value(pivots, _pivots(value - null, error))
    )


def _variance_of_mean(values: RunValues) -> float:
    """Variance of the mean of some runs; 0 of a single one."""
    return float(values.var(ddof=1) / len(values)) if len(values) > 1 else 0.0


def _estimate(effects: RunValues, variances: RunValues) -> tuple[RunValues, RunValues]:
    """The mean over scenes (..., scenes) and its standard error.

    The error is that of scenes as they differ, or that of their runs where this is greater.
    """
    scenes = effects.shape[-1]
    variance = variances.mean(axis=-1) / scenes
    if scenes > 1:
        variance = np.maximum(variance, effects.var(axis=-1, ddof=1) / scenes)
    return effects.mean(axis=-1), np.sqrt(variance)


def _pivots(differences: ArrayLike, errors: ArrayLike) -> RunValues:
    """Differences in units of their standard errors; of an error of 0 infinite, or 0."""
    some, units = np.asarray(differences, np.float64), np.asarray(errors, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where((some == 0) & (units == 0), 0.0, some / units)


def _p_value(pivots: RunValues, found: RunValues) -> float:
    """Twice the share of pivots that are at least as far to the side where the found one is."""
    beyond = min(np.count_nonzero(pivots >= found), np.count_nonzero(pivots <= found))
    return min(1.0, 2 * (beyond + 1) / (len(pivots) + 1))


def resample(
    scenes: Sequence[tuple[RunValues, ...]], resamples: int, random: np.random.Generator
) -> ArmEstimates:
    """Draw scenes, and runs in each: (resamples, scenes, arms) means and variances of means."""
    chosen = random.integers(len(scenes), size=(resamples, len(scenes)))
    means = np.zeros((*chosen.shape, len(scenes[0])))
    variances = np.zeros_like(means)
    for number, scene in enumerate(scenes):
        places = chosen == number
        for arm, values in enumerate(scene):
            drawn = values[random.integers(len(values), size=(int(places.sum()), len(values)))]
            means[..., arm][places] = drawn.mean(axis=1)
            variances[..., arm][places] = drawn.var(axis=1, ddof=1) / len(values)
    return means, variances


def holm(p_values: ArrayLike) -> RunValues:
    """Adjusted p-values (n,) of a family of comparisons (Holm 1979); NaN ones are no part of it.

    A comparison is significant at a level where its adjusted p-value is at most that level.
    """
    given = np.asarray(p_values, np.float64)
    adjusted = np.full(given.shape, np.nan)
    known = np.flatnonzero(~np.isnan(given))
    order = known[np.argsort(given[known], kind="stable")]
    steps = given[order] * np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0) if len(order) else steps
    return adjusted
