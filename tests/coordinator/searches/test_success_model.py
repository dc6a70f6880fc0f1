"""The model that ranks candidates."""

import numpy as np
import pytest

from qdgrasp_coordinator.searches.success_model import FEW, GRAIN, PATIENCE, SuccessModel, fit, rounded
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows, Shape

TRUE = np.array([3.0, -1.0, 0.5, 0.0, -2.0, 0.7])


def poses(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Features (n, 6), the last constant, and successes that follow `TRUE`."""
    random = np.random.default_rng(seed)
    features = np.concatenate([random.uniform(-1, 1, (n, 5)), np.ones((n, 1))], axis=1)
    return features, random.random(n) < 1 / (1 + np.exp(-features @ TRUE))


def rows(features: np.ndarray, successes: np.ndarray) -> Rows:
    told = Shape(genes=15, joints=1, descriptors=9).empty(len(features))
    told["descriptor"][:, 3:] = features
    told["outcome"] = np.where(successes, Outcome.HELD, Outcome.MISSED)
    return told


def test_a_fit_finds_the_weights_that_made_the_successes() -> None:
    assert fit(*poses(20_000)) == pytest.approx(TRUE, abs=0.15)


def test_features_that_tell_everything_leave_it_finite() -> None:
    features, _ = poses(500)
    weights = fit(features, features[:, 0] > 0)
    assert np.isfinite(weights).all()
    assert weights[0] > 3 * np.abs(weights[1:]).max()


def test_nothing_is_learned_of_one_kind_of_outcome() -> None:
    model = SuccessModel()
    features, _ = poses(PATIENCE * 2)
    model.learn(rows(features, np.ones(len(features), bool)))
    assert not model.weights.any()
    model.learn(rows(features[:FEW], np.zeros(FEW, bool)))
    assert model.weights.any()


def test_poses_that_were_not_simulated_say_nothing() -> None:
    one, other = SuccessModel(), SuccessModel()
    told = rows(*poses(PATIENCE))
    screened = rows(*poses(PATIENCE, 1))
    screened["outcome"] = Outcome.OVERLAP
    one.learn(told)
    other.learn(np.concatenate([screened, told]))
    assert one.weights.tolist() == other.weights.tolist()


def test_it_forgets_what_is_long_ago() -> None:
    model = SuccessModel()
    features, successes = poses(3000)
    model.learn(rows(features, ~successes))
    assert model.weights[0] < 0
    for block in range(10):
        model.learn(rows(features[block * 250 :][:250], successes[block * 250 :][:250]))
    assert model.weights[0] > 0


def test_weights_fit_into_their_genes_in_whole_grains() -> None:
    weights = rounded(np.array([30.0, -3.0, 0.0101, 1.0, 0.0, 5.0]))
    assert weights[0] == 8
    assert weights[1] == pytest.approx(-0.8, abs=1 / GRAIN)
    assert weights[-1] == 0
    assert (weights * GRAIN == np.rint(weights * GRAIN)).all()
