"""Whether an object has left the sweep of a hand for good."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from qdgrasp_protocol.genome import NO_SYNERGY
from qdgrasp_worker.grasp import Pose
from qdgrasp_worker.sweep import MARGIN, Sweep, axes

RADIUS = 0.05
SWEEP = Sweep.around([((1, 2, 3), (1.1, 2.1, 3.1)), ((0.9, 2, 3), (1, 2.2, 3.3))], [1, 2, 3], RADIUS)
small = st.floats(-1.0, 1.0, width=32)
triples = st.tuples(small, small, small)
turns = st.tuples(small, small, small, small).filter(lambda q: np.linalg.norm(q) > 0.1)


def pose_at(position, turn) -> Pose:
    quaternion = np.array(turn) / np.linalg.norm(turn)
    return Pose(list(position), quaternion.tolist(), [], NO_SYNERGY)


def test_the_sweep_is_the_box_of_all_boxes_about_the_hand_with_the_objects_radius_and_the_margin():
    aside = RADIUS + MARGIN
    np.testing.assert_allclose(SWEEP.low, np.array([-0.1, 0, 0]) - aside)
    np.testing.assert_allclose(SWEEP.high, np.array([0.1, 0.2, 0.3]) + aside)


@given(turns)
def test_the_axes_of_a_quaternion_are_the_columns_of_its_matrix(turn):
    pose = pose_at((0, 0, 0), turn)
    np.testing.assert_allclose(
        np.array(axes(pose.quaternion)).T, Rotation.from_quat(turn).as_matrix(), atol=1e-9
    )


@given(triples, turns, triples, triples)
def test_an_object_that_has_left_is_outside_ever_after(position, turn, place, velocity):
    pose = pose_at(position, turn)
    hand = Rotation.from_quat(pose.quaternion)
    if SWEEP.is_left(pose, place, velocity):
        for time in (0.0, 0.1, 1.0, 10.0):
            seen = hand.inv().apply(np.array(place) + time * np.array(velocity) - position)
            assert (seen > np.array(SWEEP.high) - 1e-6).any() or (seen < np.array(SWEEP.low) + 1e-6).any()


@given(triples, turns, triples)
def test_an_object_inside_has_not_left_whatever_its_velocity(position, turn, velocity):
    pose = pose_at(position, turn)
    inside = np.array(position) + Rotation.from_quat(pose.quaternion).apply([0.0, 0.1, 0.15])
    assert not SWEEP.is_left(pose, tuple(inside), velocity)


def test_an_object_at_rest_outside_has_left():
    assert SWEEP.is_left(pose_at((0, 0, 0), (0, 0, 0, 1)), (0.5, 0.0, 0.0), (0.0, 0.0, 0.0))


def test_an_object_outside_that_comes_back_has_not_left():
    assert not SWEEP.is_left(pose_at((0, 0, 0), (0, 0, 0, 1)), (0.5, 0.0, 0.0), (-0.1, 0.0, 0.0))
