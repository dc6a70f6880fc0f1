import itertools

import numpy as np
import pytest

from qdgrasp_assets.geometry.rotation import Floats, multiply, unit
from qdgrasp_coordinator.metrics.cells import (
    BINS,
    MIDDLES,
    cell_keys,
    cells,
    clear_orientations,
    orientations,
)


def test_a_cell_reaches_half_a_centimetre_to_both_sides() -> None:
    found = cells([[0.0049, -0.0049, 0.0051], [0.1449, 0.1451, -0.3]])
    assert found.tolist() == [[0, 0, 1], [14, 15, -30]]


def test_halves_go_to_the_even_cell() -> None:
    assert cells([[0.005, 0.015, 0.025], [-0.005, -0.015, -0.025]]).tolist() == [[0, 2, 2], [0, -2, -2]]


def test_float32_positions_are_widened_before_they_are_rounded() -> None:
    position = np.float32(0.165)
    assert float(position) > 0.165
    assert position * np.float32(100) == 16.5
    assert cells(np.array([[position] * 3])).tolist() == [[17, 17, 17]]


def test_keys_are_equal_for_equal_cells_only() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(-12, 13)] * 3), axis=-1).reshape(-1, 3)
    assert len(np.unique(cell_keys(grid))) == len(grid)
    assert np.array_equal(cell_keys(grid), cell_keys(grid.copy()))


RANDOM = np.random.default_rng(3)


def uniform(n: int) -> Floats:
    return unit(RANDOM.standard_normal((n, 4)))


def angles(one: Floats, other: Floats) -> Floats:
    """Angles between rotations (..., 4) [deg]."""
    cosines = np.abs((one * other).sum(axis=-1))
    return np.degrees(2 * np.arccos(np.minimum(cosines, 1.0)))


def square() -> Floats:
    """The 24 rotations that take axes to axes, and their negatives."""
    ways = [np.array(way, float) for way in itertools.product((-1, 0, 1), repeat=4) if any(way)]
    return unit(np.array([way for way in ways if np.count_nonzero(way) != 3]))


def test_every_middle_is_in_its_own_bin() -> None:
    assert orientations(MIDDLES).tolist() == list(range(BINS))


def test_a_quaternion_and_its_negative_are_one_orientation() -> None:
    found = uniform(1000)
    assert np.array_equal(orientations(found), orientations(-found))


def test_every_middle_has_twelve_neighbours_at_72_degrees() -> None:
    between = angles(MIDDLES[:, None], MIDDLES[None])
    nearest = np.sort(between, axis=1)[:, 1:14]
    assert nearest[:, :12] == pytest.approx(72.0)
    assert nearest[:, 12] == pytest.approx(120.0)


def test_a_hand_that_stands_square_to_the_object_keeps_its_bin_when_it_is_nudged() -> None:
    for hand in square():
        axes = unit(RANDOM.standard_normal((200, 3)))
        nudge = unit(np.c_[0.15 * axes, np.ones(200)])
        nudged = multiply(nudge, np.broadcast_to(hand, nudge.shape))
        assert angles(nudged, hand).min() > 17
        assert set(orientations(nudged)) == set(orientations(hand[None]))


def test_a_rotation_is_clear_in_the_middle_of_its_bin_and_not_on_the_border() -> None:
    bins, clearness = clear_orientations(MIDDLES)
    assert bins.tolist() == list(range(BINS))
    assert clearness == pytest.approx(np.ones(BINS))
    beside = MIDDLES[np.argsort(angles(MIDDLES[0], MIDDLES))[1]]
    beside = beside * np.sign(beside @ MIDDLES[0])
    way = unit(np.linspace(MIDDLES[0], MIDDLES[0] + beside, 6))
    assert (np.diff(clear_orientations(way)[1]) < 0).all()
    assert clear_orientations(way)[1][-1] == pytest.approx(0.0)
