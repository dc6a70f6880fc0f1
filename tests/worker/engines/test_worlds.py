"""The contract of a world, in each engine and for both kinds of protocols."""

from contextlib import closing

import msgspec
import numpy as np
import pytest
from tests.common import with_gripper
from tests.worker.test_physical_episode import ABOVE

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.scene import Synergy
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.rows import NO_SYNERGY
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.engines import make_world
from qdgrasp_worker.evaluation_protocols import PROTOCOLS, SHAKES, TrialSetup
from qdgrasp_worker.world import ShakenWorld

FAR = HandPose([1.0, 1.0, 1.0], [0.5, 0.5, 0.5, 0.5], [0.04, 0.04], NO_SYNERGY)
LEFT, RIGHT = "panda_finger_joint1", "panda_finger_joint2"
INSIDE = HandPose([0.0, 0.0, 0.03], ABOVE.quaternion, ABOVE.joints, NO_SYNERGY)


@pytest.fixture(scope="class", params=["bullet", "mujoco"])
def engine(request) -> str:
    return request.param


@pytest.fixture(scope="class", params=["paper", "physical"])
def scene(request, engine):
    spec = RunSpec(gripper="panda", object="rubiks_cube", protocol=request.param)
    return build_scene(msgspec.structs.replace(spec, engine=None if engine == "bullet" else engine))


@pytest.fixture(scope="class")
def world(scene):
    with closing(make_world(scene, PROTOCOLS[scene.protocol])) as made:
        yield made


def closed(world, pose):
    """Place the hand and close it; the courses of its fingers."""
    world.reset(TrialSetup(pose), pose.joints)
    world.close_fingers(pose.synergy)
    course = []
    for _ in range(100):
        world.step()
        course.append(world.finger_positions())
    return course


class TestWorld:
    def test_a_hand_stands_where_it_is_put(self, world):
        world.reset(TrialSetup(FAR), FAR.joints)
        position, quaternion = world.hand_pose()
        assert position == pytest.approx(FAR.position, abs=1e-6)
        assert abs(quaternion @ np.array(FAR.quaternion)) == pytest.approx(1.0)
        assert world.finger_positions() == pytest.approx([0.04, 0.04])
        world.set_fingers([0.01, 0.02])
        assert world.finger_positions() == pytest.approx([0.01, 0.02])

    def test_open_fingers_at_the_sides_do_not_touch_and_a_palm_in_the_object_overlaps(self, world):
        for pose, touches in ((ABOVE, False), (INSIDE, True), (FAR, False)):
            world.reset(TrialSetup(pose), pose.joints)
            assert any(contact.distance < 0.0 for contact in world.contacts()) == touches
        world.place_hand(INSIDE)
        assert world.is_touching()

    def test_fingers_that_close_on_nothing_meet_and_their_course_is_the_same_again(self, world):
        course = world.closing([0.04, 0.04], NO_SYNERGY)
        assert course[0] == pytest.approx([0.04, 0.04])
        assert course[-1] == pytest.approx([0.0, 0.0], abs=2e-3)
        closed(world, ABOVE)
        assert world.closing([0.04, 0.04], NO_SYNERGY) == course

    def test_contacts_are_at_both_fingers_with_forces_into_the_cube(self, world):
        closed(world, ABOVE)
        assert {contact.link for contact in world.contacts()} >= world.finger_links
        found = world.contact_forces()
        normals = np.array([each.normal for each in found])
        assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
        points = np.array([each.point for each in found])
        assert (np.abs(points) < 0.06).all()
        assert (np.einsum("ij,ij->i", points, normals) < 0.0).all()
        forces = np.array([each.force for each in found])
        left, right = (forces[np.array([each.link for each in found]) == link].sum() for link in (2, 3))
        assert left > 1.0
        assert right > 1.0

    def test_a_reset_world_has_forgotten_contacts_motors_and_motion(self, world):
        first = closed(world, ABOVE), world.contacts(), world.hand_pose()[0].tolist()
        closed(world, INSIDE)
        world.reset(TrialSetup(FAR), FAR.joints)
        assert (closed(world, ABOVE), world.contacts(), world.hand_pose()[0].tolist()) == first

    def test_an_object_that_nothing_reaches_keeps_its_place(self, world):
        closed(world, FAR)
        position, quaternion = world.hand_pose()
        assert position == pytest.approx(FAR.position, abs=1e-6)
        assert abs(quaternion @ np.array(FAR.quaternion)) == pytest.approx(1.0)
        assert not world.is_touching()

    def test_an_unknown_synergy_is_an_error(self, world):
        with pytest.raises(ValueError, match=r"synergy must be one of \[-1\], got 3"):
            world.close_fingers(3)


def test_a_synergy_closes_its_own_joints_and_the_others_stay_open(scene):
    synergies = (Synergy(name="left", joints=(LEFT,)), Synergy(name="right", joints=(RIGHT,)))
    with closing(make_world(with_gripper(scene, synergies=synergies), PROTOCOLS[scene.protocol])) as world:
        for synergy, expected in ((0, [0.0, 0.04]), (1, [0.04, 0.0]), (NO_SYNERGY, [0.0, 0.0])):
            assert world.closing(world.opened, synergy)[-1] == pytest.approx(expected, abs=6e-3)


def test_a_joint_that_nothing_drives_stays_where_it_was_put(scene):
    joints = tuple(
        msgspec.structs.replace(joint, driven=joint.name == LEFT) for joint in scene.gripper.joints
    )
    hand = msgspec.structs.replace(scene.gripper, joints=joints, jaw=None)
    with closing(
        make_world(msgspec.structs.replace(scene, gripper=hand), PROTOCOLS[scene.protocol])
    ) as world:
        assert world.closing([0.04, 0.013], NO_SYNERGY)[-1][1] == pytest.approx(0.013, abs=1e-3)


def test_joints_without_limits_close_as_far_as_they_are_told(engine):
    spec = RunSpec(gripper="robotiq_2f", object="rubiks_cube", protocol="physical")
    scene = build_scene(msgspec.structs.replace(spec, engine=None if engine == "bullet" else engine))
    endless = scene.gripper.urdf.replace('type="revolute"', 'type="continuous"')
    ends = []
    for changed in (scene, with_gripper(scene, urdf=endless)):
        with closing(make_world(changed, PROTOCOLS["physical"])) as world:
            ends.append(world.closing(world.opened, NO_SYNERGY)[-1])
    assert ends[1] == pytest.approx(ends[0], abs=0.15)  # limits stop the preload of some of them
    assert min(np.abs(ends[1])) > 0.4


@pytest.mark.parametrize("change", ["finger_links", "joints"])
def test_a_name_that_the_hand_does_not_have_is_an_asset_error(change, scene):
    joint = msgspec.structs.replace(scene.gripper.joints[0], name="thumb")
    wrong = {"finger_links": ("thumb",), "joints": (joint,)}
    with pytest.raises(AssetError, match=r"no (finger link|joint) 'thumb'"):
        make_world(with_gripper(scene, **{change: wrong[change]}), PROTOCOLS[scene.protocol])


@pytest.mark.parametrize("shake", SHAKES, ids=lambda shake: shake.joint)
def test_a_hand_on_its_carrier_is_shaken_and_comes_back(shake, engine):
    spec = RunSpec(gripper="panda", object="rubiks_cube", protocol="paper")
    scene = build_scene(msgspec.structs.replace(spec, engine=None if engine == "bullet" else engine))
    with closing(make_world(scene, PROTOCOLS["paper"])) as world:
        assert isinstance(world, ShakenWorld)
        closed(world, FAR)
        places = [world.hand_pose()]
        for target in shake.targets:
            world.shake_to(target, shake)
            for _ in range(68):
                world.step()
            places.append(world.hand_pose())
    moved = [np.linalg.norm(position - places[0][0]) for position, _ in places]
    turned = [2 * np.arccos(min(1.0, abs(quaternion @ places[0][1]))) for _, quaternion in places]
    if shake.joint == "z":
        assert moved == pytest.approx([0.0, 0.175, 0.124, 0.0], abs=0.015)
        assert turned == pytest.approx([0.0] * 4, abs=1e-3)
    else:
        assert turned == pytest.approx([0.0, 0.762, 0.724, 0.022], abs=0.01)
