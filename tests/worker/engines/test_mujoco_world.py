"""MuJoCo's model of a scene beside Bullet's: masses, reach, links that meet, distances, forces."""

import xml.etree.ElementTree as ET
from contextlib import closing
from math import sin
from pathlib import Path

import msgspec
import numpy as np
import pytest
from tests.worker.test_physical_episode import ABOVE, HANDS

from qdgrasp_assets.grippers.hand_model import MimicJoint, coupling_error, couplings
from qdgrasp_assets.grippers.urdf import parse_robot
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import NO_SYNERGY
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.engines.mujoco_model import SceneModel, reach_of
from qdgrasp_worker.engines.mujoco_simulation import SimulationDiverged
from qdgrasp_worker.engines.mujoco_world import MujocoPhysicalWorld, MujocoShakenWorld
from qdgrasp_worker.episode import ShakenEpisode
from qdgrasp_worker.evaluation_protocols import PAPER, PHYSICAL, Physics, TrialSetup
from qdgrasp_worker.physical_episode import PhysicalEpisode

PHYSICS = PHYSICAL.physics or Physics()
LEFT, RIGHT = "panda_finger_joint1", "panda_finger_joint2"
PRELOAD = 35.0
"""Force of each finger of the Panda [N]."""


@pytest.fixture(scope="module")
def scene(make_scene) -> Scene:
    return make_scene("panda", "rubiks_cube", "physical")


@pytest.fixture(scope="module")
def world(scene) -> MujocoPhysicalWorld:
    return MujocoPhysicalWorld(scene, PHYSICS)


@pytest.fixture(params=HANDS)
def hand_scene(request, make_scene) -> Scene:
    return make_scene(request.param, "mug", "physical")


URDF_OF_A_LINKAGE = """<robot name="hand"><link name="palm"/><link name="one"/><link name="two"/>
<joint name="a" type="revolute"><parent link="palm"/><child link="one"/><axis xyz="0 0 1"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint>
<joint name="b" type="revolute"><parent link="one"/><child link="two"/><axis xyz="0 0 1"/>
<limit lower="0" upper="2" effort="1" velocity="1"/><mimic joint="a" multiplier="2" offset="0.1"/></joint>
</robot>"""


def test_masses_moments_and_the_reach_of_joints_are_those_of_bullet(hand_scene):
    from qdgrasp_worker.engines import bullet_world

    class UndrivenWorld(bullet_world.BulletPhysicalWorld):
        """A world of Bullet whose links have their own inertia alone."""

        def _add_inertia(self, index: int, inertia: float, *, slides: bool) -> None:
            pass

    model = SceneModel(hand_scene, PHYSICS.time_step)
    with closing(UndrivenWorld(hand_scene, PHYSICS)) as world:
        for index, link in enumerate(world._hand.links):
            mass, moments = world._hand.inertia(index)
            assert model.links[link].mass == pytest.approx(mass)
            assert model.links[link].moments == pytest.approx(moments, rel=2e-3, abs=1e-12)
        assert model.moments == pytest.approx(world._target.inertia()[1], rel=1e-4)
        opened = {joint.name: joint.opened for joint in hand_scene.gripper.joints}
        world._place_away(world.opened)
        for index, joint in zip(world._hand.fingers, model.joints, strict=True):
            expected = bullet_world.reach_of(world._bullet, world._hand, index)
            assert reach_of(model.robot, model.links, opened, joint) == pytest.approx(expected, abs=2e-3)


def test_a_jaw_grips_with_its_preload_and_both_fingers_go_the_same_way(world):
    aside = HandPose([0.008 * sin(0.5), 0.0, 0.1], ABOVE.quaternion, ABOVE.joints, NO_SYNERGY)
    for pose in (ABOVE, aside):
        verdict = PhysicalEpisode(world, PHYSICAL).run(TrialSetup(pose))
        by_link = [sum(each.force for each in verdict.contacts if each.link == link) for link in (2, 3)]
        assert by_link == pytest.approx([PRELOAD, PRELOAD], rel=0.05)
        assert verdict.joints[0] == pytest.approx(verdict.joints[1], abs=1e-4)
    assert np.linalg.norm([each.normal for each in verdict.contacts], axis=1) == pytest.approx(1.0)


def test_joints_are_coupled_where_the_urdf_says_that_they_mimic(scene):
    robot = parse_robot(Path(), ET.fromstring(URDF_OF_A_LINKAGE))  # noqa: S314  # written above
    one, two = (
        msgspec.structs.replace(scene.gripper.joints[0], name=name, opened=0.0, closed=closed)
        for name, closed in (("a", 0.5), ("b", 1.1))
    )
    hand = msgspec.structs.replace(scene.gripper, joints=(one, two), jaw=None)
    assert couplings(robot, hand) == {"b": MimicJoint("a", 2.0, 0.1)}
    free = msgspec.structs.replace(hand, joints=(one, msgspec.structs.replace(two, driven=False)))
    assert couplings(robot, free) == {}
    hand = msgspec.structs.replace(hand, urdf=URDF_OF_A_LINKAGE.encode())
    postures = np.array([[0.2, 0.5], [0.3, 0.68]], np.float32)  # b is to be at 0.5, and at 0.7
    assert coupling_error(hand, postures) == pytest.approx(0.02, abs=1e-6)
    assert coupling_error(hand, postures[:0]) == 0.0


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
