"""The screen and its features, and the simulated candidate of a genome with several."""

import numpy as np
import pytest
from tests.worker.genomes import RANKED_BY, decoded, encoded, facing

from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.candidate_ranking import scores, thresholds
from qdgrasp_worker.evaluator import Evaluator

N = 40
POSE = ("outcome", "fitness", "base_to_object", "joints", "contacts", "penetration")
"""Columns of a row that describe a pose, with any prior."""


@pytest.fixture(scope="module")
def scene(make_scene):
    return make_scene("panda", "rubiks_cube", "robust")


@pytest.fixture(scope="module")
def evaluator(scene):
    with Evaluator(scene) as evaluator:
        yield evaluator


@pytest.fixture(scope="module")
def genomes(scene):
    values = facing(scene, N, candidates=12, seed=1)
    ranked_by = values[:, RANKED_BY]
    ranked_by[N // 2 :] = np.random.default_rng(2).uniform(-4.0, 4.0, ranked_by[N // 2 :].shape)
    ranked_by[::2, -1] = 0.0
    ranked_by[:, -1] = np.abs(ranked_by[:, -1] / 8)
    values[::9, :3] *= 0.6  # inside the object, some
    return encoded(scene, values)


def rows_of(evaluator, prior, genomes, trial=0):
    evaluation = evaluator.evaluate(prior, genomes, np.full(len(genomes), trial, dtype=np.uint16))
    assert not evaluation.failures
    return evaluation.rows


@pytest.fixture(scope="module")
def rows(evaluator, genomes):
    return rows_of(evaluator, "valued", genomes)


@pytest.fixture(scope="module")
def candidates(scene, evaluator, genomes):
    """The poses (m, 7) of all candidates, the genome of each, and their features."""
    grasps = decoded(scene, "valued", genomes)
    (places,) = np.nonzero(~grasps.dead_ends)
    features = evaluator._candidate_screen._features.features(grasps, places)
    poses = np.concatenate([grasps.positions[places], grasps.quaternions[places]], axis=1)
    return poses, grasps.genome_of[places], features, grasps.weights


def test_the_best_candidate_that_promises_enough_and_does_not_overlap_is_simulated(
    evaluator, rows, candidates
):
    poses, of, features, weights = candidates
    least = thresholds(weights)
    overlaps = rows_of(evaluator, "given", poses)["outcome"] == Outcome.OVERLAP
    chosen = refused = 0
    for i, row in enumerate(rows):
        mine = np.flatnonzero((of == i) & ~overlaps)
        value = scores(features[mine], np.tile(weights[i], (len(mine), 1)))
        is_choosy = weights[i, -1] != 0
        if not len(mine) or value.max() < least[i]:
            refused += len(mine) > 0
            assert row["outcome"] in (
                (Outcome.DEAD_END,) if is_choosy else (Outcome.OVERLAP, Outcome.DEAD_END)
            )
            continue
        best = mine[value.argmax()]
        np.testing.assert_array_equal(row["base_to_object"], poses[best])
        np.testing.assert_array_equal(row["descriptor"], [*poses[best, :3], *features[best]])
        chosen += 1
    assert chosen > N / 2
    assert refused


def test_a_trial_disturbs_the_pose_that_was_taken_at_first(evaluator, rows, genomes):
    found = np.flatnonzero(rows["outcome"] >= Outcome.DROPPED)[:6]
    assert len(found) == 6
    for trial in (1, 2):
        again = rows_of(evaluator, "valued", genomes[found], trial)
        np.testing.assert_array_equal(again["base_to_object"], rows["base_to_object"][found])
        alone = rows_of(evaluator, "given", rows["base_to_object"][found], trial)
        for name in POSE:
            assert alone[name].tobytes() == again[name].tobytes(), name
