"""What candidates are ranked by."""

import numpy as np
import pytest

from qdgrasp_assets.genes import FEATURES
from qdgrasp_coordinator.searches.ranker import Ranker, bearable
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Shape

N = len(FEATURES)
SHAPE = Shape(genes=9 + N, joints=1, descriptors=3 + N)


def test_what_makes_success_has_weight() -> None:
    random = np.random.default_rng(0)
    rows = SHAPE.empty(1000)
    features = np.concatenate([random.random((1000, N - 1)), np.ones((1000, 1))], axis=1)
    rows["descriptor"][:, 3:] = features
    rows["outcome"] = np.where(features[:, 1] - features[:, 4] > 0, Outcome.SHAKEN, Outcome.BRUSHED)
    ranker = Ranker()
    assert not ranker.wanting(np.array([0.9])).any()
    ranker.learn(rows)
    order = np.argsort(ranker.wanting(np.array([0.5]))[0, :-1])
    assert (order[0], order[-1]) == (4, 1)


def test_what_is_likelier_than_wanted_scores_above_zero() -> None:
    random = np.random.default_rng(0)
    rows = SHAPE.empty(1000)
    rows["descriptor"][:, 3] = random.random(1000)
    rows["descriptor"][:, -1] = 1.0
    rows["outcome"] = np.where(random.random(1000) < rows["descriptor"][:, 3], Outcome.HELD, Outcome.BRUSHED)
    ranker = Ranker()
    ranker.learn(rows)
    for wanted in (0.3, 0.5, 0.8):
        weights = ranker.wanting(np.array([wanted]))[0]
        is_enough = rows["descriptor"][:, 3:] @ weights >= 0
        least = rows["descriptor"][is_enough, 3].min()
        assert least == pytest.approx(wanted, abs=0.12)


def test_a_weight_for_the_constant_is_never_zero() -> None:
    """It would ask for nothing."""
    ranker = Ranker()
    ranker._model.weights = np.eye(N)[0]
    assert ranker.wanting(np.array([0.5]))[0, -1] > 0


def test_who_wants_nothing_is_not_choosy_and_ranks_alike() -> None:
    ranker = Ranker()
    ranker._model.weights = np.arange(N, dtype=np.float64)
    anything, choosy = ranker.wanting(np.array([0.0, 0.3]))
    assert anything[-1] == 0 != choosy[-1]
    assert anything[:-1].tolist() == choosy[:-1].tolist()


def test_weights_fit_into_their_genes_in_the_same_proportions() -> None:
    weights = bearable(np.array([[30.0, -3.0, 0.0, 15.0, 0.0, 7.5], [7.0, -3.0, 0.0, 1.0, 0.0, 5.0]]))
    assert weights[0] == pytest.approx([8, -0.8, 0, 4, 0, 2])
    assert weights[1].tolist() == [7, -3, 0, 1, 0, 5]
