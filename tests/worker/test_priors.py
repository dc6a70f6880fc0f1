"""Laws of the priors antipodal (Huber et al. 2024, eq. 3-4), spherical, and valued with its candidates."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from tests.common import with_gripper
from tests.worker.genomes import CANDIDATES, decoded, draw, encoded, evaluated, facing

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
    kept = {name: column[~found.dead_ends] for name, column in vars(found).items() if name != "prior"}
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
    assert set(rows["proposals"]) == {1}
    assert not rows["descriptor"].any()
    assert not rows["base_to_object"].any()
    assert rows["surface_point"].any(axis=1).all()


N, K = 40, 32


def decode(scene, values):
    return decoded(scene, "valued", encoded(scene, values))


@pytest.fixture(scope="module")
def values(cube):
    return facing(cube, N, candidates=K)


@pytest.fixture(scope="module")
def grasps(cube, values):
    return decode(cube, values)


@pytest.fixture(scope="module")
def poses(grasps):
    """The places of those that are poses."""
    return np.flatnonzero(~grasps.dead_ends)


def test_a_genome_has_as_many_candidates_as_it_asks_for(cube, values) -> None:
    some = values[:5].copy()
    some[:, CANDIDATES] = 1, 2.4, 7.6, 31, 32
    grasps = decode(cube, some)
    assert np.bincount(grasps.genome_of).tolist() == [1, 2, 8, 31, 32]
    assert (np.diff(grasps.genome_of) >= 0).all()


def test_hands_stand_anywhere_in_the_cell_of_the_target_and_nowhere_else(values, grasps, poses) -> None:
    offsets = grasps.positions[poses] * 100.0 - np.rint(values[grasps.genome_of[poses], :3] * 100.0)
    assert np.abs(offsets).max() <= 0.5 + 1e-4
    np.testing.assert_allclose(offsets.std(axis=0), 1 / 12**0.5, rtol=0.1)


def test_contact_points_are_surface_points_beside_the_hint(cube, values, grasps, poses) -> None:
    distances, _ = KDTree(cube.surface_points).query(grasps.surface_points[poses])
    assert distances.max() == 0.0
    apart = np.linalg.norm(grasps.surface_points[poses] - values[grasps.genome_of[poses], 3:6], axis=1)
    assert 0.005 < np.sqrt((apart**2).mean()) < 0.015


def test_candidates_depend_on_the_bytes_of_their_genome_alone(cube, values, grasps) -> None:
    genomes = encoded(cube, values)
    alone = decoded(cube, "valued", genomes[7:8])
    mine = grasps.genome_of == 7
    np.testing.assert_array_equal(alone.positions, grasps.positions[mine])
    np.testing.assert_array_equal(alone.quaternions, grasps.quaternions[mine])
    other = genomes[7:8].copy()
    other[0, -1] = np.nextafter(other[0, -1], np.float32(1.0))  # the value wanted
    changed = decoded(cube, "valued", other)
    assert not (changed.positions == alone.positions).all(axis=1).any()


def test_a_target_out_of_reach_has_dead_ends_only(cube, values) -> None:
    far = values[:3].copy()
    far[:, :3] = np.array(cube.object_high) + cube.gripper.reach
    far[:, 3:6] = cube.object_low
    grasps = decode(cube, far)
    assert grasps.dead_ends.all()
    assert not grasps.positions.any()
