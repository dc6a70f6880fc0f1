"""How often intervals hold the true value: `python -m benchmarks.results.interval_coverage`.

Two arms with the same true mean in every scene of a population of scenes. Scenes differ by a skewed number of
standard deviation 1, runs by a skewed number of standard deviation 0.5; the interval of the mean difference
over scenes is of 95 %. With few scenes it is for these scenes, and the true value is their mean. Percentile
and BCa intervals (Efron and Tibshirani 1993, chapter 14) of the same draws stand beside the studentised ones
that this project uses; so do the interval of a ratio, of arms that half of these numbers multiply as
exponents, and the shares of p-values of the difference up to 0.05 and 0.001.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from qdgrasp_tools.report.bootstrap import (
    LEAST_SCENES,
    difference_interval,
    ratio_interval,
    resample,
)
from qdgrasp_tools.report.tables import markdown_table

Values = NDArray[np.float64]
DESIGNS = ((1, 5), (1, 10), (3, 5), (3, 10), (10, 5), (20, 5), (50, 5))
"""Numbers of scenes, and of runs of each arm on each."""
MEAN_SHARE = float((1 / (1 + np.exp((1 - np.random.default_rng(0).exponential(1, 10**6)) / 2))).mean())
"""The mean over scenes of the upper arm's share in both, of arms that are exponents."""
LEVELS = (0.05, 0.001)
"""Shares of p-values that are at most so large are these, if p-values are right."""
TAILS = np.array([0.025, 0.975])


@dataclass(frozen=True)
class Sample:
    """Runs of two arms."""

    runs: Values
    """(scenes, 2, runs)"""
    effects: Values
    """The true effect of each scene, of mean 0 over the population: (scenes,)."""

    @property
    def difference(self) -> float:
        """Mean over scenes of the difference of the arms' means."""
        return float((self.runs[:, 0] - self.runs[:, 1]).mean())

    @property
    def truth(self) -> float:
        """The true difference: over the population, or over these scenes if there are few."""
        return 0.0 if len(self.effects) >= LEAST_SCENES else float(self.effects.mean())


def draw(scenes: int, runs: int, random: np.random.Generator) -> Sample:
    """A sample whose true difference over the population is 0."""
    effects = random.exponential(1, scenes) - 1
    noise = random.exponential(0.5, (scenes, 2, runs)) - 0.5
    noise[:, 0] += effects[:, None]
    return Sample(noise, effects)


def studentised(sample: Sample, seed: int) -> tuple[float, float]:
    """The interval of the project."""
    found = difference_interval(list(sample.runs[:, 0]), list(sample.runs[:, 1]), seed)
    return found.low, found.high


def holds_ratio(sample: Sample, seed: int) -> bool:
    """Whether the interval of a ratio holds the true one: of half of these numbers, as exponents."""
    upper, lower = np.exp(np.moveaxis(sample.runs, 1, 0) / 2)
    shares = 1 / (1 + np.exp(-sample.effects / 2))  # the arms' runs are alike but for the scene's effect
    share = MEAN_SHARE if len(shares) >= LEAST_SCENES else shares.mean()
    found = ratio_interval(list(upper), list(lower), seed)
    return found.low <= share / (1 - share) <= found.high


def _draws(sample: Sample, seed: int) -> Values:
    means, _ = resample(
        [tuple(scene) for scene in sample.runs],
        2000,
        np.random.default_rng(seed),
        len(sample.runs) >= LEAST_SCENES,
    )
    drawn: Values = (means[..., 0] - means[..., 1]).mean(axis=-1)
    return drawn


def percentile(sample: Sample, seed: int) -> tuple[float, float]:
    """The percentile interval: the middle 95 % of the draws."""
    low, high = np.quantile(_draws(sample, seed), TAILS)
    return float(low), float(high)


def bca(sample: Sample, seed: int) -> tuple[float, float]:
    """The BCa interval; its jackknife leaves out scenes, or where these are few a run of one arm."""
    draws = _draws(sample, seed)
    bias = norm.ppf(np.clip((draws < sample.difference).mean(), 1 / len(draws), 1 - 1 / len(draws)))
    scenes, _, runs = sample.runs.shape
    if scenes >= LEAST_SCENES:
        effects = sample.runs[:, 0].mean(axis=1) - sample.runs[:, 1].mean(axis=1)
        left = (effects.sum() - effects) / (scenes - 1)
    else:
        changes = (sample.runs.mean(axis=2, keepdims=True) - sample.runs) / (runs - 1)
        left = sample.difference + np.concatenate([changes[:, 0], -changes[:, 1]], axis=None) / scenes
    influence = left.mean() - left
    skew = (influence**3).sum() / (6 * (influence**2).sum() ** 1.5)
    shifted = bias + norm.ppf(TAILS)
    low, high = np.quantile(draws, norm.cdf(bias + shifted / (1 - skew * shifted)))
    return float(low), float(high)


METHODS: tuple[Callable[[Sample, int], tuple[float, float]], ...] = (studentised, percentile, bca)
COLUMNS = (*(method.__name__ for method in METHODS), "ratio", *(f"p <= {level:g}" for level in LEVELS))


def shares(scenes: int, runs: int, samples: int) -> list[float]:
    """Shares of samples whose intervals hold the truth: of each method, of a ratio; and of low p-values."""
    random = np.random.default_rng((scenes, runs))
    held = np.zeros(len(COLUMNS))
    for number in range(samples):
        sample = draw(scenes, runs, random)
        bounds = [method(sample, number) for method in METHODS]
        shifted = sample.runs - np.array([[sample.truth], [0.0]])  # without an effect
        p_value = difference_interval(list(shifted[:, 0]), list(shifted[:, 1]), number).p_value
        held += [
            *(low <= sample.truth <= high for low, high in bounds),
            holds_ratio(sample, number),
            *(p_value <= level for level in LEVELS),
        ]
    return list(held / samples)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--samples", type=int, default=2000)
    samples = parser.parse_args().samples
    lines = [
        (str(scenes), str(runs), *(f"{share:.1%}" for share in shares(scenes, runs, samples)))
        for scenes, runs in DESIGNS
    ]
    print(markdown_table(("scenes", "runs", *COLUMNS), lines))


if __name__ == "__main__":
    main()
