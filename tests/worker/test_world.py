"""The world in Bullet: loading, motion, independent episodes, and output."""

import ctypes
import os
import tempfile

import msgspec
import numpy as np
import pytest
from tests.common import with_gripper

from qdgrasp_assets.catalog import GRIPPERS
from qdgrasp_assets.scene import Synergy
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.rows import NO_SYNERGY
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.engines.bullet import quiet
from qdgrasp_worker.engines.bullet_world import BulletShakenWorld
from qdgrasp_worker.evaluation_protocols import CLOSING_STEPS, SHAKES, TARGET_STEPS, TrialSetup

FAR = TrialSetup(HandPose([1.0, 1.0, 1.0], [0.5, 0.5, 0.5, 0.5], [0.04, 0.04], NO_SYNERGY))
LEFT, RIGHT = "panda_finger_joint1", "panda_finger_joint2"
TABLE = {
    "z": [0.014, 0.054, 0.120, 0.175, 0.204, 0.206, 0.181, 0.131, 0.062, 0.016, -0.005, -0.003],
    "x": [0.457, 0.648, 0.728, 0.762, 0.054, -0.434, -0.638, -0.724, -0.302, -0.126, -0.053, -0.022],
}
"""The Panda's motion in the public code's shakes, every 17 steps [m, rad]."""


@pytest.fixture
def world(cube):
    world = BulletShakenWorld(cube)
    yield world
    world.close()


def close_hand(world, synergy=NO_SYNERGY):
    world.close_fingers(synergy)
    for _ in range(CLOSING_STEPS):
        world.step()


def shaken(world, shake):
    """The place of the shaken joint after every 17 steps."""
    index, _ = world._shaken[shake.joint]
    places = []
    for target in shake.targets:
        world.shake_to(target, shake)
        for step in range(1, TARGET_STEPS + 1):
            world.step()
            if step % 17 == 0:
                places += world._bullet.joints(world._hand.body, [index])
    return places


@pytest.mark.parametrize("gripper", sorted(path.stem for path in GRIPPERS.glob("*.toml")))
def test_in_paper_every_empty_hand_shakes_as_the_panda_is_tabled(gripper, make_scene, request):
    if gripper.startswith("ref_"):
        request.getfixturevalue("asset_path")
    scene = make_scene(gripper, "rubiks_cube", "paper")
    world = BulletShakenWorld(scene)
    world.reset(FAR, world.opened)
    close_hand(world)
    for shake in SHAKES:
        peak = max(TABLE[shake.joint])
        np.testing.assert_allclose(shaken(world, shake), TABLE[shake.joint], atol=0.1 * peak)
    world.close()


def test_an_object_that_nothing_reaches_keeps_its_place_to_the_bit(world):
    world.reset(FAR, world.opened)
    assert world.finger_positions() == [0.04, 0.04]
    close_hand(world)
    for shake in SHAKES:
        shaken(world, shake)
    bullet, body = world._bullet, world._target.body
    assert bullet.position(body) == (0.0, 0.0, 0.0)
    assert bullet.velocity(body) == (0.0, 0.0, 0.0)
    assert not world.is_touching()


def test_the_course_of_a_closing_hand_is_the_same_whatever_was_before(world):
    course = world.closing([0.04, 0.03], NO_SYNERGY)
    assert len(course) == CLOSING_STEPS + 1
    np.testing.assert_allclose(course[0], [0.04, 0.03])
    np.testing.assert_allclose(course[-1], 0.0, atol=1e-3)
    world.reset(FAR, [0.01, 0.01])
    world.shake_to(0.2, SHAKES[0])
    close_hand(world)
    assert world.closing([0.04, 0.03], NO_SYNERGY) == course


def test_a_synergy_closes_its_own_joints_and_the_others_stay_open(cube):
    synergies = (Synergy(name="left", joints=(LEFT,)), Synergy(name="right", joints=(RIGHT,)))
    world = BulletShakenWorld(with_gripper(cube, synergies=synergies))
    for synergy, expected in ((0, [0.0, 0.04]), (1, [0.04, 0.0]), (NO_SYNERGY, [0.0, 0.0])):
        world.reset(FAR, world.opened)
        close_hand(world, synergy)
        np.testing.assert_allclose(world.finger_positions(), expected, atol=1e-4)
    world.close()


def test_a_joint_that_nothing_drives_stays_where_it_was_put(cube):
    joints = tuple(msgspec.structs.replace(joint, driven=joint.name == LEFT) for joint in cube.gripper.joints)
    world = BulletShakenWorld(with_gripper(cube, joints=joints))
    world.reset(FAR, [0.04, 0.013])
    close_hand(world)
    np.testing.assert_allclose(world.finger_positions(), [0.0, 0.013], atol=1e-4)
    world.close()


def test_a_reset_world_has_forgotten_contacts_motors_and_motion(world):
    touching = HandPose([0.0, 0.0, 0.13], [1.0, 0.0, 0.0, 0.0], [0.04, 0.04], NO_SYNERGY)

    def trace():
        world.reset(TrialSetup(touching), touching.joints)
        close_hand(world)
        bullet, body = world._bullet, world._target.body
        return world.contacts(), world.finger_positions(), bullet.position(body), bullet.velocity(body)

    first = trace()
    assert first[0], "the pose was to touch the object"
    for shake in SHAKES:
        shaken(world, shake)
    world.reset(FAR, world.opened)
    assert trace() == first


def test_loading_leaves_no_files_and_no_words_on_the_console(cube, tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    BulletShakenWorld(cube).close()
    assert list(tmp_path.iterdir()) == []
    seen = capfd.readouterr()
    assert (seen.out, seen.err) == ("", "")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"finger_links": ("thumb",)}, r"no finger link 'thumb'. It has: .*panda_leftfinger"),
        ({"meshes": {}}, r"Bullet cannot load 'body.urdf'"),
        ({"meshes": {"../escape.stl": b""}}, r"'../escape.stl' does not"),
        ({"urdf": "<robot>"}, r"Bullet cannot load 'body.urdf'"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else None,
)
def test_a_hand_that_cannot_be_loaded_is_an_asset_error(change, message, cube, capfd):
    with pytest.raises(AssetError, match=message):
        BulletShakenWorld(with_gripper(cube, **change))
    assert capfd.readouterr().out == ""


def test_a_joint_that_is_not_there_is_an_asset_error(cube):
    joints = (msgspec.structs.replace(cube.gripper.joints[0], name="thumb"),)
    with pytest.raises(AssetError, match=r"no joint 'thumb'. It has: panda_finger_joint1"):
        BulletShakenWorld(with_gripper(cube, joints=joints))


def test_what_c_prints_meanwhile_is_not_seen_even_if_it_is_written_late(capfd):
    with quiet():
        ctypes.CDLL(None).printf(b"from C, buffered\n")
        os.write(1, b"from C, at once\n")
        os.write(2, b"a warning\n")
    ctypes.CDLL(None).fflush(None)
    seen = capfd.readouterr()
    assert seen.out == ""
    assert seen.err == ""


def test_what_is_printed_before_and_after_is_seen(capfd):
    print("before")  # noqa: T201
    with quiet():
        os.write(1, b"meanwhile")
    os.write(1, b"after\n")
    assert capfd.readouterr().out == "before\nafter\n"


def test_streams_come_back_after_an_exception(capfd):
    try:
        with quiet():
            raise ValueError
    except ValueError:
        os.write(1, b"here")
    assert capfd.readouterr().out == "here"
