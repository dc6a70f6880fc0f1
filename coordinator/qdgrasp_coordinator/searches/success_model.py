"""The model that ranks candidates: a logistic regression of success on the features of a pose."""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.genes import FEATURES, STEEPEST
from qdgrasp_assets.rotation import Floats
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows

MEMORY = 2048
"""The last poses that a fit looks at."""
PATIENCE = 256
"""Poses between two fits."""
FEW = 10
"""So many successes and so many failures must be there before the first fit."""
NEWTON_STEPS = 5
RIDGE = 1.0
"""Precision of the weights' prior, N(0, 1 / RIDGE); it keeps a fit finite when features tell all."""
GRAIN = 64
"""Weights are whole multiples of 1 / GRAIN: the last bits of a fit, which differ between processors, do not
reach the genomes."""


class SuccessModel:
    """A logistic regression of success on features, fitted now and then to the latest poses."""

    def __init__(self) -> None:
        self.weights: Floats = np.zeros(len(FEATURES))
        """One for each feature, in the interval of their genes; zeros before the first fit."""
        self._features = np.zeros((MEMORY, len(FEATURES)))
        self._successes = np.zeros(MEMORY, np.bool_)
        self._heard = 0
        self._fitted = 0

    def learn(self, rows: Rows) -> None:
        """Hear of rows; those that were simulated say something."""
        simulated = rows[rows["outcome"] >= Outcome.MISSED][-MEMORY:]
        places = (self._heard + np.arange(len(simulated))) % MEMORY
        self._features[places] = simulated["descriptor"][:, 3:]
        self._successes[places] = simulated["outcome"] >= Outcome.DROPPED
        self._heard += len(simulated)
        if self._heard - self._fitted >= PATIENCE and self._is_telling:
            self._fitted = self._heard
            known = min(self._heard, MEMORY)
            self.weights = rounded(fit(self._features[:known], self._successes[:known]))

    @property
    def _is_telling(self) -> bool:
        known = min(self._heard, MEMORY)
        successes = int(np.count_nonzero(self._successes[:known]))
        return min(successes, known - successes) >= FEW


def fit(features: Floats, successes: NDArray[np.bool_]) -> Floats:
    """The weights (k,) of features (n, k), the last of which is constant, by Newton's method from zero.

    Sums are einsum's own loops: no matrix library with threads, for so little.
    """
    weights = np.zeros(features.shape[1])
    for _ in range(NEWTON_STEPS):
        likely = 1.0 / (1.0 + np.exp(-np.einsum("nk,k->n", features, weights)))
        gradient = np.einsum("nk,n->k", features, successes - likely) - RIDGE * weights
        scaled = features * (likely * (1.0 - likely))[:, None]
        curvature = np.einsum("nk,nl->kl", scaled, features) + RIDGE * np.eye(len(weights))
        weights = weights + np.linalg.solve(curvature, gradient)
    return weights


def rounded(weights: Floats) -> Floats:
    """Weights as genes can carry them: whole 1 / GRAIN, scaled down where one is too steep.

    A scale changes no order, and neither does the weight of the constant, which becomes 0.
    """
    ranking = np.concatenate([weights[:-1], [0.0]])
    steepest = float(np.abs(ranking).max())
    scaled: Floats = ranking * min(1.0, STEEPEST / max(steepest, STEEPEST))
    grains: Floats = np.rint(scaled * GRAIN) / GRAIN
    return grains
