"""The distance of two surfaces is found as it is, however they are cut into triangles."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from qdgrasp_assets.nearness import come_within, nearest

BALL = np.array(trimesh.creation.icosphere(subdivisions=2, radius=0.01).triangles)
PLATE = np.array([[(-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (0.0, 1.0, 0.0)]])


@settings(max_examples=30)
@given(room=st.floats(0.002, 0.2), height=st.floats(-0.3, 0.3))
def test_a_ball_over_a_plate_of_one_triangle_is_as_far_as_its_lowest_point(room, height):
    ball = BALL + np.array((0.0, height, room - BALL[..., 2].min()))
    assert 0.999 * room <= nearest(ball, PLATE) <= 1.3 * room
    assert not come_within(ball, PLATE, room / 2)
    assert come_within(PLATE, ball, 2 * room)


def test_edges_that_cross_each_other_are_nearest_there():
    """No corner of either is near the other."""
    blade = np.array([[(-0.1, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.0, -0.1)]])
    other = np.array([[(0.0, -0.1, 0.003), (0.0, 0.1, 0.003), (0.0, 0.0, 0.1)]])
    assert nearest(blade, other) == pytest.approx(0.003, rel=0.3)
    assert not come_within(blade, other, 0.001)


def test_surfaces_that_cut_each_other_come_within_anything():
    assert come_within(BALL, PLATE, 1e-4)


def test_what_stays_open_counts_as_near():
    """Two sheets a micrometre, or a corner a hair, farther from a sheet than what is asked for."""
    assert come_within(PLATE, PLATE + np.array((0.0, 0.0, 0.001001)), 0.001)
    corner = np.array([[(0.0, 0.0, 0.001), (0.1, 0.0, 0.1), (0.0, 0.1, 0.1)]])
    assert come_within(corner, PLATE, np.nextafter(0.001, 0.0))
