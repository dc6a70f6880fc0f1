"""Rotations, judged by scipy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from qdgrasp_assets.geometry.rotation import (
    conjugate,
    dot,
    from_euler,
    from_frame,
    multiply,
    rotate,
    tangents,
    turned,
    unit,
)

components = st.floats(-1.0, 1.0, allow_nan=False, width=32)
vectors = arrays(np.float64, (5, 3), elements=components).filter(
    lambda v: bool((np.linalg.norm(v, axis=1) > 1e-3).all())
)
quaternions = arrays(np.float64, (5, 4), elements=components).filter(
    lambda q: bool((np.linalg.norm(q, axis=1) > 1e-3).all())
)
POLES = np.array([[0, 0, 1], [0, 0, -1], [1e-9, 0, -1], [1, 0, 0], [1, 0, -0.0], [0, -1, 0]], dtype=float)


def is_right_handed_frame(x, y, z):
    frame = np.stack([x, y, z], axis=-1)
    np.testing.assert_allclose(
        np.swapaxes(frame, -1, -2) @ frame, np.tile(np.eye(3), (len(x), 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(frame), 1.0, atol=1e-12)
    return True


@given(vectors)
def test_every_direction_has_tangents_that_make_a_right_handed_frame_with_it(directions):
    normals = unit(directions)
    assert is_right_handed_frame(*tangents(normals), normals)


def test_the_poles_have_tangents_too():
    normals = unit(POLES)
    assert is_right_handed_frame(*tangents(normals), normals)


@given(vectors, st.floats(-7.0, 7.0))
def test_turning_tangents_keeps_the_frame_and_turns_it_about_the_normal_by_the_angle(directions, angle):
    normals = unit(directions)
    first, second = tangents(normals)
    turned_first, turned_second = turned(first, second, np.full(len(normals), angle))
    assert is_right_handed_frame(turned_first, turned_second, normals)
    by_scipy = Rotation.from_rotvec(normals * angle).apply(first)
    np.testing.assert_allclose(turned_first, by_scipy, atol=1e-12)


@given(quaternions)
def test_a_frame_gives_back_the_unit_quaternion_with_positive_w_that_made_it(raw):
    rotations = Rotation.from_quat(raw)
    columns = np.moveaxis(rotations.as_matrix(), -1, 0)
    found = from_frame(columns[0], columns[1], columns[2])
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-12)
    assert (found[:, 3] >= 0.0).all()
    np.testing.assert_allclose((Rotation.from_quat(found) * rotations.inv()).magnitude(), 0.0, atol=1e-7)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_half_turns_whose_w_is_zero_are_read_as_well(axis):
    half_turn = Rotation.from_rotvec(np.pi * np.eye(3)[[axis]])
    columns = np.moveaxis(half_turn.as_matrix(), -1, 0)
    found = from_frame(columns[0], columns[1], columns[2])
    np.testing.assert_allclose(np.abs(found), [np.eye(4)[axis]], atol=1e-12)


@given(quaternions, quaternions)
def test_products_and_inverses_agree_with_scipy(a, b):
    a, b = unit(a), unit(b)
    by_scipy = (Rotation.from_quat(a) * Rotation.from_quat(b).inv()).as_quat()
    ours = multiply(a, conjugate(b))
    np.testing.assert_allclose(np.abs((ours * by_scipy).sum(axis=1)), 1.0, atol=1e-9)


@given(quaternions, vectors)
def test_vectors_turn_as_scipy_turns_them(raw, vectors):
    found = rotate(unit(raw), vectors)
    np.testing.assert_allclose(found, Rotation.from_quat(raw).apply(vectors), atol=1e-12)


@given(arrays(np.float64, (5, 3), elements=st.floats(-7.0, 7.0)))
def test_euler_angles_turn_about_fixed_axes_in_the_order_of_their_names(angles):
    by_scipy = Rotation.from_euler("xyz", angles)
    assert (Rotation.from_quat(from_euler(angles)) * by_scipy.inv()).magnitude().max() < 1e-7


@given(vectors, vectors)
def test_scalar_products_agree_with_numpy(a, b):
    np.testing.assert_allclose(dot(a, b), (a * b).sum(axis=1), atol=1e-12)
