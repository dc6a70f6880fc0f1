"""Bootstrap intervals of means, differences and ratios over scenes and runs.

A hierarchical bootstrap with studentised intervals (Efron and Tibshirani 1993, chapter 12; Davison and
Hinkley 1997, section 3.8): scenes are drawn with replacement, and on each its runs. With few scenes only runs
are drawn, and the interval is for these scenes: no interval of so few holds the true value for others as
often as it says. Percentile intervals, corrected for bias and acceleration or not, hold it less often than
studentised ones (docs/analysis.md has how often each does).

Arms are never paired. Runs with one seed may share the points of the surface, and of methods with one prior
the first generation: where that makes them alike, intervals are wider than they need to be.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

RESAMPLES = 10_000
CONFIDENCE_LEVEL = 0.95
RESAMPLING_SEED = 0
LEAST_RUNS = 5
"""Runs of each arm on each scene without which nothing is said of chance: of fewer, draws repeat one run."""
LEAST_SCENES = 10
"""Scenes without which nothing is said of other scenes than these."""
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
    """NaN, as `high` and `p_value`: an arm has fewer than five runs on a scene, or no scene counts."""
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


def share_interval(values: ScenesOfRuns, seed: int = RESAMPLING_SEED) -> ConfidenceInterval:
    """The same of shares, whose interval is cut at 0 and 1."""
    found = mean_interval(values, seed)
    return replace(found, low=float(np.clip(found.low, 0, 1)), high=float(np.clip(found.high, 0, 1)))


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
    reciprocal. The interval is that of the ratio's logarithm. Scenes where an arm has no run, or where both
    found nothing, are left out. Infinite where the lower arm found nothing.
    """
    some = [
        (a, b) for a, b in zip(upper, lower, strict=True) if len(a) and len(b) and a.mean() + b.mean() > 0
    ]
    found = _interval(some, 2, _upper_share, seed, _log_odds)
    ratio, low, high = (float(np.exp(number)) for number in (found.value, found.low, found.high))
    return ConfidenceInterval(ratio, low, high, found.scenes, found.runs, found.p_value, null=1.0)


def _upper_share(mean: RunValues, variance: RunValues) -> ArmEstimates:
    """The upper arm's share in both, 0 to 1, and its variance to first order."""
    (a, b), (var_a, var_b) = np.moveaxis(mean, -1, 0), np.moveaxis(variance, -1, 0)
    total = a + b
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(total > 0, a / total, 0.5)
        spread = np.where(total > 0, (b**2 * var_a + a**2 * var_b) / total**4, 0.0)
    return share, spread


def _log_odds(share: RunValues, error: RunValues) -> tuple[RunValues, RunValues]:
    """The logarithm of the ratio of a share to the rest, and its standard error to first order."""
    inside = (share > 0) & (share < 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log(share / (1 - share)), np.where(inside, error / (share * (1 - share)), 0.0)


def _unchanged(value: RunValues, error: RunValues) -> tuple[RunValues, RunValues]:
    return value, error


def _interval(
    scenes: Sequence[tuple[RunValues, ...]],
    arms: int,
    effect: SceneEffect,
    seed: int,
    scale: Callable[[RunValues, RunValues], tuple[RunValues, RunValues]] = _unchanged,
) -> ConfidenceInterval:
    """The studentised interval of the mean effect on a scale, and its p-value against 0."""
    runs = tuple(sum(len(scene[arm]) for scene in scenes) for arm in range(arms))
    if not scenes:
        return ConfidenceInterval(np.nan, np.nan, np.nan, 0, runs)
    mean, variance = (
        np.array([[of(arm) for arm in scene] for scene in scenes]) for of in (np.mean, _variance_of_mean)
    )
    of_others = len(scenes) >= LEAST_SCENES
    value, error = (float(number) for number in scale(*_estimate(*effect(mean, variance), of_others)))
    if min(len(arm) for scene in scenes for arm in scene) < LEAST_RUNS:
        return ConfidenceInterval(value, np.nan, np.nan, len(scenes), runs)
    drawn = effect(*resample(scenes, RESAMPLES, np.random.default_rng(seed), of_others))
    values, errors = scale(*_estimate(*drawn, of_others))
    pivots = _pivots(values, value, errors)
    tail = (1 - CONFIDENCE_LEVEL) / 2
    least, most = np.quantile(pivots, (tail, 1 - tail), method="inverted_cdf")  # of infinite ones too
    low, high = (value - pivot * error if error else value for pivot in (most, least))
    if np.mean(errors == 0) > tail:  # many draws without spread, as of an arm that mostly finds nothing
        low, high = np.quantile(values, (tail, 1 - tail), method="inverted_cdf")
    p_value = _p_value(pivots, _pivots(np.array([value]), 0.0, np.array([error])))
    return ConfidenceInterval(value, float(low), float(high), len(scenes), runs, p_value)


def _variance_of_mean(values: RunValues) -> float:
    """Variance of the mean of some runs; 0 of a single one."""
    return float(values.var(ddof=1) / len(values)) if len(values) > 1 else 0.0


def _estimate(effects: RunValues, variances: RunValues, of_others: bool) -> tuple[RunValues, RunValues]:
    """The mean over scenes (..., scenes) and its standard error.

    The error is that of the scenes' runs; if it is also `of_others`, that of scenes where this is greater.
    """
    scenes = effects.shape[-1]
    variance = variances.mean(axis=-1) / scenes
    if of_others:
        variance = np.maximum(variance, effects.var(axis=-1, ddof=1) / scenes)
    return effects.mean(axis=-1), np.sqrt(variance)


def _pivots(values: RunValues, centre: float, errors: RunValues) -> RunValues:
    """Distances from a centre in units of standard errors.

    With an error of 0 they are infinite, or 0 at the centre.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(values == centre, 0.0, (values - centre) / errors)


def _p_value(pivots: RunValues, found: RunValues) -> float:
    """Twice the share of pivots that are at least as far to the side where the found one is."""
    beyond = min(np.count_nonzero(pivots >= found), np.count_nonzero(pivots <= found))
    return min(1.0, 2 * (beyond + 1) / (len(pivots) + 1))


def resample(
    scenes: Sequence[tuple[RunValues, ...]], resamples: int, random: np.random.Generator, of_others: bool
) -> ArmEstimates:
    """Draw runs in each scene, and if `of_others` scenes.

    Returns means and variances of means (resamples, scenes, arms).
    """
    if of_others:
        chosen = random.integers(len(scenes), size=(resamples, len(scenes)))
    else:
        chosen = np.broadcast_to(np.arange(len(scenes)), (resamples, len(scenes)))
    means = np.zeros((*chosen.shape, len(scenes[0])))
    variances = np.zeros_like(means)
    for number, scene in enumerate(scenes):
        places = chosen == number
        for arm, values in enumerate(scene):
            drawn = values[random.integers(len(values), size=(int(places.sum()), len(values)))]
            means[..., arm][places] = drawn.mean(axis=1)
            variances[..., arm][places] = drawn.var(axis=1, ddof=1) / len(values)
    return means, variances
