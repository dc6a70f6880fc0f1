"""Poses that are not simulated: hands that surely overlap, and that cannot come to their pose."""

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.worker.genomes import decoded, draw, evaluated, outcomes, results
from tests.worker.test_physical_episode import ABOVE, SIDE, physical

from qdgrasp_assets.genes import layout
from qdgrasp_assets.geometry.mesh import Mesh, box, parts_to_obj
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import GIVEN, Outcome
from qdgrasp_worker.engines.bullet_world import BulletShakenWorld
from qdgrasp_worker.episode import ShakenEpisode
from qdgrasp_worker.evaluation_protocols import PROTOCOLS, TrialSetup
from qdgrasp_worker.pose_filters import ObjectSolid, OverlapFilter

OVERLAPPING = [("panda", "mug", "paper"), ("barrett", "rubiks_cube", "paper"), ("allegro", "mug", "released")]


@pytest.mark.parametrize("scene", OVERLAPPING, ids="-".join)
def test_what_the_filter_rejects_overlaps_in_bullet_and_it_finds_most(scene, make_scene):
    scene, places = make_scene(*scene), np.arange(1200)
    protocol = PROTOCOLS[scene.protocol]
    overlap = OverlapFilter(scene.gripper, ObjectSolid(scene), follows_free_joints=protocol.free_joints_first)
    episode = ShakenEpisode(BulletShakenWorld(scene), protocol)
    for prior in ("contact", "approach"):
        grasps = decoded(scene, prior, draw(len(places), len(layout(scene, prior)), seed=1))
        rejected = np.isin(places, overlap(grasps, places))
        overlapping = np.array([episode.overlaps(TrialSetup(grasps[i])) for i in places])
        assert not (rejected & ~overlapping).any()
        assert overlapping.sum() > 100
        assert rejected.sum() > overlapping.sum() / 2


ENGINES = [None, "mujoco"]


def genome(turn: Rotation) -> np.ndarray:
    """The hand above the cube as a genome of the prior given, turned about the centre of mass."""
    position = turn.apply(ABOVE.position)
    quaternion = (turn * Rotation.from_quat(ABOVE.quaternion)).as_quat()
    return np.array([[*position, *quaternion]], dtype=np.float32)


UNDER = genome(Rotation.from_rotvec(np.pi * np.array([np.cos(SIDE), np.sin(SIDE), 0.0])))
ABOVE_IT = genome(Rotation.identity())


def found(scene: Scene, genomes: np.ndarray, **more: bool) -> list[Outcome]:
    return outcomes(evaluated(scene, GIVEN, genomes, **more))


@pytest.mark.parametrize("engine", ENGINES)
def test_a_cube_on_a_table_is_grasped_from_above_and_not_from_below(engine):
    genomes = np.concatenate([ABOVE_IT, UNDER])
    assert found(physical(engine), genomes) == [Outcome.HELD, Outcome.HELD]
    assert found(physical(engine, resting_pose=0), genomes) == [Outcome.HELD, Outcome.OVERLAP]
    assert found(physical(engine, resting_pose=5), genomes) == [Outcome.OVERLAP, Outcome.HELD]
    assert found(physical(engine, resting_pose="any"), genomes) == [Outcome.HELD, Outcome.HELD]


def with_parts(scene: Scene, *parts: Mesh) -> Scene:
    target = msgspec.structs.replace(scene.object, collision=parts_to_obj(parts))
    return msgspec.structs.replace(scene, object=target)


def bar(height: float) -> Mesh:
    """A bar along x, as that of a handle."""
    return box((0.3, 0.01, 0.01)).moved((0.0, 0.0, height))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("is_neighbour", [True, False])
def test_a_hand_that_would_have_to_come_through_a_bar_is_refused(engine, is_neighbour):
    def with_bar(height: float, **more: float) -> Scene:
        scene = physical(engine, **more)
        if is_neighbour:
            return msgspec.structs.replace(scene, neighbours=parts_to_obj([bar(height)]))
        return with_parts(scene, box((0.05, 0.05, 0.05)), bar(height))

    for shortcuts in (True, False):
        met = found(with_bar(0.19, approach_distance=0.1), ABOVE_IT, shortcuts=shortcuts)
        apart = found(with_bar(0.5, approach_distance=0.1), ABOVE_IT, shortcuts=shortcuts)
        assert met == [Outcome.OVERLAP]
        assert min(*apart, *found(with_bar(0.19), ABOVE_IT, shortcuts=shortcuts)) >= Outcome.DROPPED


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("neighbours", [(), (bar(0.15), box((0.05, 0.05, 0.1)).moved((0.15, 0.0, 0.0)))])
def test_what_is_blocked_changes_no_other_result_and_nothing_depends_on_order_or_shortcuts(
    engine, neighbours
):
    scene, genomes = physical(engine, approach_distance=0.15, resting_pose=0), draw(60, seed=5, near=60)
    scene = msgspec.structs.replace(scene, neighbours=parts_to_obj(neighbours) if neighbours else b"")
    rows = evaluated(scene, "approach", genomes, batch=16)
    plain = evaluated(scene, "approach", genomes, shortcuts=False)
    assert results(rows, "steps") == results(plain, "steps")
    assert results(rows[::-1]) == results(evaluated(scene, "approach", genomes[::-1], batch=7))
    free = evaluated(physical(engine), "approach", genomes)
    blocked = (rows["outcome"] == Outcome.OVERLAP) & (free["outcome"] != Outcome.OVERLAP)
    assert 0 < blocked.sum() < len(rows)
    assert results(rows[~blocked]) == results(free[~blocked])
