"""Changed meshes: a new surface, the hull, fewer triangles; each closed and of like size."""

import numpy as np
import pytest
import trimesh

from qdgrasp_assets.geometry.mesh import Mesh
from qdgrasp_assets.geometry.mesh_repair import is_surface, surface_faults
from qdgrasp_assets.geometry.remesh import prepare_mesh, remesh, simplify_mesh, surface_net
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


def test_a_surface_of_triangles_wound_at_random_becomes_one_body():
    turned = made(BALL)
    faces = np.where((np.arange(len(turned.faces)) % 3 == 0)[:, None], turned.faces[:, ::-1], turned.faces)
    found = remesh(Mesh(turned.vertices, faces))
    assert is_surface(found)
    assert found.volume == pytest.approx(BALL.volume, rel=0.05)


def test_a_sheet_becomes_a_wall():
    sheet = Mesh(np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0.0]]), np.array([[0, 1, 2]]))
    found = remesh(sheet)
    assert not surface_faults(found)
    assert found.extents == pytest.approx([0.1, 0.1, 0.1 / 96 / 2], abs=0.0006)


def test_the_same_mesh_gives_the_same_bits():
    one, other = remesh(made(RING)), remesh(made(RING))
    assert one.vertices.tobytes() == other.vertices.tobytes()
    assert one.faces.tobytes() == other.faces.tobytes()


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


def test_a_hull_is_taken_of_what_is_open():
    found, done = prepare_mesh(made(BALL, slice(0, 1000)), MeshPreparation(hull=True))
    assert not surface_faults(found)
    assert done == ("its convex hull taken in its place",)


def test_what_lies_in_a_plane_has_no_hull():
    flat = Mesh(made(BALL).vertices * (1, 1, 0), made(BALL).faces)
    with pytest.raises(AssetError, match="vertices lie in one plane; give it a thickness"):
        prepare_mesh(flat, MeshPreparation(hull=True))


def test_what_is_done_is_said_and_a_mesh_of_few_triangles_left_as_it_is():
    found, done = prepare_mesh(made(BALL), MeshPreparation(remesh=True, simplify=1000))
    assert len(found.faces) <= 1000
    assert [words.split()[0] for words in done] == ["remeshed", "simplified"]
    ball = made(BALL)
    assert prepare_mesh(ball, MeshPreparation(simplify=100_000)) == (ball, ())
