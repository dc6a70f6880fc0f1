"""Scouts, before a make-believe object."""

import numpy as np
import pytest
from tests.coordinator.searches.make_believe import DEEPEST, PALM, SIZE, space

from qdgrasp_coordinator.searches.aims import Aims, directions
from qdgrasp_coordinator.searches.scouts import scouts

SPACE = space("aimed")


def drawn(astray: float, n: int = 2000) -> Aims:
    return scouts(SPACE, n, astray, 1.0, np.random.default_rng(0))


def distances(aims: Aims) -> np.ndarray:
    return np.linalg.norm(aims.targets - aims.contacts, axis=1)


def test_a_scout_looks_at_a_face_from_before_it() -> None:
    aims = drawn(astray=0.0)
    on_face = np.isclose(np.abs(aims.contacts), SIZE / 2)
    assert on_face.any(axis=1).all()
    towards = directions(aims.targets, aims.contacts)
    inward = -np.sign(aims.contacts) * on_face
    assert ((towards * inward).sum(axis=1) > np.cos(np.pi / 4) - 1e-9).all()


def test_a_scout_stands_in_the_near_half_of_where_the_hand_can_stand() -> None:
    found = distances(drawn(astray=0.0))
    assert found.min() == pytest.approx(PALM, abs=1e-4)
    assert found.max() == pytest.approx(PALM + DEEPEST / 2, abs=1e-4)


def test_those_that_go_astray_aim_anywhere_in_the_box() -> None:
    low, high = SPACE.box
    found = (drawn(astray=1.0).targets - low) / (high - low)
    assert np.abs(found.mean(axis=0) - 0.5).max() < 0.05
    assert found.min() < 0.01
    assert found.max() > 0.99
