"""Laws of the prior antipodal (Huber et al. 2024, eq. 3-4)."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from tests.common import with_gripper
from tests.worker.genomes import decoded, draw, evaluated

from qdgrasp_assets.scene import Jaw
from qdgrasp_protocol.rows import Outcome

NARROW = Jaw(axis=(0.0, 1.0, 0.0), opening=0.05)


def normals_at(scene, points):
    return scene.surface_normals[KDTree(scene.surface_points).query(points)[1]].astype(np.float64)


def middles(scene, grasps):
    """The places of the fingertips, and the axis along which they close."""
    turn = Rotation.from_quat(grasps.quaternions)
    hand = scene.gripper
    return grasps.positions + turn.apply(np.array(hand.approach_axis) * hand.reach), turn.apply(hand.jaw.axis)


@pytest.fixture(scope="module")
def pairs(cube):
    """The poses of the prior antipodal that are no dead ends."""
    found = decoded(cube, "antipodal", draw(600, 4))
    kept = {name: column[~found.dead_ends] for name, column in vars(found).items()}
    return replace(found, **kept)


def test_the_fingers_close_along_the_normal_of_the_first_point(cube, pairs):
    _, axes = middles(cube, pairs)
    np.testing.assert_allclose(axes, -normals_at(cube, pairs.surface_points), atol=2e-6)


def test_the_fingertips_stand_before_the_first_point_within_the_opening(cube, pairs):
    centres, axes = middles(cube, pairs)
    halves = ((centres - pairs.surface_points) * axes).sum(axis=1)
    assert (halves > 0).all()
    assert (2 * halves <= cube.gripper.jaw.opening + 1e-6).all()
    np.testing.assert_allclose(centres - halves[:, None] * axes, pairs.surface_points, atol=1e-6)


def test_what_is_wider_than_the_opening_is_a_dead_end_and_is_not_simulated(cube):
    rows = evaluated(with_gripper(cube, jaw=NARROW), "antipodal", draw(100, 4))
    assert set(rows["outcome"]) == {Outcome.DEAD_END}
    assert not rows["steps"].any()
    assert not rows["descriptor"].any()
    assert not rows["base_to_object"].any()
    assert rows["surface_point"].any(axis=1).all()
