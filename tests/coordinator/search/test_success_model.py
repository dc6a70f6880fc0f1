"""Logistic regression of the latest examples."""

import numpy as np
import pytest

from qdgrasp_coordinator.search.success_model import (
    FIT_INTERVAL,
    LogisticRegression,
    ValueThreshold,
    fit,
)

TRUE = np.array([3.0, -1.0, 0.5, 0.0, -2.0, 0.7])
UNKNOWN, PLAIN = np.zeros(6), np.ones(6)


def poses(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Features (n, 6), the last constant, and successes that follow `TRUE`."""
    random = np.random.default_rng(seed)
    features = np.concatenate([random.uniform(-1, 1, (n, 5)), np.ones((n, 1))], axis=1)
    return features, random.random(n) < 1 / (1 + np.exp(-features @ TRUE))


def test_a_fit_finds_the_weights_that_made_the_successes() -> None:
    assert fit(*poses(20_000), UNKNOWN, PLAIN) == pytest.approx(TRUE, abs=0.15)


def test_what_it_is_taught_holds_until_examples_say_otherwise() -> None:
    taught, untaught = LogisticRegression(TRUE), LogisticRegression(UNKNOWN)
    features, successes = poses(FIT_INTERVAL)
    assert taught.likely(features) == pytest.approx(1 / (1 + np.exp(-features @ TRUE)), abs=0.02)
    taught.learn(features, successes)
    untaught.learn(features, successes)
    assert np.abs(taught.weights - TRUE).max() < np.abs(untaught.weights - TRUE).max()
    for _ in range(8):
        taught.learn(features, ~successes)
    assert taught.weights[0] < 0


NONE, ALL = np.zeros(50, bool), np.ones(50, bool)
WANTED, LEAST_SHARE = 0.8, 0.1


def wanted(threshold: ValueThreshold, dead_ends: int = 0) -> float:
    return float(threshold.wanted(np.array([dead_ends], np.int32))[0])


def test_less_is_wanted_of_a_cell_after_each_dead_end() -> None:
    each = [wanted(ValueThreshold(WANTED, LEAST_SHARE), dead_ends) for dead_ends in range(5)]
    assert each[0] == WANTED
    assert (np.diff(each) < 0).all()


def test_less_is_wanted_while_hardly_anything_is_simulated() -> None:
    threshold = ValueThreshold(WANTED, LEAST_SHARE)
    for _ in range(19):  # a run ends after 20 generations without an evaluation
        threshold.update(NONE)
    assert wanted(threshold) < 0.15
    threshold.update(ALL)
    assert wanted(threshold) < 0.15
    for _ in range(20):
        threshold.update(ALL)
    assert wanted(threshold) == pytest.approx(WANTED)
