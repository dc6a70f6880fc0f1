"""Which grasps are taken: good enough, the best, and far from each other."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation
from tests.coordinator.export.conftest import MakeRun

from qdgrasp_coordinator.export.grasp_set import Grasps, read_run, select_grasps, spread_places
from qdgrasp_protocol.rows import Outcome


@pytest.fixture
def grasps(make_run: MakeRun) -> Grasps:
    """A hundred and twenty successes of all fitnesses, and failures between them."""
    cycle = [Outcome.DROPPED, Outcome.HELD, Outcome.MISSED, Outcome.SHAKEN]
    return read_run(make_run(*cycle * 40), Outcome.MISSED)


@pytest.mark.parametrize(("least", "expected"), [(0, 120), (1, 80), (2, 40)])
def test_those_that_are_good_enough_are_taken_in_their_order(
    grasps: Grasps, least: int, expected: int
) -> None:
    chosen = select_grasps(grasps, least)
    assert len(chosen) == expected
    assert (chosen.fitness >= least).all()
    assert chosen.is_success.all()
    assert (np.diff(chosen.numbers) > 0).all()


def test_the_best_come_first(grasps: Grasps) -> None:
    chosen = select_grasps(grasps, top=50)
    robust = grasps[grasps.fitness == 2]
    assert len(chosen) == 50
    assert (chosen.fitness[:40] == 2).all()
    assert chosen.rows["penetration"][:40].tolist() == sorted(robust.rows["penetration"].tolist())


def test_a_known_eta_goes_before_fitness(grasps: Grasps) -> None:
    etas = np.full(len(grasps), np.nan)
    weak = np.flatnonzero(grasps.fitness == 1)[:2]
    etas[weak] = (0.25, 0.75)
    chosen = select_grasps(replace(grasps, eta=etas), top=3)
    assert chosen.numbers[:2].tolist() == grasps.numbers[weak[::-1]].tolist()
    assert chosen.fitness[2] == 2


def test_spread_grasps_are_farther_apart_than_the_best_ones(grasps: Grasps) -> None:
    diverse, best = select_grasps(grasps, diverse=12), select_grasps(grasps, top=12)
    assert len(diverse) == len(set(diverse.numbers.tolist())) == 12
    assert diverse.numbers[0] == best.numbers[0]
    assert nearest(diverse) > 1.5 * nearest(best)


def test_each_spread_grasp_is_the_farthest_from_those_before_it(grasps: Grasps) -> None:
    some = select_grasps(grasps)[:30]
    apart = distances(some)
    chosen = spread_places(some, 8)
    for count in range(1, 8):
        reach = apart[:, chosen[:count]].min(axis=1)
        assert reach[chosen[count]] == pytest.approx(reach.max())


def test_the_first_of_many_spread_grasps_are_the_few(grasps: Grasps) -> None:
    assert spread_places(grasps, 20)[:5].tolist() == spread_places(grasps, 5).tolist()


def test_more_than_there_are_is_all_of_them(grasps: Grasps) -> None:
    assert sorted(spread_places(grasps[:7], 100).tolist()) == list(range(7))
    assert len(select_grasps(grasps, 2, top=1000)) == 40


def test_of_the_best_the_spread_ones_are_taken(grasps: Grasps) -> None:
    chosen = select_grasps(grasps, top=40, diverse=10)
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


def nearest(grasps: Grasps) -> float:
    apart = distances(grasps)
    return float(apart[~np.eye(len(grasps), dtype=bool)].min())


def distances(grasps: Grasps) -> np.ndarray:
    """As they are documented, by another way: a point at the hand's reach, turned by the angle between."""
    poses, reach = grasps.poses("com"), grasps.scene.gripper.reach
    turns = Rotation.from_quat(poses[:, 3:])
    half = Rotation.from_rotvec(np.pi * np.array(grasps.scene.gripper.approach_axis))
    angles = np.array([
        [min((a.inv() * b).magnitude(), (a.inv() * b * half).magnitude()) for b in turns] for a in turns
    ])  # fmt: skip
    return np.hypot(cdist(poses[:, :3], poses[:, :3]), 2 * reach * np.sin(angles / 2))
