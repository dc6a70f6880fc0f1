"""Convex hulls, and the voxels that are marked with them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from qdgrasp_assets.geometry.voxels import VoxelGrid, convex_hulls

CUBE = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.02


@pytest.fixture(params=range(6))
def hull(request):
    return convex_hulls([np.random.default_rng(request.param).normal(0.0, 0.01, (12, 3))])[0]


def centres(voxels):
    """The centres (n, 3) of all voxels in the order of their levels."""
    grid = np.indices(voxels.levels.shape).reshape(3, -1).T
    return voxels._low + (grid + 0.5) * voxels.pitch


def contains(hull, points):
    """(n,): True for the points (n, 3) [m] that are inside a hull."""
    return np.all(points @ hull.normals.T + hull.planes[:, 3] <= 0.0, axis=1)


def test_a_moved_hull_contains_the_moved_points(hull):
    frame = np.eye(4)
    frame[:3, :3] = Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix()
    frame[:3, 3] = 0.1, -0.2, 0.3
    points = np.random.default_rng(11).normal(0.0, 0.01, (500, 3))
    there = points @ frame[:3, :3].T + frame[:3, 3]
    np.testing.assert_array_equal(contains(hull.moved(frame), there), contains(hull, points))


def test_the_voxels_marked_are_those_whose_centre_is_inside(hull):
    voxels = VoxelGrid(hull.low, hull.high, 0.0013)
    voxels.mark(hull, 1)
    inside = contains(hull, centres(voxels))
    assert inside.sum() > 50
    np.testing.assert_array_equal(voxels.levels.reshape(-1), inside)


def test_points_find_the_level_of_their_voxel_and_zero_outside():
    [cube] = convex_hulls([CUBE])
    voxels = VoxelGrid(cube.low, cube.high, 0.001)
    voxels.mark(cube, 3)
    points = np.random.default_rng(2).uniform(-0.05, 0.05, (4000, 3)).astype(np.float32)
    points[0] = 1e30, -1e30, 0.0
    np.testing.assert_array_equal(voxels.at(*points.T), 3 * (np.abs(points) < 0.02).all(axis=1))
