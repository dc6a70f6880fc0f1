"""The swept volume of a closing hand, and how much of an object is in it."""

from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from qdgrasp_assets.genes import layout
from qdgrasp_protocol.rows import NO_SYNERGY
from qdgrasp_worker.decoder import Decoder
from qdgrasp_worker.object_geometry import ObjectSurface
from qdgrasp_worker.screening import SweptVolumes
from qdgrasp_worker.world import World

TIP = np.array([0.0, 0.0, 0.1])
"""Between the tips of the Panda's fingers, hand frame [m]."""


@pytest.fixture(scope="module", params=["panda", "barrett", "allegro"])
def scene(request, make_scene):
    return make_scene(request.param, "tennis_ball", "paper")


@pytest.fixture(scope="module")
def volumes(scene):
    world = World(scene)
    yield SweptVolumes(scene.gripper, world.closing)
    world.close()


@pytest.fixture(scope="module")
def grasps(scene, draw):
    return Decoder(scene, "approach", ObjectSurface(scene))(draw(60, len(layout(scene, "approach"))))


@pytest.fixture(scope="module")
def around(scene):
    """Points (4000, 3) about where the hand grasps, hand frame [m]."""
    grasp = np.array(scene.gripper.approach_axis) * scene.gripper.reach
    return grasp + np.random.default_rng(0).uniform(-0.05, 0.05, (4000, 3))


def shares(volumes, grasps, points):
    """The shares (n, 2) of each of the grasps."""
    return volumes.shares(points.astype(np.float32), grasps, np.arange(len(grasps)))


def seen(grasps, i, points):
    """Points of the hand's frame in the object's."""
    turn = Rotation.from_quat(grasps.quaternions[i].astype(float))
    return turn.apply(points) + grasps.positions[i]


def test_what_is_in_it_is_more_than_what_is_so_from_opposite_sides_and_nothing_is_far_away(
    volumes, grasps, scene
):
    found = shares(volumes, grasps, scene.surface_points)
    assert (found[:, 1] <= found[:, 0]).all()
    assert (found[:, 1] > 0).any()
    assert (found[:, 0] > 0).mean() > 0.3
    assert found.max() <= 1.0
    assert not shares(volumes, grasps, scene.surface_points + 3.0).any()


def test_what_is_in_it_moves_with_the_hand(volumes, grasps, around):
    """Points that stand alike before every hand are alike in its volume, if hands close alike."""
    alike = np.flatnonzero(grasps.synergies == grasps.synergies[0])
    alike = alike[(np.abs(grasps.joints[alike] - grasps.joints[0]) < 1e-6).all(axis=1)][:8]
    found = [
        volumes.shares(seen(grasps, i, around).astype(np.float32), grasps, np.array([i]))[0] for i in alike
    ]
    assert found[0][0] > 5 / len(around)
    np.testing.assert_allclose(found, np.tile(found[0], (len(found), 1)), atol=2 / len(around))


def test_a_share_does_not_depend_on_the_batch(volumes, grasps, scene):
    together = shares(volumes, grasps, scene.surface_points)
    points = scene.surface_points.astype(np.float32)
    for i in range(0, len(grasps), 7):
        np.testing.assert_array_equal(volumes.shares(points, grasps, np.array([i]))[0], together[i])


def test_it_is_measured_once_for_each_way_of_closing(volumes, grasps, scene, monkeypatch):
    shares(volumes, grasps, scene.surface_points)
    monkeypatch.setattr(volumes, "_closing", None)  # to call it would fail
    shares(volumes, grasps, scene.surface_points)
    synergies, places = len(scene.gripper.synergies) or 1, 5 ** len(scene.gripper.free_joints)
    assert 1 <= len(volumes._found) <= synergies * places
    assert sum(volume.voxels.levels.nbytes for volume in volumes._found.values()) < 50e6


def test_the_pandas_fingers_pass_between_their_open_places_and_not_behind_the_palm(make_scene):
    scene = make_scene("panda", "rubiks_cube", "paper")
    grasps = Decoder(scene, "given", ObjectSurface(scene))(
        np.array([[0, 0, 0, 0, 0, 0, 1]], dtype=np.float32)
    )
    assert grasps.synergies.tolist() == [NO_SYNERGY]
    world = World(scene)
    share = partial(shares, SweptVolumes(scene.gripper, world.closing), grasps)
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
