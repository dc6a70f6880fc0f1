"""MuJoCo's model of a scene beside Bullet's: masses, reach, links that meet, distances, forces."""

import xml.etree.ElementTree as ET
from contextlib import closing
from math import sin
from pathlib import Path

import msgspec
import numpy as np
import pytest
from tests.common import with_gripper
from tests.worker.test_physical_episode import ABOVE, HANDS, LIMIT_TOLERANCE

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.grippers.urdf import parse_robot
from qdgrasp_assets.scene import Scene, Synergy, pack_scene, unpack_scene
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.rows import NO_SYNERGY
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.engines.mujoco_model import SceneModel, couplings, reach_of
from qdgrasp_worker.engines.mujoco_simulation import SimulationDiverged
from qdgrasp_worker.engines.mujoco_world import MujocoPhysicalWorld, MujocoShakenWorld
from qdgrasp_worker.episode import ShakenEpisode
from qdgrasp_worker.evaluation_protocols import PAPER, PHYSICAL, Physics, TrialSetup
from qdgrasp_worker.physical_episode import PhysicalEpisode

PHYSICS = PHYSICAL.physics or Physics()
LEFT, RIGHT = "panda_finger_joint1", "panda_finger_joint2"
PRELOAD = 35.0
"""Force of each finger of the Panda [N]."""
UPWARD = [0.0, 0.0, 0.0, 1.0]


@pytest.fixture(scope="module")
def scene(make_scene) -> Scene:
    return make_scene("panda", "rubiks_cube", "physical")


@pytest.fixture(scope="module")
def world(scene) -> MujocoPhysicalWorld:
    return MujocoPhysicalWorld(scene, PHYSICS)


@pytest.fixture
def bullet(scene):
    from qdgrasp_worker.engines.bullet_world import BulletPhysicalWorld

    with closing(BulletPhysicalWorld(scene, PHYSICS)) as made:
        yield made


@pytest.fixture(params=HANDS)
def hand_scene(request, make_scene) -> Scene:
    return make_scene(request.param, "mug", "physical")


URDF_OF_A_LINKAGE = """<robot name="hand"><link name="palm"/><link name="one"/><link name="two"/>
<joint name="a" type="revolute"><parent link="palm"/><child link="one"/><axis xyz="0 0 1"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint>
<joint name="b" type="revolute"><parent link="one"/><child link="two"/><axis xyz="0 0 1"/>
<limit lower="0" upper="2" effort="1" velocity="1"/><mimic joint="a" multiplier="2" offset="0.1"/></joint>
</robot>"""


def test_masses_and_moments_are_those_of_bullet(hand_scene):
    from qdgrasp_worker.engines.bullet_world import BulletPhysicalWorld, HandBody, ObjectBody

    class UndrivenWorld(BulletPhysicalWorld):
        """A world of Bullet whose links have their own inertia alone."""

        def _add_inertia(self, index: int, inertia: float, *, slides: bool) -> None:
            pass

    model = SceneModel(hand_scene, PHYSICS.time_step)
    with closing(UndrivenWorld(hand_scene, PHYSICS)) as world:
        bullet, hand, target = world._bullet, world._hand, world._target
        assert isinstance(hand, HandBody)
        assert isinstance(target, ObjectBody)
        for index, link in enumerate(bullet.links(hand.body)):
            mass, moments = bullet.inertia(hand.body, index)
            assert model.links[link.link].mass == pytest.approx(mass)
            assert model.links[link.link].moments == pytest.approx(moments, rel=2e-3, abs=1e-12)
        assert model.moments == pytest.approx(bullet.inertia(target.body)[1], rel=1e-4)


def test_the_reach_of_joints_is_that_of_bullet(hand_scene):
    from qdgrasp_worker.engines import bullet_world

    model = SceneModel(hand_scene, PHYSICS.time_step)
    opened = {joint.name: joint.opened for joint in hand_scene.gripper.joints}
    with closing(bullet_world.BulletPhysicalWorld(hand_scene, PHYSICS)) as world:
        bullet, hand = world._bullet, world._hand
        links = bullet.links(hand.body)
        world._place_away(hand_scene.gripper, world.opened)
        for index, joint in zip(hand.fingers, model.joints, strict=True):
            expected = bullet_world.reach_of(bullet, hand, index, links)
            assert reach_of(model.robot, model.links, opened, joint) == pytest.approx(expected, abs=2e-3)


def test_a_hand_that_closes_on_nothing_keeps_its_limits(hand_scene):
    world = MujocoPhysicalWorld(hand_scene, PHYSICS)
    course = np.array(world.closing(world.opened, NO_SYNERGY))
    joints = SceneModel(hand_scene, PHYSICS.time_step).joints
    low, high = np.array([(each.lower, each.upper) for each in joints]).T
    assert (course[-1] >= low - 5 * LIMIT_TOLERANCE).all()
    assert (course[-1] <= high + 5 * LIMIT_TOLERANCE).all()
    driven = [joint.opened != joint.closed for joint in hand_scene.gripper.joints]
    assert (np.abs(course[-1] - world.opened) > LIMIT_TOLERANCE)[driven].all()
    assert (course == np.array(world.closing(world.opened, NO_SYNERGY))).all()


@pytest.mark.parametrize("gap", [2.4e-3, 2.1e-3, 1.9e-3, 1e-3, -1e-3])
def test_a_finger_before_a_side_is_as_far_from_it_as_in_bullet(world, bullet, gap):
    height = -0.0285 - gap - 0.112249  # The cube's lower side and the Panda's fingertips
    trial = TrialSetup(HandPose([0.0, 0.045, height], UPWARD, ABOVE.joints, NO_SYNERGY))
    found = []
    for each in (world, bullet):
        each.reset(trial, ABOVE.joints)
        found.append(min((contact.distance for contact in each.contacts()), default=None))
    if gap > 2.2e-3:
        assert found[0] is None or found[0] > 0
    else:
        assert found[0] == pytest.approx(found[1], abs=5e-5)
        assert (found[0] < 0) == (gap < 2e-3)


def test_a_jaw_grips_with_its_preload_and_both_fingers_go_the_same_way(world):
    aside = HandPose([0.008 * sin(0.5), 0.0, 0.1], ABOVE.quaternion, ABOVE.joints, NO_SYNERGY)
    for pose in (ABOVE, aside):
        verdict = PhysicalEpisode(world, PHYSICAL).run(TrialSetup(pose))
        by_link = [sum(each.force for each in verdict.contacts if each.link == link) for link in (2, 3)]
        assert by_link == pytest.approx([PRELOAD, PRELOAD], rel=0.05)
        assert verdict.joints[0] == pytest.approx(verdict.joints[1], abs=1e-4)
    assert np.linalg.norm([each.normal for each in verdict.contacts], axis=1) == pytest.approx(1.0)


def test_a_synergy_of_one_finger_does_not_drag_the_other(scene):
    one = with_gripper(scene, synergies=(Synergy(name="left", joints=(LEFT,)),))
    world = MujocoPhysicalWorld(one, PHYSICS)
    left, right = world.closing(world.opened, 0)[-1]
    assert left < 0.01
    assert right == pytest.approx(world.opened[1], abs=1e-3)
    with pytest.raises(ValueError, match="synergy must be one of"):
        world.closing(world.opened, 1)


def test_joints_are_coupled_where_the_urdf_says_that_they_mimic(scene):
    robot = parse_robot(Path(), ET.fromstring(URDF_OF_A_LINKAGE))  # noqa: S314  # written above
    one, two = (
        msgspec.structs.replace(scene.gripper.joints[0], name=name, opened=0.0, closed=closed)
        for name, closed in (("a", 0.5), ("b", 1.1))
    )
    hand = msgspec.structs.replace(scene.gripper, joints=(one, two), jaw=None)
    assert list(couplings(robot, hand)) == [("b", "a", 0.1, 2.0)]
    free = msgspec.structs.replace(hand, joints=(one, msgspec.structs.replace(two, driven=False)))
    assert list(couplings(robot, free)) == []


def test_an_object_is_pushed_by_its_weight_along_an_axis_of_the_hand(world):
    far = TrialSetup(HandPose([0.0, 0.3, 0.3], ABOVE.quaternion, ABOVE.joints, NO_SYNERGY))
    world.reset(far, ABOVE.joints)
    world.close_fingers(NO_SYNERGY)
    world.release()
    world.begin_pushes()
    before = np.array(world.object_pose()[0])
    for _ in range(PHYSICS.steps(PHYSICS.push_time) // world.steps_at_once):
        world.push((0.0, 1.0, 0.0))
        world.step()
    moved = np.array(world.object_pose()[0]) - before
    assert moved == pytest.approx([0.0, PHYSICS.weight * PHYSICS.push_time**2 / 2, 0.0], rel=0.02, abs=1e-9)


def test_numbers_that_are_not_finite_are_no_result(world):
    world.reset(TrialSetup(ABOVE), [float("nan"), 0.04])
    world.close_fingers(NO_SYNERGY)
    with pytest.raises(SimulationDiverged):
        world.step()


def test_a_shape_without_an_inside_is_refused(scene):
    urdf = scene.gripper.urdf.replace("<collision", '<collision concave="yes"', 1)
    with pytest.raises(AssetError, match="convex meshes"):
        MujocoPhysicalWorld(with_gripper(scene, urdf=urdf), PHYSICS)


@pytest.mark.parametrize("phase", ["closing", "shaking"])
def test_an_episode_whose_numbers_diverge_has_no_verdict(phase, make_scene, monkeypatch):
    world = MujocoShakenWorld(make_scene("panda", "rubiks_cube", "paper", "mujoco"))
    begin = {"closing": "close_fingers", "shaking": "shake_to"}[phase]

    def begin_badly(self, *arguments) -> None:
        acts[begin](self, *arguments)
        self.free.data.qvel[0] = np.nan

    acts = {begin: getattr(MujocoShakenWorld, begin)}
    monkeypatch.setattr(MujocoShakenWorld, begin, begin_badly)
    with pytest.raises(SimulationDiverged):
        ShakenEpisode(world, PAPER).run(TrialSetup(ABOVE))


def test_a_scene_without_an_engine_keeps_its_format_and_one_with_it_has_its_own():
    spec = RunSpec(gripper="panda", object="rubiks_cube", protocol="physical")
    plain, other = (build_scene(msgspec.structs.replace(spec, engine=name)) for name in (None, "mujoco"))
    assert b"engine" not in pack_scene(plain).payload
    assert unpack_scene(pack_scene(plain).payload) == plain
    found = unpack_scene(pack_scene(other).payload)
    assert (found.engine, found.format) == ("mujoco", 4)
    assert pack_scene(found).digest != pack_scene(plain).digest
