"""Evaluations: the content of a row, and that a row that fails disturbs no other."""

import weakref
from collections import defaultdict
from math import dist
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.worker.genomes import draw, evaluated, outcomes, results

from qdgrasp_assets.geometry.rotation import rotate
from qdgrasp_assets.geometry.voxels import Hull
from qdgrasp_assets.grippers.hand_geometry import hand_geometry
from qdgrasp_protocol.messages import deflated
from qdgrasp_protocol.rows import CONTACT_VALUES, RESULT, Outcome, RowShape, unpack
from qdgrasp_worker.episode import Episode
from qdgrasp_worker.evaluation_protocols import CLOSING_STEPS, PAPER, TARGET_STEPS
from qdgrasp_worker.evaluator import MAX_EVALUATORS, Evaluator, EvaluatorCache, spread_contacts
from qdgrasp_worker.pose_filters import ObjectSolid
from qdgrasp_worker.world import GraspContact

N = 150


@pytest.fixture(scope="module")
def genomes():
    return draw(N, near=12)


@pytest.fixture(scope="module")
def rows(cube, genomes):
    return evaluated(cube, "approach", genomes)


def nominal(genomes):
    return np.zeros(len(genomes), dtype=np.uint16)


def test_the_rows_have_the_scenes_shape_and_pass_the_checks_of_the_bus(evaluator, rows, genomes):
    shape = evaluator.shape("approach")
    assert shape == RowShape(genes=7, joints=2, contact_slots=8)
    assert rows.dtype == shape.dtype
    copy = unpack(shape.empty(len(rows)), RESULT, deflated(results(rows)))
    assert results(copy) == results(rows)
    np.testing.assert_array_equal(rows["genome"], genomes)


def test_fitness_counts_the_shakes_that_the_outcome_says(rows):
    ladder = {Outcome.SHAKEN: 1.0, Outcome.HELD: 2.0}
    expected = [ladder.get(outcome, 0.0) for outcome in outcomes(rows)]
    np.testing.assert_array_equal(rows["fitness"], expected)


def test_steps_are_those_of_closing_and_of_the_shakes_until_the_object_is_lost(rows):
    steps = {outcome: set(rows["steps"][rows["outcome"] == outcome].tolist()) for outcome in Outcome}
    assert steps[Outcome.OVERLAP] == {0}
    assert steps[Outcome.MISSED] <= {0, CLOSING_STEPS}
    assert steps[Outcome.BRUSHED] == {CLOSING_STEPS}
    shakes = sum(len(shake.targets) for shake in PAPER.shakes) * TARGET_STEPS
    assert steps[Outcome.HELD] == {CLOSING_STEPS + shakes}
    assert all(CLOSING_STEPS < n < CLOSING_STEPS + shakes for n in steps[Outcome.DROPPED])


@pytest.mark.parametrize("poison", [0, 5, N - 1])
def test_a_row_that_fails_in_the_simulator_is_named_and_the_others_do_not_notice(
    cube, genomes, rows, poison, monkeypatch
):
    place, poisoned = Episode.place, rows["descriptor"][poison].tolist()

    def place_or_fail(episode, trial):
        if trial.pose.position == poisoned:
            episode.world.close()  # Bullet refuses every call from here on
        return place(episode, trial)

    monkeypatch.setattr(Episode, "place", place_or_fail)
    with Evaluator(cube, shortcuts=False) as evaluator:
        evaluation = evaluator.evaluate("approach", genomes, nominal(genomes))
    assert evaluation.failures == [(poison, "error: Not connected to physics server.")]
    assert not any(evaluation.rows[poison][column.name].any() for column in RESULT)
    others = np.arange(N) != poison
    assert results(evaluation.rows[others], "steps") == results(rows[others], "steps")
    others &= rows["steps"] > 0  # without shortcuts, hands that miss close as well
    assert results(evaluation.rows[others]) == results(rows[others])


def test_a_genome_that_is_not_finite_fails_alone(evaluator, genomes, rows):
    broken = genomes[:20].copy()
    broken[3, 2], broken[7, 6] = np.nan, np.inf
    evaluation = evaluator.evaluate("approach", broken, nominal(broken))
    assert [position for position, _ in evaluation.failures] == [3, 7]
    assert "not finite" in evaluation.failures[0][1]
    others = [i for i in range(20) if i not in (3, 7)]
    assert results(evaluation.rows[others]) == results(rows[others])


@pytest.mark.parametrize(
    ("protocol", "last", "reason"),
    [
        ("paper", 0, "no trial but 0"),
        ("released", 0, "no trial but 0"),
        ("robust", 100, "no trial above 100"),
    ],
)
def test_a_trial_that_the_protocol_does_not_have_fails(make_scene, genomes, protocol, last, reason):
    trials = np.array([0, last, last + 1, 65535], dtype=np.uint16)
    with Evaluator(make_scene("panda", "rubiks_cube", protocol)) as evaluator:
        failures = dict(evaluator.evaluate("approach", genomes[:4], trials).failures)
    assert list(failures) == [2, 3]
    assert all(reason in failure for failure in failures.values())


@pytest.fixture
def loaded():
    """Evaluators that only know whether they were closed, by their scene."""
    return defaultdict(lambda: Mock(weight=1))


@pytest.fixture
def get(loaded):
    return lambda worlds, digest: worlds.get(digest, lambda: loaded[digest])


def test_at_most_eight_are_kept_and_the_one_longest_unused_is_closed_before_the_next_is_loaded(get, loaded):
    worlds = EvaluatorCache()
    names = [str(i) for i in range(MAX_EVALUATORS)]
    for name in names:
        get(worlds, name)
    get(worlds, "0")
    worlds.get(
        "new", lambda: Mock(weight=1) if loaded["1"].close.called else pytest.fail("two worlds too many")
    )
    assert MAX_EVALUATORS == 8
    assert len(worlds) == 8
    assert "1" not in worlds
    assert "0" in worlds
    assert [name for name, stub in loaded.items() if stub.close.called] == ["1"]


def test_what_is_closed_is_freed_before_the_next_is_loaded_also_if_it_refers_to_itself():
    class Cyclic(SimpleNamespace):
        """An evaluator that only a search for cycles frees."""

    def load(number):
        if number >= MAX_EVALUATORS:
            assert made[number - MAX_EVALUATORS]() is None
        one = Cyclic(weight=1, close=lambda: None)
        one.itself = one
        made.append(weakref.ref(one))
        return one

    worlds, made = EvaluatorCache(), []
    for number in range(2 * MAX_EVALUATORS):
        worlds.get(str(number), lambda number=number: load(number))
    assert len(made) == 2 * MAX_EVALUATORS


def outside(hulls: list[Hull], point: NDArray[np.float64]) -> float:
    """How far a point (3,) is outside the nearest hull at least [m]; negative inside."""
    return min(float((hull.planes @ np.append(point, 1.0)).max()) for hull in hulls)


def test_contacts_lie_on_the_object_and_on_the_link_that_they_name(cube, rows):
    hand, solid = hand_geometry(cube.gripper), ObjectSolid(cube)
    successes = rows[rows["outcome"] >= Outcome.DROPPED]
    seen = set()
    for row in successes:
        frames = hand.frames(row["joints"][None].astype(np.float64))
        position, quaternion = row["settled"][:3].astype(np.float64), row["settled"][3:].astype(np.float64)
        values = row["contact_points"].reshape(-1, CONTACT_VALUES).astype(np.float64)
        for link, (*point, nx, ny, nz, force) in zip(row["contact_links"], values, strict=True):
            if not link:
                continue
            name = cube.gripper.links[link - 1]
            seen.add(name)
            assert abs(outside(solid.hulls, np.array(point))) < 1.5e-3
            assert np.linalg.norm([nx, ny, nz]) == pytest.approx(1.0, abs=2e-3)
            deeper = np.array(point) + 1e-3 * np.array([nx, ny, nz])
            assert outside(solid.hulls, deeper) < outside(solid.hulls, np.array(point)) - 5e-4
            assert force >= 0
            back = quaternion * np.array([-1.0, -1.0, -1.0, 1.0])
            frame = frames[name][0]
            in_link = frame[:3, :3].T @ (rotate(back, np.array(point) - position) - frame[:3, 3])
            assert outside(hand.hulls[name], in_link) < 2e-3
    assert seen == set(cube.gripper.finger_links)
    assert (successes["contact_points"].reshape(len(successes), -1, CONTACT_VALUES)[..., 6].sum(1) > 1).any()


def test_of_many_contacts_those_far_from_each_other_are_kept_with_all_of_the_force():
    random = np.random.default_rng(1)
    contacts = [
        GraspContact(1 + i % 3, random.uniform(-0.05, 0.05, 3).tolist(), [0.0, 0.0, 1.0], float(i))
        for i in range(20)
    ]
    kept = spread_contacts(contacts, 6)
    assert len(kept) == 6
    assert sum(contact.force for contact in kept) == sum(range(20))
    assert kept[0].point == contacts[19].point
    assert spread_contacts(contacts[:6], 6) == contacts[:6]
    nearest = [min(dist(a.point, b.point) for b in kept if b is not a) for a in kept]
    assert min(nearest) > 0.03
