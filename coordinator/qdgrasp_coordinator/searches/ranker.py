"""The ranker: learns from the features of simulated poses what candidates are to be ranked by."""

import numpy as np

from qdgrasp_assets.genes import FEATURES, STEEPEST
from qdgrasp_assets.rotation import Floats
from qdgrasp_coordinator.searches.logistic import GRAIN, Logistic
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows


class Ranker:
    """A logistic regression of success on the features that the prior `aimed` tells of the pose it took.

    It begins from nothing: what ranks poses on one object misleads on another.
    """

    def __init__(self) -> None:
        self._model = Logistic(np.zeros(len(FEATURES)), own_units=True)

    def wanting(self, likely: Floats) -> Floats:
        """Weights (n, features) for genomes of which no candidate less `likely` (n,) to succeed is simulated.

        Then the score is negative. Where `likely` is 0, and before the first fit, they want nothing.
        """
        weights = np.tile(self._model.weights, (len(likely), 1))
        if weights.any():
            is_choosy = likely > 0.0
            weights[~is_choosy, -1] = 0.0
            weights[is_choosy, -1] -= _odds(likely[is_choosy])
            weights[is_choosy & (weights[:, -1] == 0.0), -1] = 1.0 / GRAIN
        return bearable(weights)

    def learn(self, simulated: Rows) -> None:
        """Hear of rows that were simulated."""
        features = simulated["descriptor"][:, 3:].astype(np.float64)
        self._model.learn(features, simulated["outcome"] >= Outcome.DROPPED)


def _odds(likely: Floats) -> Floats:
    """The score (n,) at which a success is as `likely` (n,), in whole grains."""
    odds: Floats = np.rint(np.log(likely / (1.0 - likely)) * GRAIN) / GRAIN
    return odds


def bearable(weights: Floats) -> Floats:
    """The weights (n, features), less where one is too steep for its gene: no order and no sign changes."""
    steepest = np.maximum(np.abs(weights).max(axis=1, keepdims=True), STEEPEST)
    scaled: Floats = weights * (STEEPEST / steepest)
    return scaled
