"""Swept volumes: the space that closing fingers pass over, and their first contacts."""

from contextlib import closing
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.worker.genomes import above, decoded, draw, side_of

from qdgrasp_assets.genes import layout
from qdgrasp_protocol.rows import NO_SYNERGY
from qdgrasp_worker.engines.bullet_world import BulletShakenWorld
from qdgrasp_worker.object_geometry import SurfaceSample
from qdgrasp_worker.swept_volume import SweptVolumes

TIP = np.array([0.0, 0.0, 0.1])
"""Between the tips of the Panda's fingers, hand frame [m]."""


@pytest.fixture(scope="module", params=["panda", "barrett", "allegro"])
def hand_scene(request, make_scene):
    return make_scene(request.param, "tennis_ball", "paper")


@pytest.fixture(scope="module")
def volumes(hand_scene):
    world = BulletShakenWorld(hand_scene)
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


def test_what_is_in_it_moves_with_the_hand(volumes, grasps, around):
    """Points that stand alike before every hand are alike in its volume, if hands close alike."""
    alike = np.flatnonzero(grasps.synergies == grasps.synergies[0])
    alike = alike[(np.abs(grasps.joints[alike] - grasps.joints[0]) < 1e-6).all(axis=1)][:8]
    found = [
        volumes.shares(seen(grasps, i, around).astype(np.float32), grasps, np.array([i]))[0] for i in alike
    ]
    assert found[0][0] > 5 / len(around)
    np.testing.assert_allclose(found, np.tile(found[0], (len(found), 1)), atol=2 / len(around))


def test_the_pandas_fingers_pass_between_their_open_places_and_not_behind_the_palm(make_scene):
    hand_scene = make_scene("panda", "rubiks_cube", "paper")
    grasps = decoded(hand_scene, "given", np.array([[0, 0, 0, 0, 0, 0, 1]], dtype=np.float32))
    assert grasps.synergies.tolist() == [NO_SYNERGY]
    world = BulletShakenWorld(hand_scene)
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


FINGERS = {"panda": 2, "barrett": 3, "allegro": 4, "shadow": 5}


@pytest.fixture(scope="module")
def contacts(volumes, grasps, hand_scene):
    return volumes.first_contacts(SurfaceSample(hand_scene), grasps, np.arange(len(grasps)))


def test_fingers_meet_a_ball_on_its_surface_and_mostly_come_from_without(contacts, hand_scene):
    radius = np.linalg.norm(hand_scene.surface_points, axis=1).max()
    assert contacts.meets.shape[1] == FINGERS[hand_scene.gripper.name]
    assert contacts.meets.any(axis=0).all()
    points, normals = contacts.points[contacts.meets], contacts.normals[contacts.meets]
    lengths = np.linalg.norm(points, axis=1)
    assert lengths.max() <= radius * 1.001
    assert np.median(lengths) > 0.5 * radius
    np.testing.assert_allclose(normals, points / radius, atol=0.07)
    inward = -(normals * contacts.ways[contacts.meets]).sum(axis=1)
    assert (inward > 0).mean() > 0.8
    strokes = contacts.strokes[contacts.meets]
    assert strokes.min() >= 0
    assert strokes.max() <= 1
    for column in (contacts.points, contacts.normals, contacts.ways, contacts.strokes):
        assert not column[~contacts.meets].any()


def test_the_pandas_fingers_meet_opposite_faces_of_a_cube_between_them(make_scene):
    hand_scene = make_scene("panda", "rubiks_cube", "paper")
    poses = [above(hand_scene), above(hand_scene, along=0.006), above(hand_scene, height=3.0)]
    grasps = decoded(hand_scene, "given", np.array(poses, np.float32))
    with closing(BulletShakenWorld(hand_scene)) as world:
        volumes = SweptVolumes(hand_scene.gripper, world.closing)
        contacts = volumes.first_contacts(SurfaceSample(hand_scene), grasps, np.arange(3))
    face = side_of(hand_scene)
    assert contacts.meets.tolist() == [[True, True], [True, True], [False, False]]
    for column in (contacts.points, contacts.normals, -contacts.ways):
        sides = np.sign(column[:2] @ face)
        assert (sides.sum(axis=1) == 0).all()
        assert (sides == sides[0]).all()
    np.testing.assert_allclose(np.abs(contacts.points[:2] @ face), 0.0285, atol=0.006)
    np.testing.assert_allclose(np.abs(contacts.ways[:2] @ face), 1.0, atol=0.01)
    assert contacts.strokes[0, 0] == contacts.strokes[0, 1] > 0.5
