"""The ranker: learns from the features of simulated poses what candidates are to be ranked by."""

import numpy as np

from qdgrasp_assets.genes import FEATURES, STEEPEST
from qdgrasp_assets.rotation import Floats
from qdgrasp_coordinator.searches.logistic import Logistic
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows


class Ranker:
    """A logistic regression of success on the features that the prior `aimed` tells of the pose it took.

    It begins from nothing: what ranks poses on one object misleads on another.
    """

    def __init__(self) -> None:
        self._model = Logistic(np.zeros(len(FEATURES)))

    @property
    def weights(self) -> Floats:
        """One for each feature, as their genes can carry them; zeros before the first fit."""
        return bearable(self._model.weights)

    def learn(self, simulated: Rows) -> None:
        """Hear of rows that were simulated."""
        features = simulated["descriptor"][:, 3:].astype(np.float64)
        self._model.learn(features, simulated["outcome"] >= Outcome.DROPPED)


def bearable(weights: Floats) -> Floats:
    """The weights (6,) scaled down where one is too steep for its gene, and none for the constant.

    Neither changes the order of candidates.
    """
    ranking = np.concatenate([weights[:-1], [0.0]])
    scaled: Floats = ranking * min(1.0, STEEPEST / max(float(np.abs(ranking).max()), STEEPEST))
    return scaled
