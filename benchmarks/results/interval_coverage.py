"""How often intervals hold the true value: `python -m benchmarks.results.interval_coverage`.

Two arms with the same true mean in every scene of a population of scenes. Scenes differ by a skewed number of
standard deviation 1, runs by a skewed number of standard deviation 0.5; the interval of the mean difference
over scenes is of 95 %. Percentile and BCa intervals (Efron and Tibshirani 1993, chapter 14) of the same draws
stand beside the studentised ones that this project uses.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from qdgrasp_coordinator.report.bootstrap import difference_interval, resample
from qdgrasp_coordinator.report.tables import markdown_table

Values = NDArray[np.float64]
DESIGNS = ((1, 5), (1, 10), (3, 5), (3, 10), (7, 5), (20, 5))
"""Numbers of scenes, and of runs of each arm on each."""
TAILS = np.array([0.025, 0.975])


@dataclass(frozen=True)
class Sample:
    """Runs of two arms: (scenes, 2, runs)."""

    runs: Values

    @property
    def difference(self) -> float:
        """Mean over scenes of the difference of the arms' means."""
        return float((self.runs[:, 0] - self.runs[:, 1]).mean())


def draw(scenes: int, runs: int, random: np.random.Generator) -> Sample:
    """A sample whose true difference is 0."""
    noise = random.exponential(0.5, (scenes, 2, runs)) - 0.5
    if scenes > 1:  # of one scene the difference is asked for on that scene alone
        noise[:, 0] += random.exponential(1, (scenes, 1)) - 1
    return Sample(noise)


def studentised(sample: Sample, seed: int) -> tuple[float, float]:
    """The interval of the project."""
    found = difference_interval(list(sample.runs[:, 0]), list(sample.runs[:, 1]), seed)
    return found.low, found.high


def _draws(sample: Sample, seed: int) -> Values:
    means, _ = resample([tuple(scene) for scene in sample.runs], 2000, np.random.default_rng(seed))
    drawn: Values = (means[..., 0] - means[..., 1]).mean(axis=-1)
    return drawn


def percentile(sample: Sample, seed: int) -> tuple[float, float]:
    """The percentile interval: the middle 95 % of the draws."""
    low, high = np.quantile(_draws(sample, seed), TAILS)
    return float(low), float(high)


def bca(sample: Sample, seed: int) -> tuple[float, float]:
    """The BCa interval; its jackknife leaves out scenes, or runs where there is one scene."""
    draws = _draws(sample, seed)
    bias = norm.ppf(np.clip((draws < sample.difference).mean(), 1 / len(draws), 1 - 1 / len(draws)))
    axis = 0 if len(sample.runs) > 1 else 2
    left = [Sample(np.delete(sample.runs, i, axis)).difference for i in range(sample.runs.shape[axis])]
    influence = np.mean(left) - np.array(left)
    skew = (influence**3).sum() / (6 * (influence**2).sum() ** 1.5)
    shifted = bias + norm.ppf(TAILS)
    low, high = np.quantile(draws, norm.cdf(bias + shifted / (1 - skew * shifted)))
    return float(low), float(high)


METHODS: tuple[Callable[[Sample, int], tuple[float, float]], ...] = (studentised, percentile, bca)


def shares(scenes: int, runs: int, samples: int) -> list[float]:
    """The share of samples whose interval holds 0, for each method."""
    random = np.random.default_rng((scenes, runs))
    held = np.zeros(len(METHODS))
    for number in range(samples):
        sample = draw(scenes, runs, random)
        bounds = [method(sample, number) for method in METHODS]
        held += [low <= 0 <= high for low, high in bounds]
    return list(held / samples)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--samples", type=int, default=2000)
    samples = parser.parse_args().samples
    lines = [
        (str(scenes), str(runs), *(f"{share:.1%}" for share in shares(scenes, runs, samples)))
        for scenes, runs in DESIGNS
    ]
    print(markdown_table(("scenes", "runs", *(method.__name__ for method in METHODS)), lines))


if __name__ == "__main__":
    main()
