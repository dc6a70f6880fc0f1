"""The overlap filter: Bullet rejects all poses that it rejects; no result depends on it."""

from dataclasses import replace

import numpy as np
import pytest
from tests.worker.genomes import HANDS, REFERENCE, decoded, draw, evaluated, results

from qdgrasp_assets.genes import layout
from qdgrasp_assets.geometry.voxels import convex_hulls
from qdgrasp_worker.engines.bullet_world import BulletShakenWorld
from qdgrasp_worker.episode import ShakenEpisode
from qdgrasp_worker.evaluation_protocols import PROTOCOLS, TrialSetup
from qdgrasp_worker.filters.overlap_filter import OverlapFilter
from qdgrasp_worker.object_geometry import ObjectSolid

SCENES = [("panda", "mug", "paper"), ("barrett", "rubiks_cube", "paper"), ("allegro", "mug", "released")]


def tools(scene, prior, n, seed):
    """The grasps of n random genomes, the filter, and an episode in a world of its own."""
    protocol = PROTOCOLS[scene.protocol]
    grasps = decoded(scene, prior, draw(n, len(layout(scene, prior)), seed))
    overlap = OverlapFilter(scene.gripper, ObjectSolid(scene), follows_free_joints=protocol.free_joints_first)
    return grasps, overlap, ShakenEpisode(BulletShakenWorld(scene), protocol)


def compare(scene, prior, n, seed):
    """The random poses that Bullet rejects, and that the filter rejects: (n,) each."""
    grasps, overlap, episode = tools(scene, prior, n, seed)
    rejected = np.isin(np.arange(n), overlap(grasps, np.arange(n)))
    overlapping = np.array([episode.overlaps(TrialSetup(grasps[i])) for i in range(n)])
    episode.world.close()
    return overlapping, rejected


@pytest.mark.parametrize("scene", SCENES, ids="-".join)
def test_what_the_filter_rejects_overlaps_in_bullet_and_it_finds_most(scene, make_scene):
    for prior in ("contact", "approach"):
        overlapping, rejected = compare(make_scene(*scene), prior, 1200, seed=1)
        assert not (rejected & ~overlapping).any()
        assert overlapping.sum() > 100
        assert rejected.sum() > overlapping.sum() / 2


@pytest.mark.parametrize("scene", SCENES, ids="-".join)
def test_hands_that_are_drawn_out_until_the_filter_hardly_rejects_them_overlap_in_bullet(scene, make_scene):
    grasps, overlap, episode = tools(make_scene(*scene), "approach", 1500, seed=3)
    places = overlap(grasps, np.arange(len(grasps)))
    outward = grasps.positions - grasps.surface_points
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    inside, outside = np.zeros(len(grasps), np.float32), np.full(len(grasps), 0.2, np.float32)
    for _ in range(12):  # to 50 um
        middle = (inside + outside) / 2
        drawn = replace(grasps, positions=grasps.positions + middle[:, None] * outward)
        is_rejected = np.isin(np.arange(len(grasps)), overlap(drawn, places))
        inside, outside = np.where(is_rejected, middle, inside), np.where(is_rejected, outside, middle)
    drawn = replace(grasps, positions=grasps.positions + inside[:, None] * outward)
    assert len(places) > 100
    assert np.median(inside[places]) > 0.003
    assert all(episode.overlaps(TrialSetup(drawn[i])) for i in places)
    episode.world.close()


@pytest.mark.slow
@pytest.mark.parametrize("target", ["rubiks_cube", "mug", "power_drill"])
@pytest.mark.parametrize("hand", [*HANDS, *REFERENCE])
def test_no_pose_of_thousands_is_rejected_falsely(hand, target, named_scene):
    overlapping, rejected = compare(named_scene(hand, target), "approach", 7000, seed=2)
    assert not (rejected & ~overlapping).any()


@pytest.mark.parametrize(
    ("prior", "n"), [("contact", 400), ("antipodal", 100), ("aimed", 100), ("valued", 100)]
)
def test_rows_are_the_same_without_the_filter(prior, n, make_scene):
    scene = make_scene("panda", "mug", "robust")
    case = scene, prior, draw(n, len(layout(scene, prior)), seed=3), np.arange(n) % 3
    assert results(evaluated(*case)) == results(evaluated(*case, shortcuts=False))


@pytest.mark.parametrize("target", ["mug", "power_drill"])
def test_a_voxel_inside_the_object_is_wholly_inside_one_of_its_parts(target, make_scene):
    solid = ObjectSolid(make_scene("panda", target, "paper"))
    voxels = solid.inside
    grid = np.argwhere(voxels.levels)[::17]
    corners = np.indices((2, 2, 2)).reshape(3, -1).T
    points = voxels._low + (grid[:, None] + corners) * voxels.pitch
    flat = points.reshape(-1, 3)
    within = np.any([hull.contains(flat).reshape(-1, 8).all(axis=1) for hull in solid.hulls], axis=0)
    assert len(grid) > 500
    assert within.all()


def test_the_points_of_an_object_fill_its_inside_evenly(make_scene):
    scene = make_scene("panda", "rubiks_cube", "paper")
    points = ObjectSolid(scene).points
    assert points.shape == (512, 3)
    [cube] = convex_hulls([scene.surface_points.astype(np.float64)])
    assert cube.grown(1e-3).contains(points).all()
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=0.004)
    np.testing.assert_allclose(points[:, 2].std(), 0.057 / 12**0.5, rtol=0.1)
