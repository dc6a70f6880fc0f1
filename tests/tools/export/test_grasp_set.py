"""Grasps as arrays and one by one, and their selection: good, best, far from each other."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation
from tests.tools.export.conftest import COM, MakeRun

from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.export.grasp_reader import GraspChoice, read_run, select_grasps, spread_places
from qdgrasp_tools.export.grasp_set import Grasps


@pytest.fixture
def few(run: RunFolder) -> Grasps:
    return read_run(run)


def test_one_grasp_says_what_the_arrays_say(few: Grasps) -> None:
    for place, grasp in enumerate(few):
        assert grasp.number == few.numbers[place]
        np.testing.assert_array_equal(grasp.position, few.rows["base_to_object"][place, :3] + np.array(COM))
        np.testing.assert_array_equal(grasp.quaternion_xyzw, few.poses("com")[place, 3:])
        np.testing.assert_array_equal(grasp.joints, few.rows["joints"][place])
        assert grasp.pregrasp.tolist() == pytest.approx([0.04, 0.04])
        assert (grasp.synergy, grasp.confidence) == ("", grasp.fitness / 2)
        assert np.isnan(grasp.eta)
    assert [grasp.outcome for grasp in few] == sorted(2 * [Outcome.DROPPED, Outcome.SHAKEN, Outcome.HELD])


def test_a_number_takes_one_and_anything_else_several(few: Grasps) -> None:
    assert few[-1].number == few.numbers[-1]
    for places in (slice(1, 3), np.array([1, 2]), np.arange(6) % 3 == 0):
        some = few[places]
        assert some.numbers.tolist() == few.numbers[places].tolist()
        assert some.starts.tobytes() == few.starts[places].tobytes()
    with pytest.raises(IndexError):
        few[6]


def test_failures_are_there_if_they_are_asked_for(run: RunFolder) -> None:
    every = read_run(run, Outcome.MISSED)
    assert every.rows["outcome"].tolist() == sorted([*range(3, 8)] * 2)
    assert np.count_nonzero(every.is_success) == 6
    assert np.count_nonzero(every.is_grasp) == 4


@pytest.fixture
def grasps(make_run: MakeRun) -> Grasps:
    """A hundred and twenty successes of all fitnesses, and failures between them."""
    cycle = [Outcome.DROPPED, Outcome.HELD, Outcome.MISSED, Outcome.SHAKEN]
    return read_run(make_run(*cycle * 40), Outcome.MISSED)


@pytest.mark.parametrize(("least", "expected"), [(0, 120), (1, 80), (2, 40)])
def test_those_that_are_good_enough_are_taken_in_their_order(grasps, least, expected) -> None:
    chosen = select_grasps(grasps, GraspChoice(least))
    assert len(chosen) == expected
    assert (chosen.fitness >= least).all()
    assert chosen.is_success.all()
    assert (np.diff(chosen.numbers) > 0).all()


def test_the_best_come_first(grasps: Grasps) -> None:
    chosen = select_grasps(grasps, GraspChoice(top=50))
    robust = grasps[grasps.fitness == 2]
    assert len(chosen) == 50
    assert (chosen.fitness[:40] == 2).all()
    assert chosen.motion[:40, 0].tolist() == sorted(robust.motion[:, 0])


def test_a_known_eta_goes_before_fitness(grasps: Grasps) -> None:
    etas = np.full(len(grasps), np.nan)
    weak = np.flatnonzero(grasps.fitness == 1)[:2]
    etas[weak] = (0.25, 0.75)
    chosen = select_grasps(replace(grasps, eta=etas), GraspChoice(top=3))
    assert chosen.numbers[:2].tolist() == grasps.numbers[weak[::-1]].tolist()
    assert chosen.fitness[2] == 2


def test_each_spread_grasp_is_the_farthest_from_those_before_it(grasps: Grasps) -> None:
    some = select_grasps(grasps)[:30]
    apart = distances(some)
    chosen = spread_places(some, 8)
    for count in range(1, 8):
        reach = apart[:, chosen[:count]].min(axis=1)
        assert reach[chosen[count]] == pytest.approx(reach.max())


def test_of_the_best_the_spread_ones_are_taken(grasps: Grasps) -> None:
    chosen = select_grasps(grasps, GraspChoice(top=40, diverse=10))
    assert len(chosen) == 10
    assert (chosen.fitness == 2).all()


def test_a_jaw_that_is_turned_round_is_no_other_grasp(make_run: MakeRun) -> None:
    grasps = read_run(make_run(*[Outcome.HELD] * 3))
    quaternion = Rotation.from_quat(grasps.rows["base_to_object"][0, 3:])
    same = quaternion * Rotation.from_euler("z", 180, degrees=True)
    aside = quaternion * Rotation.from_euler("z", 20, degrees=True)
    for row, turn in zip(grasps.rows, (quaternion, same, aside), strict=True):
        row["base_to_object"][3:] = turn.as_quat()
        row["base_to_object"][:3] = 0
    assert spread_places(grasps, 3).tolist() == [0, 2, 1]
    hand = msgspec.structs.replace(grasps.scene.gripper, jaw=None)
    plain = replace(grasps, scene=msgspec.structs.replace(grasps.scene, gripper=hand))
    assert spread_places(plain, 3).tolist() == [0, 1, 2]


def distances(grasps: Grasps) -> np.ndarray:
    """The documented distances by another way: a point at the hand's reach is turned."""
    poses, reach = grasps.poses("com"), grasps.scene.gripper.reach
    turns = Rotation.from_quat(poses[:, 3:])
    half = Rotation.from_rotvec(np.pi * np.array(grasps.scene.gripper.approach_axis))
    angles = np.array([
        [min((a.inv() * b).magnitude(), (a.inv() * b * half).magnitude()) for b in turns] for a in turns
    ])  # fmt: skip
    return np.hypot(cdist(poses[:, :3], poses[:, :3]), 2 * reach * np.sin(angles / 2))
