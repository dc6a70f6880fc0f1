"""The rule by which convex parts are chosen."""

import numpy as np
import pytest
import trimesh

from qdgrasp_assets.geometry.collision_parts import (
    CORNER_TOLERANCE,
    MOST_CORNERS,
    FingerClearance,
    collision_parts,
    simplify_part,
)
from qdgrasp_assets.geometry.mesh import Mesh, box, geodesic, heights, join
from qdgrasp_assets.stand_ins import stand_in

CORNERS = [(0, 0), (0.06, 0), (0.06, 0.02), (0.02, 0.02), (0.02, 0.06), (0, 0.06)]
CAPS = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]


@pytest.fixture
def angle() -> Mesh:
    """An L-shaped profile of 6 corners, 2 cm high."""
    low, high = ([(x, y, z) for x, y in CORNERS] for z in (0.0, 0.02))
    sides = [(i, (i + 1) % 6, (i + 1) % 6 + 6) for i in range(6)]
    sides += [(i, (i + 1) % 6 + 6, i + 6) for i in range(6)]
    caps = [(a, c, b) for a, b, c in CAPS] + [(a + 6, b + 6, c + 6) for a, b, c in CAPS]
    return Mesh(np.array(low + high), np.array(sides + caps))


def test_a_convex_mesh_is_its_own_part():
    source, (part,) = collision_parts(box((0.1, 0.2, 0.3)))
    assert source == "own hull"
    assert part.volume == pytest.approx(0.006)


def test_a_mesh_that_is_not_convex_is_cut_where_its_faces_meet(angle):
    source, parts = collision_parts(angle)
    assert source == "cuts"
    assert [len(part.vertices) for part in parts] == [8, 8]
    assert sum(part.volume for part in parts) == pytest.approx(angle.volume)


def test_convex_bodies_are_parts_as_they_are():
    blocks = [box((0.03, 0.01, 0.01)), box((0.01, 0.01, 0.04)).moved((0, 0, 0.02))]
    _, parts = collision_parts(join(blocks))
    assert sorted(part.volume for part in parts) == pytest.approx([3e-6, 4e-6])


def test_a_mug_keeps_its_hollow_and_the_eye_of_its_handle():
    surface, own = mug()
    _, parts = collision_parts(surface)
    assert FingerClearance(surface).fit(parts).is_good
    assert len(parts) < len(own) < 64
    low, high = surface.bounds
    hollow, eye = (0, 0, high[2] - 0.01), (high[0] - 0.016, 0, (low[2] + high[2]) / 2)
    for point in np.array([hollow, eye]):
        assert not any(heights(part, point[None]).max() < 0 for part in parts)


@pytest.mark.parametrize("scale", [(1, 1, 1), (0.5, 1, 2), (1, 1, 0.1)])
def test_no_corner_that_is_left_out_was_far_outside_and_none_is_added(scale) -> None:
    ball = geodesic(0.01, 8)
    round_part = Mesh(ball.vertices * scale, ball.faces)
    part = simplify_part(round_part)
    assert len(part.vertices) < MOST_CORNERS
    assert heights(part, round_part.vertices).max() <= CORNER_TOLERANCE
    assert heights(round_part, part.vertices).max() < 1e-9
    assert trimesh.Trimesh(part.vertices, part.faces, process=False).is_volume


def mug() -> tuple[Mesh, tuple[Mesh, ...]]:
    """Surface and parts of the mug, around its cup's axis."""
    target, shift = stand_in("mug"), (0.0207, -0.0174, 0.0005)
    return target.mesh.moved(shift), tuple(part.moved(shift) for part in target.parts)
