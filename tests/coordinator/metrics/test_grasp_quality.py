"""Motion, margin and limits of recorded grasps."""

import numpy as np
import pytest
from tests.coordinator.scenes import made_scene

from qdgrasp_coordinator.metrics.grasp_quality import (
    TORSION,
    GraspLimits,
    grasp_margins,
    object_motion,
    recorded_margins,
)
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.rows import CONTACT_VALUES, Outcome, RowShape

POINTS = np.array([[0.02, 0, 0.005], [0.02, 0, -0.005], [-0.02, 0.004, 0], [-0.02, -0.004, 0]])


def rows_of(n=3, contact_slots=6):
    """Grasps whose hand stands 10 cm above the object; none has moved."""
    rows = RowShape(7, 2, contact_slots=contact_slots).empty(n)
    rows["outcome"], rows["contacts"] = Outcome.HELD, 2
    for name in ("base_to_object", "settled"):
        rows[name][..., : rows[name].shape[1]] = np.array([0, 0, 0.1, 0, 0, 0, 1])[: rows[name].shape[1]]
    if contact_slots:
        rows["contact_links"][:, :4] = [2, 2, 3, 3]
        values = rows["contact_points"].reshape(n, -1, CONTACT_VALUES)
        values[:, :4, :3], values[:, :4, 3], values[:, :4, 6] = POINTS, -np.sign(POINTS[:, 0]), 5.0
        rows["contact_points"] = values.reshape(n, -1)
    return rows


def test_the_motion_is_that_of_the_centre_of_mass_in_the_hand():
    rows = rows_of()
    rows["settled"][1, :3] = [0, 0.003, 0.104]
    half = np.radians(30.0) / 2
    rows["settled"][2] = [0, 0, 0.1, 0, 0, np.sin(half), np.cos(half)]
    moved = object_motion(rows)
    np.testing.assert_allclose(moved[:, 0], [0, 0.005, 0], atol=1e-8)
    np.testing.assert_allclose(np.degrees(moved[:, 1]), [0, 0, 30], atol=0.05)
    half = np.radians(90.0) / 2
    rows["settled"][2] = [0, 0, 0.1, np.sin(half), 0, 0, np.cos(half)]  # the hand turned where it stands
    assert object_motion(rows)[2, 0] == pytest.approx(0.1 * np.sqrt(2))


def test_the_margin_is_that_of_the_contacts_that_are_there():
    scene, rows = made_scene("jaw"), rows_of()
    rows["contact_links"][1, 2:] = 0
    expected = grasp_margins(
        POINTS[None],
        np.array([[[-1, 0, 0], [-1, 0, 0], [1, 0, 0], [1, 0, 0]]]),
        np.ones((1, 4), bool),
        friction=scene.object.lateral_friction,
        torsion=TORSION,
        radius=scene.object.radius,
    )
    margins = recorded_margins(rows, scene.object)
    assert margins[0] == margins[2] == pytest.approx(float(expected[0]), rel=2e-2)
    assert margins[0] > 0
    assert margins[1] == 0


def test_each_limit_keeps_what_is_within_it():
    scene, rows = made_scene("jaw"), rows_of(4)
    rows["penetration"] = [0, 0.001, 0.002, 0.003]
    rows["contacts"] = [2, 1, 2, 2]
    rows["settled"][3, 2] = 0.12
    rows["contact_links"][2, 2:] = 0
    kept = {
        "max_penetration": (2.0, [True, True, True, False]),
        "max_motion": (10.0, [True, True, True, False]),
        "min_margin": (0.001, [True, True, False, True]),
        "min_links": (2, [True, False, True, True]),
    }
    for name, (value, expected) in kept.items():
        assert GraspLimits(**{name: value}).admitted(rows, scene).tolist() == expected
    every = GraspLimits(**{name: value for name, (value, _) in kept.items()})
    assert every.admitted(rows, scene).tolist() == [True, False, False, False]
    assert every.reason(rows, scene).startswith("of 4 grasps --max-penetration 2 admits 3, --max-motion 10")
    with pytest.raises(ImpossibleValue, match="max_motion"):
        GraspLimits(max_motion=-1.0)
