"""Poses of a hand before and after it closed, and the object's motion in between."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from qdgrasp_coordinator.metrics import closing
from qdgrasp_protocol.rows import Rows, RowShape


def rows_of(n: int, slots: int = 1) -> Rows:
    rows = RowShape(7, 2, contact_slots=slots).empty(n)
    random = np.random.default_rng(1)
    rows["base_to_object"][:, :3] = random.uniform(-0.1, 0.1, (n, 3))
    rows["base_to_object"][:, 3:] = Rotation.random(n, random_state=1).as_quat()
    return rows


def moved(rows: Rows, turn: Rotation, shift: tuple[float, float, float]) -> Rows:
    """The rows, of which the object was turned about its centre of mass and shifted, in its first frame."""
    hands = Rotation.from_quat(rows["base_to_object"][:, 3:])
    rows["settled"][:, :3] = turn.inv().apply(rows["base_to_object"][:, :3] - shift)
    rows["settled"][:, 3:] = (turn.inv() * hands).as_quat()
    return rows


@pytest.mark.parametrize("degrees", [0.0, 5.0, 170.0])
def test_the_motion_is_how_far_the_centre_of_mass_went_and_the_object_turned(degrees: float) -> None:
    turn = Rotation.from_rotvec([0.0, np.radians(degrees), 0.0])
    found = closing.motion(moved(rows_of(20), turn, (0.003, 0.0, -0.004)))
    assert found[:, 0] == pytest.approx(0.005, abs=1e-6)
    assert found[:, 1] == pytest.approx(np.radians(degrees), abs=1e-3)


@pytest.mark.parametrize("slots", [0, 1])
def test_where_no_settled_pose_is_recorded_the_commanded_one_stands_and_the_motion_is_not_known(
    slots: int,
) -> None:
    rows = rows_of(3, slots)
    assert np.array_equal(closing.settled_poses(rows), closing.commanded_poses(rows))
    assert np.isnan(closing.motion(rows)).all()
    assert not closing.is_settled(rows).any()


def test_a_settled_pose_stands_in_place_of_the_commanded_one() -> None:
    rows = rows_of(2)
    rows["settled"][1] = (0.1, 0.2, 0.3, 0, 0, 0, 1)
    assert closing.is_settled(rows).tolist() == [False, True]
    assert closing.settled_poses(rows)[1] == pytest.approx([0.1, 0.2, 0.3, 0, 0, 0, 1])
    assert np.array_equal(closing.settled_poses(rows)[0], closing.commanded_poses(rows)[0])
