"""Rays at a mesh: how far it is, and how many times over a point is inside."""

import numpy as np
import pytest

from qdgrasp_assets.geometry.collision_parts import FingerClearance
from qdgrasp_assets.geometry.mesh import Mesh, box, hull, join
from qdgrasp_assets.geometry.proximity import inside_count, ray_distance
from qdgrasp_assets.geometry.surface_points import sample_surface

BLOCK = (0.02, 0.03, 0.05)
UP = np.array([[0.0, 0.0, 1.0]])


def inside(mesh: Mesh, *point: float) -> int:
    return int(inside_count(mesh, np.array([point]), UP)[0])


def test_a_point_is_inside_as_many_bodies_as_are_around_it():
    pair = join((box(BLOCK), box(BLOCK).moved((0.01, 0, 0.001))))
    assert [inside(pair, x, 0.001, 0.002) for x in (-0.02, -0.005, 0.005, 0.015, 0.03)] == [0, 1, 2, 1, 0]


@pytest.mark.parametrize("shift", [(0, 0, 0), (500, -300, 200)])
def test_a_mesh_may_lie_anywhere(shift):
    """Single precision has no tenth of a millimetre there."""
    mesh = box(BLOCK).moved(shift)
    points, drawn = sample_surface(mesh, 500, seed=0)
    normals = mesh.normals[drawn]
    assert not inside_count(mesh, points + 1e-5 * normals, normals).any()
    assert (inside_count(mesh, points - 1e-5 * normals, normals) == 1).all()
    across = ray_distance(mesh, np.mean(mesh.bounds, axis=0)[None], UP)
    assert across == pytest.approx([0.025], abs=1e-6)
    assert FingerClearance(mesh).fit((hull(mesh.vertices),)).is_good
