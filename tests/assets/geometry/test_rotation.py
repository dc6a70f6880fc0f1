"""Rotations, judged by scipy's."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from qdgrasp_assets.geometry.rotation import conjugate, from_frame, multiply, rotate, tangents, unit

components = st.floats(-1.0, 1.0, allow_nan=False, width=32)
vectors = arrays(np.float64, (5, 3), elements=components).filter(
    lambda v: bool((np.linalg.norm(v, axis=1) > 1e-3).all())
)
quaternions = arrays(np.float64, (5, 4), elements=components).filter(
    lambda q: bool((np.linalg.norm(q, axis=1) > 1e-3).all())
)


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


@given(quaternions)
def test_a_frame_gives_back_the_unit_quaternion_with_positive_w_that_made_it(raw):
    rotations = Rotation.from_quat(raw)
    columns = np.moveaxis(rotations.as_matrix(), -1, 0)
    found = from_frame(columns[0], columns[1], columns[2])
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-12)
    assert (found[:, 3] >= 0.0).all()
    np.testing.assert_allclose((Rotation.from_quat(found) * rotations.inv()).magnitude(), 0.0, atol=1e-7)


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
