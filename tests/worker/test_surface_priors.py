"""Laws of the antipodal prior (Huber et al. 2024, section III-A, eq. 3-4)."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from tests.common import with_gripper
from tests.worker.genomes import decoded, draw, evaluated

from qdgrasp_assets.scene import Jaw
from qdgrasp_protocol.errors import JawNeeded
from qdgrasp_protocol.rows import Outcome

NU_T = np.pi / 6
NARROW = Jaw(axis=(0.0, 1.0, 0.0), opening=0.05)


def decode(scene, genomes):
    return decoded(scene, "antipodal", genomes)


def normals_at(scene, points):
    return scene.surface_normals[KDTree(scene.surface_points).query(points)[1]].astype(np.float64)


def middles(scene, grasps):
    """The places of the fingertips, and the axis along which they close."""
    turn = Rotation.from_quat(grasps.quaternions)
    hand = scene.gripper
    return grasps.positions + turn.apply(np.array(hand.approach_axis) * hand.reach), turn.apply(hand.jaw.axis)


@pytest.fixture(scope="module", params=["rubiks_cube", "mug", "tennis_ball"])
def scene(request, make_scene):
    return make_scene("panda", request.param, "paper")


@pytest.fixture(scope="module")
def grasps(scene):
    found = decode(scene, draw(600, 4))
    kept = {name: column[~found.dead_ends] for name, column in vars(found).items() if name != "prior"}
    return replace(found, **kept)


def test_the_fingers_close_along_the_normal_of_the_first_point(scene, grasps):
    _, axes = middles(scene, grasps)
    np.testing.assert_allclose(axes, -normals_at(scene, grasps.surface_points), atol=2e-6)


def test_the_fingertips_stand_in_the_middle_of_two_points_of_the_surface(scene, grasps):
    centres, axes = middles(scene, grasps)
    halves = ((centres - grasps.surface_points) * axes).sum(axis=1)
    assert (halves > 0).all()
    assert (2 * halves <= scene.gripper.jaw.opening + 1e-6).all()
    np.testing.assert_allclose(centres - halves[:, None] * axes, grasps.surface_points, atol=1e-6)
    opposite = centres + halves[:, None] * axes
    assert max(heights(*surface(scene), point).min() for point in opposite[:100]) < 1e-6


def test_both_normals_are_within_nu_t_of_the_fingers_axis(scene, grasps):
    centres, axes = middles(scene, grasps)
    halves = ((centres - grasps.surface_points) * axes).sum(axis=1)
    triangles, normals = surface(scene)
    for opposite, axis in zip((centres + halves[:, None] * axes)[:100], axes[:100], strict=True):
        on = heights(triangles, normals, opposite) < 1e-6
        angles = np.arccos(np.clip(normals[on] @ axis, -1, 1))
        assert angles.min() <= NU_T + 1e-5


def heights(triangles, normals, point):
    """(t,): how far a point is from each triangle's plane, infinite beyond its edges."""
    height = np.abs(((point - triangles[:, 0]) * normals).sum(axis=1))
    inside = np.ones(len(triangles), dtype=bool)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        inward = np.cross(normals, triangles[:, b] - triangles[:, a])
        inward /= np.linalg.norm(inward, axis=1, keepdims=True)
        inside &= ((point - triangles[:, a]) * inward).sum(axis=1) > -1e-6
    return np.where(inside, height, np.inf)


def surface(scene):
    """The triangles (t, 3, 3) of a scene's object, and their normals (t, 3)."""
    triangles = scene.object.triangles.astype(np.float64)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return triangles, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def test_what_is_wider_than_the_opening_is_a_dead_end_and_is_not_simulated(cube):
    rows = evaluated(with_gripper(cube, jaw=NARROW), "antipodal", draw(100, 4))
    assert set(rows["outcome"]) == {Outcome.DEAD_END}
    assert set(rows["proposals"]) == {1}
    assert not rows["descriptor"].any()
    assert not rows["base_to_object"].any()
    assert rows["surface_point"].any(axis=1).all()


def test_a_hand_without_a_jaw_is_refused(cube):
    with pytest.raises(JawNeeded, match=r"'antipodal' is for two-finger hands.*'panda'.*qdgrasp methods"):
        decode(with_gripper(cube, jaw=None), draw(1, 4))
