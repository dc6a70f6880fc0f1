"""Changed meshes: a new surface, the hull, fewer triangles; each closed and of like size."""

import numpy as np
import pytest
import trimesh

from qdgrasp_assets.geometry.mesh import Mesh
from qdgrasp_assets.geometry.mesh_repair import (
    is_surface,
    prepare_mesh,
    remesh,
    simplify_mesh,
    surface_faults,
    surface_net,
)
from qdgrasp_protocol.build_messages import MeshPreparation
from qdgrasp_protocol.errors import AssetError


def made(mesh: trimesh.Trimesh, left_out: slice = slice(0)) -> Mesh:
    faces = np.delete(np.asarray(mesh.faces, dtype=np.int64), left_out, axis=0)
    return Mesh(np.asarray(mesh.vertices, dtype=np.float64), faces)


BALL = trimesh.creation.icosphere(subdivisions=4, radius=0.04)
RING = trimesh.creation.torus(0.04, 0.012)


@pytest.mark.parametrize("mesh", [BALL, RING, trimesh.creation.annulus(0.01, 0.03, 0.06)])
def test_a_new_surface_is_closed_outward_and_half_a_cell_larger_at_most(mesh):
    found, given = remesh(made(mesh)), made(mesh)
    assert not surface_faults(found)
    cell = given.extents.max() / 96
    assert given.extents == pytest.approx(found.extents, abs=cell)
    assert given.volume < found.volume < given.volume + given.areas.sum() * cell / 2


PIPE = trimesh.creation.annulus(0.0285, 0.03, 0.06)
CROSSED = trimesh.util.concatenate(
    [trimesh.creation.box(sides) for sides in ((0.06, 0.03, 0.03), (0.03, 0.03, 0.06))]
)


def test_a_closed_mesh_keeps_its_volume_or_is_not_remeshed():
    found, _ = prepare_mesh(made(CROSSED), MeshPreparation(remesh=True))
    assert found.volume == pytest.approx(1.5 * 0.06 * 0.03**2, rel=0.05)
    with pytest.raises(AssetError, match=r"would enclose 1\.\d+ times its volume"):
        prepare_mesh(made(PIPE), MeshPreparation(remesh=True))


def test_a_surface_net_of_any_signs_has_no_open_edge():
    field = np.pad(np.random.default_rng(0).normal(size=(9, 8, 7)), 1, constant_values=1.0)
    vertices, faces = surface_net(field)
    assert is_surface(Mesh(vertices, faces))
    assert Mesh(vertices, faces).volume > 0


@pytest.mark.parametrize("triangles", [2000, 300])
def test_a_mesh_is_simplified_to_as_few_triangles_and_stays_closed(triangles):
    found = simplify_mesh(made(BALL), triangles)
    assert len(found.faces) <= triangles
    assert is_surface(found)
    assert found.volume == pytest.approx(BALL.volume, rel=0.03)
