"""What candidates are ranked by."""

import numpy as np
import pytest

from qdgrasp_coordinator.searches.ranker import Ranker, bearable
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Shape


def test_what_makes_success_has_weight() -> None:
    random = np.random.default_rng(0)
    rows = Shape(genes=15, joints=1, descriptors=9).empty(1000)
    features = np.concatenate([random.random((1000, 5)), np.ones((1000, 1))], axis=1)
    rows["descriptor"][:, 3:] = features
    rows["outcome"] = np.where(features[:, 1] - features[:, 4] > 0, Outcome.SHAKEN, Outcome.BRUSHED)
    ranker = Ranker()
    assert not ranker.weights.any()
    ranker.learn(rows)
    order = np.argsort(ranker.weights)
    assert (order[0], order[-1]) == (4, 1)


def test_weights_fit_into_their_genes_in_the_same_proportions() -> None:
    weights = bearable(np.array([30.0, -3.0, 0.0, 15.0, 0.0, 5.0]))
    assert weights == pytest.approx([8, -0.8, 0, 4, 0, 0])


def test_weights_that_fit_stay() -> None:
    assert bearable(np.array([7.0, -3.0, 0.0, 1.0, 0.0, 5.0])).tolist() == [7, -3, 0, 1, 0, 0]
