"""Repairs: each changes what it must, and says so."""

import numpy as np
import pytest
import trimesh

from qdgrasp_assets.mesh import Mesh, join
from qdgrasp_assets.objects.solids import box, geodesic
from qdgrasp_assets.repair import inverted, is_surface, repaired
from qdgrasp_assets.solidity import faults

BLOCK = (0.02, 0.03, 0.05)
SOLID = box(BLOCK)


def apart(mesh: Mesh) -> Mesh:
    """The same triangles, each with corners of its own."""
    return Mesh(mesh.corners.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3))


def assert_is_block(mesh: Mesh) -> None:
    assert faults(mesh) == ()
    assert mesh.volume == pytest.approx(np.prod(BLOCK))


def test_a_solid_is_left_as_it_is():
    mesh, done = repaired(SOLID)
    assert mesh is SOLID
    assert done == ()


def test_vertices_at_the_same_place_are_merged():
    mesh, done = repaired(apart(SOLID))
    assert done == ("28 vertices merged with others",)
    assert_is_block(mesh)
    shaken = apart(SOLID)
    shaken = Mesh(
        shaken.vertices + np.random.default_rng(0).uniform(0, 1e-8, shaken.vertices.shape), shaken.faces
    )
    assert is_surface(repaired(shaken)[0])


def test_degenerate_and_duplicate_triangles_are_dropped():
    extra = np.array([SOLID.faces[0], (0, 0, 1), (2, 3, 3)])
    mesh, done = repaired(Mesh(SOLID.vertices, np.concatenate([SOLID.faces, extra])))
    assert done == ("3 degenerate or duplicate triangles dropped",)
    assert_is_block(mesh)


def test_a_sheet_that_lies_back_to_back_is_dropped():
    fin = np.array([(0, 1, len(SOLID.vertices)), (1, 0, len(SOLID.vertices)), (0, 1, len(SOLID.vertices))])
    mesh, _ = repaired(
        Mesh(np.concatenate([SOLID.vertices, [(0, 0, 0.1)]]), np.concatenate([SOLID.faces, fin]))
    )
    assert len(mesh.faces) == len(SOLID.faces)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_winding_is_made_the_same_everywhere_and_outward(share):
    ball = geodesic(0.03, 4)
    is_turned = np.random.default_rng(1).random(len(ball.faces)) < share
    mixed = Mesh(ball.vertices, np.where(is_turned[:, None], ball.faces[:, ::-1], ball.faces))
    mesh, done = repaired(mixed)
    assert mesh.volume == pytest.approx(ball.volume)
    assert "triangles turned, wound like their neighbours" in done[0]
    assert faults(mesh) == ()


def test_a_body_that_is_inside_out_is_turned_and_the_others_are_not():
    pair = join((SOLID, SOLID.flipped().moved((0.1, 0, 0))))
    mesh, done = repaired(pair)
    assert done == ("1 of 2 bodies turned: they were inside out (negative volume)",)
    assert mesh.volume == pytest.approx(2 * np.prod(BLOCK))


def test_a_hollow_within_a_body_stays_a_hollow():
    hollow = join((SOLID, SOLID.scaled(0.5).flipped()))
    assert not inverted(hollow).any()
    mesh, done = repaired(hollow)
    assert mesh is hollow
    assert done == ()


def pricked(*faces: int) -> Mesh:
    ball = geodesic(0.03, 8)
    return Mesh(ball.vertices, np.delete(ball.faces, faces, axis=0))


def test_small_holes_are_filled_only_where_that_is_asked_for():
    whole, holed = geodesic(0.03, 8), pricked(5, 100)
    mesh, done = repaired(holed)
    assert (len(mesh.faces), done) == (len(holed.faces), ())
    assert "around 2 holes, the largest" in faults(mesh)[0]
    mesh, done = repaired(holed, fill_holes=True)
    assert "2 holes filled, the widest, 0.00" in done[0]
    assert faults(mesh) == ()
    assert mesh.volume == pytest.approx(whole.volume, rel=1e-3)


def test_a_large_hole_is_not_guessed_at():
    ball = geodesic(0.03, 8)
    half = Mesh(ball.vertices, ball.faces[ball.corners[:, :, 2].mean(axis=1) > 0])
    mesh, done = repaired(half, fill_holes=True)
    assert (len(mesh.faces), done) == (len(half.faces), ())


def test_bodies_that_share_an_edge_are_a_solid():
    """Four triangles meet there, and room is inside and outside of each."""
    low, high = SOLID.bounds
    edge = trimesh.util.concatenate(
        [trimesh.creation.box(BLOCK), trimesh.creation.box(BLOCK).apply_translation((high - low) * (1, 1, 0))]
    )
    edge.merge_vertices()
    mesh = Mesh(np.array(edge.vertices), np.array(edge.faces))
    assert repaired(mesh) == (mesh, ())
    assert faults(mesh) == ()
