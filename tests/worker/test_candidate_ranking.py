"""The screen, and what is simulated of a genome with several candidates."""

from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.worker.genomes import CANDIDATES, CONSTANT, WEIGHTS, decoded, draw, encoded, facing, outcomes

from qdgrasp_assets.genes import layout
from qdgrasp_protocol.rows import NO_SYNERGY, RESULT, Outcome
from qdgrasp_worker.candidate_ranking import SweptVolumes, candidate_scores
from qdgrasp_worker.evaluator import Evaluator
from qdgrasp_worker.world import World

N = 40
POSE = ("outcome", "fitness", "base_to_object", "joints", "contacts", "penetration")
"""Columns of a row that describe a pose, whatever the prior."""


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
    values[N // 2 :, WEIGHTS] = np.random.default_rng(2).uniform(-8.0, 8.0, (N - N // 2, 6))
    values[::2, CONSTANT] = 0.0
    values[::9, :3] *= 0.6  # inside the object, some
    return encoded(scene, values)


def rows_of(evaluator, prior, genomes, trial=0):
    evaluation = evaluator.evaluate(prior, genomes, np.full(len(genomes), trial, dtype=np.uint16))
    assert not evaluation.failures
    return evaluation.rows


@pytest.fixture(scope="module")
def rows(evaluator, genomes):
    return rows_of(evaluator, "aimed", genomes)


@pytest.fixture(scope="module")
def candidates(scene, evaluator, genomes):
    """The poses (m, 7) of all candidates, the genome of each, and their features."""
    grasps = decoded(scene, "aimed", genomes)
    (places,) = np.nonzero(~grasps.dead_ends)
    features = evaluator._candidate_screen._ranking.features(grasps, places)
    poses = np.concatenate([grasps.positions[places], grasps.quaternions[places]], axis=1)
    return poses, grasps.genome_of[places], features, grasps.weights


def test_the_best_candidate_that_promises_enough_and_does_not_overlap_is_simulated(
    evaluator, rows, candidates
):
    poses, of, features, weights = candidates
    overlaps = rows_of(evaluator, "given", poses)["outcome"] == Outcome.OVERLAP
    chosen = refused = 0
    for i, row in enumerate(rows):
        mine = np.flatnonzero((of == i) & ~overlaps)
        value = candidate_scores(features[mine], np.tile(weights[i], (len(mine), 1)))
        is_choosy = weights[i, -1] != 0
        if not len(mine) or (is_choosy and value.max() < 0):
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


def test_a_row_says_of_its_pose_what_the_pose_alone_does(evaluator, rows):
    is_pose = rows["outcome"] != Outcome.DEAD_END
    alone = rows_of(evaluator, "given", rows["base_to_object"][is_pose])
    for name in POSE:
        assert alone[name].tobytes() == rows[name][is_pose].tobytes(), name


def test_proposals_are_the_candidates_within_the_stand_off_and_one_at_least(rows, candidates):
    counts = np.bincount(candidates[1], minlength=N)
    np.testing.assert_array_equal(rows["proposals"], np.maximum(counts, 1))
    assert 1 < counts.mean() < 12


def test_features_are_those_of_simulated_poses_and_end_with_the_constant(rows):
    simulated = np.array([outcome.is_simulated for outcome in outcomes(rows)])
    features = rows["descriptor"][:, 3:]
    assert not features[~simulated].any()
    assert (features[simulated, 5] == 1.0).all()
    assert np.abs(features).max() <= 1.0 + 1e-6
    assert (~simulated).any()
    assert simulated.sum() > N / 2


def test_a_genome_without_weights_is_ranked_by_what_is_swept_from_opposite_sides():
    features = np.array([[0.9, 0.2, 1, 1, 1, 1], [0.5, 0.4, 0, 0, 0, 1], [0.5, 0.5, -1, 0, -1, 1]])
    assert candidate_scores(features.astype(np.float32), np.zeros((3, 6))).argsort().tolist() == [0, 1, 2]


def test_weights_decide_and_the_constant_changes_nothing():
    features = np.random.default_rng(0).uniform(-1, 1, (20, 6)).astype(np.float32)
    features[:, 5] = 1.0
    weights = np.tile([0.0, 0.0, -2.0, 0.0, 1.0, 0.0], (20, 1))
    order = candidate_scores(features, weights).argsort()
    np.testing.assert_array_equal(order, (features[:, 4] - 2.0 * features[:, 2]).argsort())
    weights[:, 5] = 3.0
    np.testing.assert_array_equal(candidate_scores(features, weights).argsort(), order)


def test_one_candidate_is_simulated_as_it_is_drawn(scene, evaluator):
    genomes = encoded(scene, facing(scene, N, candidates=1, seed=5))
    rows = rows_of(evaluator, "aimed", genomes)
    grasps = decoded(scene, "aimed", genomes)
    np.testing.assert_array_equal(rows["descriptor"][:, :3], grasps.positions)
    np.testing.assert_array_equal(rows["outcome"] == Outcome.DEAD_END, grasps.dead_ends)
    assert (rows["proposals"] == 1).all()
    assert (rows["outcome"] == Outcome.OVERLAP).any()


def test_a_trial_disturbs_the_pose_that_was_taken_at_first(evaluator, rows, genomes):
    found = np.flatnonzero(rows["outcome"] >= Outcome.DROPPED)[:6]
    assert len(found) == 6
    for trial in (1, 2):
        again = rows_of(evaluator, "aimed", genomes[found], trial)
        np.testing.assert_array_equal(again["base_to_object"], rows["base_to_object"][found])
        alone = rows_of(evaluator, "given", rows["base_to_object"][found], trial)
        for name in POSE:
            assert alone[name].tobytes() == again[name].tobytes(), name


def test_a_genome_that_is_not_finite_fails_alone(evaluator, genomes, rows):
    broken = genomes[:4].copy()
    broken[1, 0], broken[2, CANDIDATES] = np.nan, np.inf
    evaluation = evaluator.evaluate("aimed", broken, np.zeros(4, dtype=np.uint16))
    assert [place for place, _ in evaluation.failures] == [1, 2]
    for column in RESULT:
        np.testing.assert_array_equal(evaluation.rows[column.name][[0, 3]], rows[column.name][[0, 3]])


def test_genes_far_beyond_their_intervals_are_dead_ends(evaluator, scene):
    genomes = np.full((2, len(layout(scene, "aimed"))), 1e30, dtype=np.float32)
    genomes[1] *= -1
    assert (rows_of(evaluator, "aimed", genomes)["outcome"] == Outcome.DEAD_END).all()


TIP = np.array([0.0, 0.0, 0.1])
"""Between the tips of the Panda's fingers, hand frame [m]."""


@pytest.fixture(scope="module", params=["panda", "barrett", "allegro"])
def hand_scene(request, make_scene):
    return make_scene(request.param, "tennis_ball", "paper")


@pytest.fixture(scope="module")
def volumes(hand_scene):
    world = World(hand_scene)
    yield SweptVolumes(hand_scene.gripper, world.closing)
    world.close()


@pytest.fixture(scope="module")
def grasps(hand_scene):
    return decoded(hand_scene, "approach", draw(60, len(layout(hand_scene, "approach"))))


@pytest.fixture(scope="module")
def around(hand_scene):
    """Points (4000, 3) about where the hand grasps, hand frame [m]."""
    grasp = np.array(hand_scene.gripper.approach_axis) * hand_scene.gripper.reach
    return grasp + np.random.default_rng(0).uniform(-0.05, 0.05, (4000, 3))


def shares(volumes, grasps, points):
    """The shares (n, 2) of each of the grasps."""
    return volumes.shares(points.astype(np.float32), grasps, np.arange(len(grasps)))


def seen(grasps, i, points):
    """Points of the hand's frame in the object's."""
    turn = Rotation.from_quat(grasps.quaternions[i].astype(float))
    return turn.apply(points) + grasps.positions[i]


def test_what_is_in_it_is_more_than_what_is_so_from_opposite_sides_and_nothing_is_far_away(
    volumes, grasps, hand_scene
):
    found = shares(volumes, grasps, hand_scene.surface_points)
    assert (found[:, 1] <= found[:, 0]).all()
    assert (found[:, 1] > 0).any()
    assert (found[:, 0] > 0).mean() > 0.3
    assert found.max() <= 1.0
    assert not shares(volumes, grasps, hand_scene.surface_points + 3.0).any()


def test_what_is_in_it_moves_with_the_hand(volumes, grasps, around):
    """Points that stand alike before every hand are alike in its volume, if hands close alike."""
    alike = np.flatnonzero(grasps.synergies == grasps.synergies[0])
    alike = alike[(np.abs(grasps.joints[alike] - grasps.joints[0]) < 1e-6).all(axis=1)][:8]
    found = [
        volumes.shares(seen(grasps, i, around).astype(np.float32), grasps, np.array([i]))[0] for i in alike
    ]
    assert found[0][0] > 5 / len(around)
    np.testing.assert_allclose(found, np.tile(found[0], (len(found), 1)), atol=2 / len(around))


def test_a_share_does_not_depend_on_the_batch(volumes, grasps, hand_scene):
    together = shares(volumes, grasps, hand_scene.surface_points)
    points = hand_scene.surface_points.astype(np.float32)
    for i in range(0, len(grasps), 7):
        np.testing.assert_array_equal(volumes.shares(points, grasps, np.array([i]))[0], together[i])


def test_it_is_measured_once_for_each_way_of_closing(volumes, grasps, hand_scene, monkeypatch):
    shares(volumes, grasps, hand_scene.surface_points)
    monkeypatch.setattr(volumes, "_closing", None)  # to call it would fail
    shares(volumes, grasps, hand_scene.surface_points)
    synergies, places = len(hand_scene.gripper.synergies) or 1, 5 ** len(hand_scene.gripper.free_joints)
    assert 1 <= len(volumes._found) <= synergies * places
    assert sum(volume.voxels.levels.nbytes for volume in volumes._found.values()) < 50e6


def test_the_pandas_fingers_pass_between_their_open_places_and_not_behind_the_palm(make_scene):
    hand_scene = make_scene("panda", "rubiks_cube", "paper")
    grasps = decoded(hand_scene, "given", np.array([[0, 0, 0, 0, 0, 0, 1]], dtype=np.float32))
    assert grasps.synergies.tolist() == [NO_SYNERGY]
    world = World(hand_scene)
    share = partial(shares, SweptVolumes(hand_scene.gripper, world.closing), grasps)
    line = TIP + np.linspace(-0.035, 0.035, 50)[:, None] * (0.0, 1.0, 0.0)
    [(within, opposed)] = share(line)
    assert within == 1.0
    assert opposed > 0.9
    for side in (line[:20], line[-20:]):  # one finger comes first, and pushes
        [(within, opposed)] = share(side)
        assert within == 1.0
        assert opposed < 0.1
    assert share(line - TIP * 1.5).tolist() == [[0.0, 0.0]]
    world.close()
