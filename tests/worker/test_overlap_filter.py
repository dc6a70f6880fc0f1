"""The overlap filter: Bullet rejects all poses that it rejects; no result depends on it."""

import numpy as np
import pytest
from tests.worker.genomes import decoded, draw

from qdgrasp_assets.genes import layout
from qdgrasp_worker.candidate_ranking import OverlapFilter
from qdgrasp_worker.engines.bullet_world import BulletShakenWorld
from qdgrasp_worker.episode import ShakenEpisode
from qdgrasp_worker.evaluation_protocols import PROTOCOLS, TrialSetup
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
