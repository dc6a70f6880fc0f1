"""The reach: a pose at which the hand surely misses misses in Bullet, and no result depends on it."""

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from qdgrasp_assets.genes import layout
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_worker.decode import Decoder
from qdgrasp_worker.episode import Episode
from qdgrasp_worker.grasp import Pose
from qdgrasp_worker.protocols import PROTOCOLS
from qdgrasp_worker.reach import Reach, between
from qdgrasp_worker.skeleton import Skeleton
from qdgrasp_worker.solid import Solid
from qdgrasp_worker.surface import Surface
from qdgrasp_worker.trial import Trial
from qdgrasp_worker.world import World
from qdgrasp_worker.zone import MOST

SCENES = [("panda", "mug", "paper"), ("barrett", "rubiks_cube", "released"), ("allegro", "mug", "paper")]
HANDS = ["panda", "barrett", "allegro", "shadow", "robotiq_2f"]
REFERENCE = [f"ref_{name}" for name in ("panda_2f", "bh280", "allegro", "shadow", "robotiq_2f")]


def reach_of(scene, world):
    follows = PROTOCOLS[scene.protocol].free_joints_first
    return Reach(scene.gripper, Solid(scene), world.closing, follows_free_joints=follows)


def drawn_off(scene, n, seed):
    """Poses that look at the object from farther and farther away, until no hand reaches it."""
    random = np.random.default_rng(seed)
    genomes = random.uniform(-1.0, 1.0, (n, len(layout(scene, "approach")))).astype(np.float32)
    grasps = Decoder(scene, "approach", Surface(scene))(genomes)
    for i, pose in enumerate(grasps[i] for i in range(n)):
        outward = np.array(pose.position) - grasps.surface_points[i]
        outward /= np.linalg.norm(outward) + 1e-9
        position = np.array(pose.position) + random.uniform(0.0, 0.12) * outward
        yield Pose(position.astype(np.float32).tolist(), pose.quaternion, pose.joints, pose.synergy)


def judged(scene, n, seed):
    """What the reach says of poses, and how they end in Bullet without it: (n,) each."""
    world = World(scene)
    reach, episode = reach_of(scene, world), Episode(world, PROTOCOLS[scene.protocol], stops_early=False)
    poses = list(drawn_off(scene, n, seed))
    misses = np.array([reach.misses(pose) for pose in poses])
    outcomes = np.array(
        [fate(episode, pose) if missed else -1 for pose, missed in zip(poses, misses, strict=True)]
    )
    world.close()
    return misses, outcomes


def fate(episode, pose):
    """How a pose ends; a contact with the palm counts as a touch."""
    outcome = episode.run(Trial(pose)).outcome
    return Outcome.BRUSHED if outcome == Outcome.MISSED and episode.world.contacts() else outcome


@pytest.mark.parametrize("scene", SCENES, ids="-".join)
def test_where_it_says_so_the_hand_misses_in_bullet(scene, make_scene):
    misses, outcomes = judged(make_scene(*scene), 500, seed=1)
    assert misses.sum() > 50
    assert set(outcomes[misses]) <= {Outcome.MISSED}


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("target", ["rubiks_cube", "mug", "power_drill"])
@pytest.mark.parametrize("hand", HANDS)
def test_no_pose_of_thousands_is_said_to_miss_falsely(hand, target, make_scene):
    misses, outcomes = judged(make_scene(hand, target, "paper"), 3000, seed=2)
    assert set(outcomes[misses]) <= {Outcome.MISSED}


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("target", ["ycb_rubiks_cube", "ycb_mug", "ycb_power_drill"])
@pytest.mark.parametrize("hand", REFERENCE)
def test_no_pose_of_thousands_is_said_to_miss_falsely_by_reference_hands(
    hand, target, make_scene, asset_path
):
    misses, outcomes = judged(make_scene(hand, target, "released"), 3000, seed=2)
    assert set(outcomes[misses]) <= {Outcome.MISSED}


@pytest.mark.parametrize("hand", HANDS)
def test_all_that_passes_by_is_in_its_zones_wherever_free_joints_stand(hand, make_scene):
    scene = make_scene(hand, "mug", "paper")
    world, skeleton, random = World(scene), Skeleton(scene.gripper), np.random.default_rng(3)
    reach = reach_of(scene, world)
    assert reach.is_known
    labels = range(len(scene.gripper.synergies)) if scene.gripper.synergies else [-1]
    for synergy in labels:
        posture = reach._posture(random.random())
        frames = skeleton.frames(np.array(world.closing(posture, synergy))[::7])
        reach._zones[synergy] = reach._measure(synergy)
        pose = Pose([0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], posture, synergy)
        placed = [(zone, frame) for zone, frame in reach._placed(pose)]
        for link, hulls in skeleton.hulls.items():
            for hull in hulls:
                corners = hull.triangles.reshape(-1, 3)
                points = corners @ np.moveaxis(frames[link][:, :3, :3], 1, 2) + frames[link][:, None, :3, 3]
                nearest = np.min([away(zone, frame, points.reshape(-1, 3)) for zone, frame in placed], axis=0)
                assert not nearest.any()
    world.close()


def away(zone, frame, points):
    turn = frame[:3, :3].T
    return zone.at(
        points.astype(np.float32), turn.astype(np.float32), (-turn @ frame[:3, 3]).astype(np.float32)
    )


@pytest.mark.parametrize("most", [MOST, 30_000])
def test_distances_are_never_too_large_and_voxels_not_too_many(most, cube, monkeypatch):
    monkeypatch.setattr("qdgrasp_worker.zone.MOST", most)
    world = World(cube)
    reach, skeleton = reach_of(cube, world), Skeleton(cube.gripper)
    [zone] = reach._measure(-1).values()
    frames = skeleton.frames(between(np.array(world.closing(world.opened, -1))))
    swept = np.concatenate(
        [
            (
                hull.triangles.reshape(-1, 3) @ np.moveaxis(frames[link][::9, :3, :3], 1, 2)
                + frames[link][::9, None, :3, 3]
            ).reshape(-1, 3)
            for link, hulls in skeleton.hulls.items()
            for hull in hulls
        ]
    )[::5]
    points = np.random.default_rng(0).uniform(-0.2, 0.25, (300, 3))
    distances = np.linalg.norm(points[:, None] - swept[None], axis=2).min(axis=1)
    found = away(zone, np.eye(4), points) * 2e-4
    assert (found <= distances).all()
    assert found.max() > 0.015
    assert zone.distances.levels.size < 1.3 * most
    world.close()


def test_nothing_is_known_of_a_hand_with_a_shape_that_is_not_understood(cube):
    urdf = cube.gripper.urdf.replace("<collision>", '<collision concave="yes">', 1)
    gripper = msgspec.structs.replace(cube.gripper, urdf=urdf)
    reach = Reach(gripper, Solid(cube), lambda *_: [], follows_free_joints=True)
    turn = Rotation.identity().as_quat().tolist()
    assert urdf != cube.gripper.urdf
    assert not reach.is_known
    assert not reach.misses(Pose([0.0, 0.0, 3.0], turn, [0.04, 0.04], -1))
