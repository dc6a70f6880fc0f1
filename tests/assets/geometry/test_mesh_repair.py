"""Repairs: each changes the mesh as needed, and reports it."""

from functools import partial

import numpy as np
import pytest
import trimesh

from qdgrasp_assets.geometry.mesh import Mesh, box, geodesic, join
from qdgrasp_assets.geometry.mesh_repair import (
    body_gap,
    fill_small_holes,
    inverted_bodies,
    is_surface,
    largest_body,
    repair_mesh,
    surface_faults,
)

BLOCK = (0.02, 0.03, 0.05)
SOLID = box(BLOCK)


def apart(mesh: Mesh) -> Mesh:
    """The same triangles, each with corners of its own."""
    return Mesh(mesh.corners.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3))


def assert_is_block(mesh: Mesh) -> None:
    assert surface_faults(mesh) == ()
    assert mesh.volume == pytest.approx(np.prod(BLOCK))


def test_a_solid_is_left_as_it_is():
    mesh, done = repair_mesh(SOLID)
    assert mesh is SOLID
    assert done == ()


def test_vertices_at_the_same_place_are_merged():
    mesh, done = repair_mesh(apart(SOLID))
    assert done == ("28 vertices merged with others",)
    assert_is_block(mesh)
    shaken = apart(SOLID)
    shaken = Mesh(
        shaken.vertices + np.random.default_rng(0).uniform(0, 1e-8, shaken.vertices.shape), shaken.faces
    )
    assert is_surface(repair_mesh(shaken)[0])


def test_degenerate_and_duplicate_triangles_are_dropped():
    extra = np.array([SOLID.faces[0], (0, 0, 1), (2, 3, 3)])
    mesh, done = repair_mesh(Mesh(SOLID.vertices, np.concatenate([SOLID.faces, extra])))
    assert done == ("3 degenerate or duplicate triangles dropped",)
    assert_is_block(mesh)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_winding_is_made_the_same_everywhere_and_outward(share):
    ball = geodesic(0.03, 4)
    is_turned = np.random.default_rng(1).random(len(ball.faces)) < share
    mixed = Mesh(ball.vertices, np.where(is_turned[:, None], ball.faces[:, ::-1], ball.faces))
    mesh, done = repair_mesh(mixed)
    assert mesh.volume == pytest.approx(ball.volume)
    assert "triangles turned, wound like their neighbours" in done[0]
    assert surface_faults(mesh) == ()


def test_a_body_that_is_inside_out_is_turned_and_the_others_are_not():
    mesh, done = repair_mesh(join((SOLID, SOLID.flipped().moved((0.1, 0, 0)))))
    assert done == ("1 of 2 bodies turned: they were inside out (negative volume)",)
    assert mesh.volume == pytest.approx(2 * np.prod(BLOCK))


def test_a_hollow_within_a_body_stays_a_hollow():
    hollow = join((SOLID, SOLID.scaled(0.5).flipped()))
    assert not inverted_bodies(hollow).any()
    mesh, done = repair_mesh(hollow)
    assert mesh is hollow
    assert done == ()


def test_small_holes_are_filled_only_where_that_is_asked_for():
    whole = geodesic(0.03, 8)
    holed = Mesh(whole.vertices, np.delete(whole.faces, (5, 100), axis=0))
    mesh, done = repair_mesh(holed)
    assert (len(mesh.faces), done) == (len(holed.faces), ())
    assert "around 2 holes, the largest" in surface_faults(mesh)[0]
    mesh, done = repair_mesh(holed, fill_small_holes)
    assert "2 holes filled, the widest, 0.00" in done[0]
    assert surface_faults(mesh) == ()
    assert mesh.volume == pytest.approx(whole.volume, rel=1e-3)


@pytest.mark.parametrize("shift", [0, 2e-4])
def test_a_flat_rim_of_any_size_is_closed_where_that_is_asked_for(shift):
    """As where a scanned object stood, whose triangles end unevenly."""
    whole = geodesic(0.05, 24)
    opened = Mesh(whole.vertices, whole.faces[whole.corners.mean(axis=1)[:, 2] > -0.03])
    opened.vertices[:] += np.random.default_rng(0).normal(0, shift, opened.vertices.shape)
    assert not is_surface(repair_mesh(opened, fill_small_holes)[0])
    mesh, done = repair_mesh(opened, partial(fill_small_holes, flat=True))
    assert "1 holes filled" in done[0]
    assert surface_faults(mesh) == ()
    assert mesh.volume == pytest.approx(np.pi * 0.08**2 * (0.05 - 0.08 / 3), rel=0.03)


AGAIN = {"alike": SOLID, "the other way": SOLID.flipped(), "a hair beside": SOLID.moved((1e-8, 0, 0))}


@pytest.mark.parametrize("again", AGAIN.values(), ids=AGAIN)
def test_a_closed_surface_that_is_there_twice_counts_once(again):
    mesh, done = repair_mesh(join((SOLID, again, SOLID.moved((0.1, 0, 0)))))
    assert "a closed surface was there twice" in done[0]
    assert surface_faults(mesh) == ()
    assert mesh.volume == pytest.approx(2 * np.prod(BLOCK))


def test_bodies_that_meet_in_a_face_stay_two():
    mirrored = Mesh(SOLID.vertices * (-1, 1, 1), SOLID.faces).flipped()
    both = join((SOLID, mirrored.moved((BLOCK[0], 0, 0))))
    assert repair_mesh(both) == (both, ())


def test_the_largest_body_is_kept_without_crumbs_and_the_ground_beneath_it():
    random, ball = np.random.default_rng(2), geodesic(0.04, 8)
    ground = Mesh(np.array([(-1.0, -1, -0.1), (1, -1, -0.1), (1, 1, 0.1), (-1, 1, 0.1)]), SQUARE)
    crumbs = [box(random.uniform(1e-3, 4e-3, 3)).moved(random.uniform(0.06, 0.2, 3)) for _ in range(12)]
    mesh, words = largest_body(join((ground, *crumbs[:5], ball, *crumbs[5:])))
    assert words == "the largest of 14 bodies kept"
    assert np.array_equal(mesh.corners, ball.corners)


SQUARE = np.array([(0, 1, 2), (0, 2, 3)])
RING = trimesh.creation.annulus(0.015, 0.03, 0.02)
TURN = trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0))


def block(x: float) -> trimesh.Trimesh:
    return trimesh.creation.box(BLOCK).apply_translation((x, 0, 0))


def rod(radius: float) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius, 0.1)


def ball(radius: float) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=3, radius=radius)


def hollow(radius: float) -> trimesh.Trimesh:
    inverted = ball(radius)
    inverted.invert()
    return inverted


def link(x: float, turn: np.ndarray) -> trimesh.Trimesh:
    return trimesh.creation.torus(0.03, 0.005).apply_transform(turn).apply_translation((x, 0, 0))


def air(*bodies: trimesh.Trimesh) -> float:
    """The gap of an object of these bodies; the same whichever comes first."""
    found = []
    for some in (bodies, bodies[::-1]):
        whole = trimesh.util.concatenate(some)
        found.append(body_gap(Mesh(np.array(whole.vertices), np.array(whole.faces))))
    assert found[0] == pytest.approx(found[1], rel=0.05)
    return found[0]


GAPS = {
    "two blocks that overlap": ([block(0.0), block(0.02)], 0.0),
    "one of three blocks apart": ([block(0.0), block(0.05), block(0.0705)], 0.03),
    "blocks in a row meet face to face": ([block(0.0), block(0.04), block(0.02)], 0.0),
    "a thin rod within a ring": ([rod(0.01), RING], 0.005),
    "a rod thicker than the hole of a ring": ([rod(0.02), RING], 0.0),
    "links of a chain": ([link(0.0, np.eye(4)), link(0.03, TURN)], 0.02),
    "a hollow is of the body that it is in": ([ball(0.05), hollow(0.04)], 0.0),
    "a ball in the material of another body": ([ball(0.05), ball(0.02)], 0.0),
    "a shell in a shell": ([ball(0.05), hollow(0.045), ball(0.035), hollow(0.03)], 0.01),
}


@pytest.mark.parametrize(("bodies", "room"), GAPS.values(), ids=GAPS)
def test_bodies_are_as_far_apart_as_the_air_between_them(bodies, room):
    assert air(*bodies) == pytest.approx(room, rel=0.05)
