"""Logistic regression, fitted now and then to the latest of what was heard."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_assets.rotation import Floats

MEMORY = 2048
"""The last examples that a fit looks at."""
PATIENCE = 256
"""Examples between two fits."""
FEW = 10
"""So many successes and so many failures must be there before the first fit."""
NEWTON_STEPS = 5
RIDGE = 1.0
"""Precision of the weights' prior, N(mean, 1 / RIDGE), features in their units; it keeps a fit finite when
features tell all."""
STEADY = 1e-9
"""The variance below which a feature is taken for constant."""
GRAIN = 64
"""Weights are whole multiples of 1 / GRAIN: the last bits of a fit, which differ between processors, do not
reach the genomes."""


class Logistic:
    """How likely a success is, given numbers of which the last is constant.

    Parameters
    ----------
    start
        (features,): the weights until the first fit, and the mean of their prior in all fits.
    own_units
        Whether the unit of each feature is its standard deviation, instead of 1: what is small then tells as
        much as what is large.
    """

    def __init__(self, start: ArrayLike, *, own_units: bool = False) -> None:
        self._start = _in_grains(np.asarray(start, np.float64))
        self.weights: Floats = self._start
        """One for each feature, in whole grains."""
        self._own_units = own_units
        self._features = np.zeros((MEMORY, len(self._start)))
        self._successes = np.zeros(MEMORY, np.bool_)
        self._heard = 0
        self._fitted = 0

    def learn(self, features: Floats, successes: NDArray[np.bool_]) -> None:
        """Hear of examples: features (n, k) and which of them were successes."""
        features, successes = features[-MEMORY:], successes[-MEMORY:]
        places = (self._heard + np.arange(len(features))) % MEMORY
        self._features[places], self._successes[places] = features, successes
        self._heard += len(features)
        known = min(self._heard, MEMORY)
        if self._heard - self._fitted >= PATIENCE and _is_telling(self._successes[:known]):
            self._fitted = self._heard
            features, successes = self._features[:known], self._successes[:known]
            precision = RIDGE * (_variances(features) if self._own_units else np.ones(len(self._start)))
            self.weights = _in_grains(fit(features, successes, self._start, precision))

    def likely(self, features: Floats) -> Floats:
        """The probability (n,) of success for features (n, k)."""
        return _likely(features, self.weights)


def fit(features: Floats, successes: NDArray[np.bool_], mean: Floats, precision: Floats) -> Floats:
    """The weights (k,) of features (n, k), by Newton's method from zero.

    Mean and precision (k,) are those of their prior. Sums are einsum's own loops: no matrix library with
    threads, for so little.
    """
    weights = np.zeros(features.shape[1])
    for _ in range(NEWTON_STEPS):
        likely = _likely(features, weights)
        gradient = np.einsum("nk,n->k", features, successes - likely) - precision * (weights - mean)
        scaled = features * (likely * (1.0 - likely))[:, None]
        curvature = np.einsum("nk,nl->kl", scaled, features) + np.diag(precision)
        weights = weights + np.linalg.solve(curvature, gradient)
    return weights


def _variances(features: Floats) -> Floats:
    """Those of features (n, k): (k,); 1 for constants."""
    variances = features.var(axis=0)
    return np.where(variances > STEADY, variances, 1.0)


def _in_grains(weights: Floats) -> Floats:
    grains: Floats = np.rint(weights * GRAIN) / GRAIN
    return grains


def _likely(features: Floats, weights: Floats) -> Floats:
    likely: Floats = 1.0 / (1.0 + np.exp(-np.einsum("nk,k->n", features, weights)))
    return likely


def _is_telling(successes: NDArray[np.bool_]) -> bool:
    found = int(np.count_nonzero(successes))
    return min(found, len(successes) - found) >= FEW
