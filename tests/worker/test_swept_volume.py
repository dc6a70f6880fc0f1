"""Swept volumes: the space that closing fingers pass over, and their first contacts."""

from contextlib import closing
from functools import partial

import numpy as np
from tests.worker.genomes import above, decoded, side_of

from qdgrasp_protocol.rows import NO_SYNERGY
from qdgrasp_worker.engines.bullet_world import BulletShakenWorld
from qdgrasp_worker.object_geometry import SurfaceSample
from qdgrasp_worker.swept_volume import SweptVolumes

TIP = np.array([0.0, 0.0, 0.1])
"""Between the tips of the Panda's fingers, hand frame [m]."""


def shares(volumes, grasps, points):
    """The shares (n, 2) of each of the grasps."""
    return volumes.shares(points.astype(np.float32), grasps, np.arange(len(grasps)))


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
