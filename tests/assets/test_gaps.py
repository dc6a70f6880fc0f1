"""Bodies that meet are one thing; those with air between them are not, wherever they are."""

import numpy as np
import pytest
import trimesh

from qdgrasp_assets import gaps
from qdgrasp_assets.gaps import gap
from qdgrasp_assets.mesh import Mesh

BLOCK = (0.02, 0.03, 0.05)
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
    torus = trimesh.creation.torus(0.03, 0.005)
    return torus.apply_transform(turn).apply_translation((x, 0, 0))


def air(*bodies: trimesh.Trimesh) -> float:
    """The gap of an object of these bodies; the same whichever comes first."""
    found = []
    for some in (bodies, bodies[::-1]):
        whole = trimesh.util.concatenate(some)
        found.append(gap(Mesh(np.array(whole.vertices), np.array(whole.faces))))
    assert found[0] == pytest.approx(found[1], rel=0.05)
    return found[0]


@pytest.mark.parametrize(
    ("shifts", "room"),
    [((0.0,), 0.0), ((0.0, 0.02), 0.0), ((0.0, 0.05, 0.0705), 0.03), ((0.0, 0.04, 0.02), 0.0)],
)
def test_blocks_in_a_row_meet_face_to_face(shifts, room):
    assert air(*map(block, shifts)) == pytest.approx(room, rel=0.05)


@pytest.mark.parametrize(("radius", "room"), [(0.01, 0.005), (0.0145, 0.0), (0.02, 0.0)])
def test_a_rod_within_a_ring_meets_it_if_it_is_as_thick(radius, room):
    assert air(rod(radius), RING) == pytest.approx(room, rel=0.05)


def test_links_of_a_chain_are_apart():
    assert air(link(0.0, np.eye(4)), link(0.03, TURN)) == pytest.approx(0.02, rel=0.05)
    assert air(link(0.0, np.eye(4)), link(0.05, TURN)) == 0.0


def test_a_hollow_is_of_the_body_that_it_is_in():
    assert air(ball(0.05), hollow(0.04)) == 0.0


def test_what_lies_in_a_hollow_is_apart_unless_it_touches_the_wall():
    assert air(ball(0.05), hollow(0.04), ball(0.02)) == pytest.approx(0.02, rel=0.05)
    assert air(ball(0.05), hollow(0.04), ball(0.0395)) == 0.0


def test_what_lies_in_the_material_of_another_body_is_not_apart():
    assert air(ball(0.05), ball(0.02)) == 0.0


def test_a_shell_in_a_shell_is_apart_with_its_hollow():
    assert air(ball(0.05), hollow(0.045), ball(0.035), hollow(0.03)) == pytest.approx(0.01, rel=0.05)


def test_dust_is_told_apart_by_boxes_alone(monkeypatch):
    monkeypatch.setattr(gaps, "MANY", 1)
    assert air(rod(0.01), RING) == 0.0
    assert air(block(0.0), block(0.05)) == pytest.approx(0.03, rel=0.05)
