import itertools

import numpy as np
import pytest

from qdgrasp_assets.rotation import Floats, dot, multiply, unit
from qdgrasp_coordinator.counts.orientations import BINS, MIDDLES, orientations

RANDOM = np.random.default_rng(3)


def uniform(n: int) -> Floats:
    return unit(RANDOM.standard_normal((n, 4)))


def angles(one: Floats, other: Floats) -> Floats:
    """Between rotations (..., 4) [deg]."""
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


def test_uniform_rotations_fill_all_bins_alike() -> None:
    counts = np.bincount(orientations(uniform(60_000)), minlength=BINS)
    assert counts.min() > 850  # 1000 expected, standard deviation 31
    assert counts.max() < 1150


def test_no_rotation_is_farther_than_45_degrees_from_the_middle_of_its_bin() -> None:
    found = uniform(20_000)
    assert angles(found, MIDDLES[orientations(found)]).max() < 44.5


def test_a_hand_that_stands_square_to_the_object_keeps_its_bin_when_it_is_nudged() -> None:
    for hand in square():
        nudge = unit(
            np.concatenate([0.15 * unit(RANDOM.standard_normal((200, 3))), np.ones((200, 1))], axis=1)
        )
        nudged = multiply(nudge, np.broadcast_to(hand, nudge.shape))
        assert angles(nudged, hand).min() > 17
        assert set(orientations(nudged)) == set(orientations(hand[None]))


def test_middles_are_unit_quaternions() -> None:
    assert dot(MIDDLES[:, :3], MIDDLES[:, :3]) + MIDDLES[:, 3] ** 2 == pytest.approx(1.0)


def test_no_rotations_have_no_orientations() -> None:
    assert orientations(np.zeros((0, 4), np.float32)).shape == (0,)
