"""The protocol robust: trial 0 is the paper's evaluation, each trial a function of its own."""

import numpy as np
import pytest
from tests.worker.genomes import draw, evaluated, results

from qdgrasp_protocol.rows import TRIALS, Outcome


@pytest.fixture(scope="module")
def scene(make_scene):
    return make_scene("panda", "tennis_ball", "robust")


@pytest.fixture(scope="module")
def nominal(scene):
    return evaluated(scene, "approach", draw(900, seed=7))


@pytest.fixture(scope="module")
def mixed(nominal):
    """Successes in a few of their trials each, trial 0 among them, genomes mixed."""
    some = nominal[nominal["outcome"] >= Outcome.DROPPED]["genome"][:20]
    trials = np.tile([0, 1, 2, 50, TRIALS], len(some))
    return np.repeat(some, 5, axis=0), trials


@pytest.fixture(scope="module")
def rows(scene, mixed):
    return evaluated(scene, "approach", *mixed)


def test_trial_zero_is_the_evaluation_of_paper_to_the_byte(make_scene, nominal):
    some = nominal[::6]
    paper = make_scene("panda", "tennis_ball", "paper")
    assert results(evaluated(paper, "approach", some["genome"])) == results(some)


@pytest.mark.parametrize(
    ("places", "batch"),
    [
        (np.random.default_rng(1).permutation(100), 1000),
        (np.arange(0, 100, 5), 1000),  # the nominal rows alone, no trial before them
        (np.arange(30), 1),
    ],
    ids=["permuted", "nominal", "one by one"],
)
def test_the_other_rows_of_a_batch_and_their_order_change_no_byte(scene, mixed, rows, places, batch):
    genomes, trials = (column[places] for column in mixed)
    assert results(evaluated(scene, "approach", genomes, trials, batch=batch)) == results(rows[places])


def test_a_stored_pose_that_is_scored_as_given_meets_the_same_trials(scene, mixed, rows):
    again = evaluated(scene, "given", rows["base_to_object"], mixed[1])
    assert results(again, "surface_point", "nu") == results(rows, "surface_point", "nu")
