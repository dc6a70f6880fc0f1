"""The contact filter, and the box that an object leaves for good."""

import msgspec
import numpy as np
import pytest
from tests.worker.genomes import decoded

from qdgrasp_assets.genes import layout
from qdgrasp_protocol.rows import NO_SYNERGY, Outcome
from qdgrasp_worker.contact_filter import BoundingBalls, ContactFilter, coarseness
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.engines.bullet_world import BulletShakenWorld
from qdgrasp_worker.episode import ShakenEpisode
from qdgrasp_worker.evaluation_protocols import PROTOCOLS, TrialSetup
from qdgrasp_worker.pose_filters import ObjectSolid


def assert_covers(cover, solid):
    """All of the surface is in balls of either kind, and each large ball holds its small ones."""
    random = np.random.default_rng(0)
    triangles = np.concatenate([hull.surface.corners for hull in solid.hulls])
    some = triangles[random.integers(len(triangles), size=400)]
    points = (random.dirichlet((1.0, 1.0, 1.0), len(some))[:, :, None] * some).sum(axis=1)
    for balls in (cover.large, cover.small):
        for point in points:
            assert (balls.radii - np.linalg.norm(point - balls.centres, axis=1)).max() > -1e-9
    assert cover.counts.sum() == len(cover.small.centres)
    around = np.repeat(np.arange(len(cover.counts)), cover.counts)
    apart = np.linalg.norm(cover.large.centres[around] - cover.small.centres, axis=1)
    assert (apart + cover.small.radii <= cover.large.radii[around] + 1e-9).all()


@pytest.mark.parametrize("target", ["rubiks_cube", "mug", "bowl", "spatula"])
def test_the_cover_of_an_object_for_a_hand_is_fine_and_holds_the_whole_surface(target, make_scene):
    solid = ObjectSolid(make_scene("panda", target, "paper"))
    cover = BoundingBalls.of(solid)
    assert coarseness(solid) == 1.0
    assert cover.small.radii.max() < 5e-3
    assert_covers(cover, solid)


SCENES = [("panda", "mug", "paper"), ("barrett", "rubiks_cube", "released"), ("allegro", "mug", "paper")]


def drawn_off(scene, n, seed):
    """Poses that look at the object from farther and farther away, until no hand reaches it."""
    random = np.random.default_rng(seed)
    genomes = random.uniform(-1.0, 1.0, (n, len(layout(scene, "approach")))).astype(np.float32)
    grasps = decoded(scene, "approach", genomes)
    for i, pose in enumerate(grasps):
        outward = np.array(pose.position) - grasps.surface_points[i]
        outward /= np.linalg.norm(outward) + 1e-9
        position = np.array(pose.position) + random.uniform(0.0, 0.12) * outward
        yield HandPose(position.astype(np.float32).tolist(), pose.quaternion, pose.joints, pose.synergy)


def judged(scene, n, seed):
    """The filter's verdicts on poses, and their outcomes in Bullet without it: (n,) each."""
    world, protocol = BulletShakenWorld(scene), PROTOCOLS[scene.protocol]
    follows, episode = protocol.free_joints_first, ShakenEpisode(world, protocol)
    reach = ContactFilter(scene.gripper, ObjectSolid(scene), world.closing, follows_free_joints=follows)
    poses = list(drawn_off(scene, n, seed))
    misses = np.array([reach.misses(pose) for pose in poses])
    outcomes = np.array(
        [fate(episode, pose) if missed else -1 for pose, missed in zip(poses, misses, strict=True)]
    )
    world.close()
    return misses, outcomes


def fate(episode, pose):
    """The outcome of a pose; a contact with the palm counts as a touch."""
    outcome = episode.run(TrialSetup(pose)).outcome
    return Outcome.BRUSHED if outcome == Outcome.MISSED and episode.world.contacts() else outcome


@pytest.mark.parametrize("scene", SCENES, ids="-".join)
def test_where_it_says_so_the_hand_misses_in_bullet(scene, make_scene):
    misses, outcomes = judged(make_scene(*scene), 500, seed=1)
    assert misses.sum() > 50
    assert set(outcomes[misses]) <= {Outcome.MISSED}


def test_nothing_is_known_of_a_hand_with_a_shape_that_is_not_understood(cube):
    urdf = cube.gripper.urdf.replace("<collision>", '<collision concave="yes">', 1)
    gripper = msgspec.structs.replace(cube.gripper, urdf=urdf)
    reach = ContactFilter(gripper, ObjectSolid(cube), lambda *_: [], follows_free_joints=True)
    assert urdf != cube.gripper.urdf
    assert not reach.is_known
    assert not reach.misses(HandPose([0.0, 0.0, 3.0], [0.0, 0.0, 0.0, 1.0], [], NO_SYNERGY))
