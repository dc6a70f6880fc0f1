"""Episodes of `physical` in each engine: grasps, joints, and independent episodes."""

from contextlib import closing
from dataclasses import replace
from math import cos, radians, sin

import numpy as np
import pytest
from tests.worker.genomes import draw, evaluated, results

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import GIVEN, NO_SYNERGY, Outcome
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.episode import APPROACH_STEP, EpisodeResult, approach_path
from qdgrasp_worker.evaluation_protocols import PHYSICAL, ROBUST_BY_BASE, TrialSetup
from qdgrasp_worker.evaluator import make_episode, make_world

SIDE = radians(27.0)  # The direction of one of the cube's sides
HALF_TURN = (SIDE + radians(90.0)) / 2
ABOVE = HandPose([0.0, 0.0, 0.1], [cos(HALF_TURN), sin(HALF_TURN), 0.0, 0.0], [0.04, 0.04], NO_SYNERGY)
"""The Panda over the cube, its fingers at two sides."""
HANDS = ("panda", "robotiq_2f", "allegro", "barrett", "shadow")


def physical(engine: str | None = None, friction: float | None = None, **more: str | float) -> Scene:
    values = {"gripper": "panda", "object": "rubiks_cube", "protocol": "physical", **more}
    return build_scene(RunSpec(**values, friction=friction, engine=engine))


@pytest.fixture(scope="module", params=[None, "mujoco"], ids=["bullet", "mujoco"])
def scene(request) -> Scene:
    return physical(request.param)


def judged(scene: Scene, pose: HandPose = ABOVE) -> EpisodeResult:
    with closing(make_world(scene, PHYSICAL)) as world:
        return make_episode(world, PHYSICAL).run(TrialSetup(pose))


def test_a_cube_between_the_fingers_of_a_panda_is_held_against_every_push(scene):
    verdict = judged(scene)
    assert (verdict.outcome, verdict.fitness, verdict.finger_links) == (Outcome.HELD, 6, 2)
    assert verdict.penetration < 1e-3
    assert verdict.joints[0] == pytest.approx(verdict.joints[1], abs=1e-3)


def test_a_slippery_cube_is_not(scene):
    assert judged(physical(scene.engine, friction=0.005)).outcome < Outcome.HELD


def test_a_jaw_centres_what_it_holds(scene):
    aside = HandPose([0.008 * cos(SIDE), 0.008 * sin(SIDE), 0.1], ABOVE.quaternion, ABOVE.joints, NO_SYNERGY)
    verdict = judged(scene, aside)
    assert verdict.outcome == Outcome.HELD
    assert verdict.joints[0] == pytest.approx(verdict.joints[1], abs=1e-3)


def test_a_harder_trial_grips_with_less_force_and_pushes_with_more(scene):
    with closing(make_world(scene, PHYSICAL)) as world:
        episode = make_episode(world, PHYSICAL)
        usual, weak = (episode.run(TrialSetup(ABOVE, preload=factor)) for factor in (1.0, 0.5))
        assert episode.run(TrialSetup(ABOVE, load=100.0)).outcome < Outcome.HELD
        assert episode.run(TrialSetup(ABOVE)) == usual
    forces = [sum(contact.force for contact in each.contacts) for each in (usual, weak)]
    assert forces[1] == pytest.approx(0.5 * forces[0], rel=0.1)


class TestRobustOnPhysical:
    def test_the_order_of_trials_changes_none_and_a_hand_that_was_stopped_settles_farther_out(self):
        robust = build_scene(
            RunSpec(gripper="panda", object="rubiks_cube", protocol="robust", base="physical")
        )
        near = np.array([[*ABOVE.position[:2], 0.096, *ABOVE.quaternion]], np.float32)
        trials = np.arange(13)
        genomes = np.repeat(near, len(trials), axis=0)
        rows = evaluated(robust, GIVEN, genomes, trials)
        assert results(evaluated(robust, GIVEN, genomes, trials[::-1], batch=4)[::-1]) == results(rows)
        assert rows["outcome"][0] == Outcome.HELD
        protocol = ROBUST_BY_BASE["physical"]
        trials_as_set = [protocol.trial(replace(ABOVE, position=near[0, :3].tolist()), i) for i in trials]
        with closing(make_world(robust, protocol)) as world:
            episode = make_episode(world, protocol)
            blocked = np.array([episode.overlaps(trial) for trial in trials_as_set])
        assert blocked.any()
        assert not blocked.all()
        assert (rows["outcome"] != Outcome.OVERLAP).all()
        np.testing.assert_array_equal(rows["base_to_object"], np.tile(near, (len(trials), 1)))
        goals = np.array([trial.pose.position[2] for trial in trials_as_set])
        back = rows["settled"][:, 2] - goals
        assert (back[blocked] > 1e-3).all()
        assert np.abs(back[~blocked]).max() < 1e-3


class TestApproach:
    """The Panda comes down on the cube, whose sides are 57 mm and whose top is 28.5 mm high."""

    def run(self, scene: Scene, pose: HandPose, *, approaches: bool = True) -> EpisodeResult:
        with closing(make_world(scene, PHYSICAL)) as world:
            return make_episode(world, PHYSICAL).run(TrialSetup(pose, approaches=approaches))

    def test_the_path_ends_at_the_pose_and_is_as_long_as_the_hands_reach(self, scene):
        path = approach_path(ABOVE, scene.gripper.approach_axis, scene.gripper.reach)
        assert path[-1] is ABOVE
        places = np.array([pose.position for pose in path])
        np.testing.assert_array_equal(places[:-1], places[:-1].astype(np.float32))
        np.testing.assert_allclose(places[:, :2], 0.0, atol=1e-8)
        np.testing.assert_allclose(np.diff(places[:, 2]), -APPROACH_STEP, atol=1e-7)
        assert places[0, 2] - places[-1, 2] == pytest.approx(scene.gripper.reach, abs=APPROACH_STEP)

    def test_a_hand_that_is_clear_all_along_closes_where_it_would_without_a_path(self, scene):
        assert self.run(scene, ABOVE) == self.run(scene, ABOVE, approaches=False)

    @pytest.mark.parametrize("depth", [0.0905, 0.085, 0.07])
    def test_a_hand_whose_goal_is_inside_stops_before_that_and_not_earlier(self, scene, depth):
        low = replace(ABOVE, position=[0.0, 0.0, depth])
        assert self.run(scene, low, approaches=False).outcome == Outcome.OVERLAP
        found = self.run(scene, low)
        assert found.outcome == Outcome.HELD
        path = approach_path(low, scene.gripper.approach_axis, scene.gripper.reach)
        (stop,) = [i for i, pose in enumerate(path) if abs(pose.position[2] - found.settled[2]) < 1e-4]
        with closing(make_world(scene, PHYSICAL)) as world:
            episode = make_episode(world, PHYSICAL)
            assert not any(episode.overlaps(TrialSetup(pose)) for pose in path[: stop + 1])
            assert episode.overlaps(TrialSetup(path[stop + 1]))

    def test_fingers_that_meet_the_object_from_above_do_not_pass_through_it(self, scene):
        aside = replace(ABOVE, position=[0.03 * cos(SIDE), 0.03 * sin(SIDE), 0.1])
        assert self.run(scene, aside, approaches=False).outcome == Outcome.OVERLAP
        assert self.run(scene, aside).outcome == Outcome.MISSED

    @pytest.mark.parametrize("depth", [-0.05, -0.11])
    def test_a_hand_that_would_come_through_the_object_overlaps(self, scene, depth):
        beyond = replace(ABOVE, position=[0.0, 0.0, depth])
        assert self.run(scene, beyond).outcome == Outcome.OVERLAP


@pytest.mark.parametrize("engine", [None, "mujoco"])
def test_a_grasp_touches_the_region_alone(engine):
    scene, genomes = physical(engine, object="mug", on=("handle",)), draw(48, 4)
    rows, backward = (evaluated(scene, "antipodal", each) for each in (genomes, genomes[::-1]))
    assert backward[::-1].tobytes() == rows.tobytes()
    is_contact = rows["contact_links"] > 0
    x = rows["contact_points"].reshape(*is_contact.shape, -1)[..., 0] + scene.object.com_in_mesh[0]
    nearest = np.where(is_contact, x, np.inf).min(axis=1)  # to where the handle begins
    held, outside = rows["outcome"] >= Outcome.DROPPED, rows["outcome"] == Outcome.BRUSHED
    assert nearest[held].min() > 0.0269
    assert nearest[outside].min() < 0.026
