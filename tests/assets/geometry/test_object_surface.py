"""Exits of rays from a mesh, against those of trimesh and against geometry."""

import numpy as np
import pytest
import trimesh

from qdgrasp_assets.geometry.object_surface import MIN_EXIT_DISTANCE, last_exits

BOX = trimesh.creation.box((0.04, 0.06, 0.08))


def corners_of(mesh):
    return np.asarray(mesh.triangles, dtype=np.float64)


def rays(n, seed=0):
    generator = np.random.default_rng(seed)
    directions = generator.normal(size=(n, 3))
    return generator.uniform(-0.03, 0.03, (n, 3)), directions / np.linalg.norm(directions, axis=1)[:, None]


def by_trimesh(mesh, origins, directions, length):
    """The farthest hit on a triangle that faces along the ray."""
    from trimesh.ray.ray_triangle import RayMeshIntersector

    places, which, triangles = RayMeshIntersector(mesh).intersects_location(origins, directions)
    found = np.full(len(origins), np.nan)
    for place, ray, triangle in zip(places, which, triangles, strict=True):
        distance = np.dot(place - origins[ray], directions[ray])
        if (
            MIN_EXIT_DISTANCE < distance <= length
            and np.dot(mesh.face_normals[triangle], directions[ray]) > 0
        ):
            found[ray] = np.nanmax([found[ray], distance])
    return found


@pytest.mark.parametrize("length", [0.02, 0.05, 1.0])
@pytest.mark.parametrize(
    "mesh", [BOX, trimesh.creation.icosphere(3, 0.04), trimesh.creation.annulus(0.02, 0.03, 0.05)]
)
def test_the_last_exit_is_the_farthest_hit_that_faces_along_the_ray(mesh, length):
    origins, directions = rays(200)
    distances, triangles = last_exits(origins, directions, corners_of(mesh), length)
    expected = by_trimesh(mesh, origins, directions, length)
    np.testing.assert_allclose(distances, expected, atol=1e-9)
    assert np.isnan(expected).any() or length == 1.0
    out = np.isfinite(expected)
    facing = (mesh.face_normals[triangles[out]] * directions[out]).sum(axis=1)
    assert out.any()
    assert (facing > 0).all()


def test_no_ray_slips_between_two_triangles():
    along = np.linspace(-0.0199, 0.0199, 201)  # over the diagonal of the face z = 0.04, and beside it
    origins = np.stack([along, along * 1.5, np.zeros_like(along)], axis=1)
    for side in (1.0, -1.0):
        directions = np.tile([0.0, 0.0, side], (len(origins), 1))
        np.testing.assert_allclose(last_exits(origins, directions, corners_of(BOX), 1.0)[0], 0.04)
