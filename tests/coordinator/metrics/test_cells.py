import itertools

import numpy as np
import pytest

from qdgrasp_assets.geometry.rotation import Floats, multiply, unit
from qdgrasp_coordinator.metrics.cells import (
    MIDDLES,
    GenomeReader,
    cell_of,
    cells,
    niches,
    orientations,
    without_orientation,
    without_synergy,
)
from qdgrasp_protocol.rows import GIVEN, NO_SYNERGY, Gene, Layout, Outcome, Rows, RowShape


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


def test_a_quaternion_and_its_negative_are_one_orientation() -> None:
    found = uniform(1000)
    assert np.array_equal(orientations(found), orientations(-found))


def test_a_hand_that_stands_square_to_the_object_keeps_its_bin_when_it_is_nudged() -> None:
    for hand in square():
        axes = unit(RANDOM.standard_normal((200, 3)))
        nudge = unit(np.c_[0.15 * axes, np.ones(200)])
        nudged = multiply(nudge, np.broadcast_to(hand, nudge.shape))
        assert angles(nudged, hand).min() > 17
        assert set(orientations(nudged)) == set(orientations(hand[None]))


SHAPE = RowShape(genes=2, joints=1)
FOUR = GenomeReader(Layout("contact", (Gene("nu", 0.0, 1.0), Gene("synergy", 0.0, 3.0))))


def rows(n: int, outcome: Outcome = Outcome.HELD) -> Rows:
    made = SHAPE.empty(n)
    made["generation"], made["index"] = np.divmod(np.arange(n), 10)
    made["outcome"], made["fitness"] = outcome, max(0, outcome - Outcome.DROPPED)
    made["base_to_object"][:, 6] = 1
    return made


def test_cell_orientation_and_synergy_each_tell_niches_apart() -> None:
    found = rows(5)
    found["descriptor"][1, 2] = 0.01
    found["base_to_object"][2, 3:] = MIDDLES[7]
    found["genome"][3, 1] = 1.0
    found["genome"][4, 0] = 1.0  # another nu in the same niche
    keys = niches(found, FOUR)
    assert len(set(keys[:4])) == 4
    assert keys[4] == keys[0]
    assert (cell_of(keys)[[2, 3]] == cell_of(keys)[0]).all()
    assert cell_of(keys)[1] != cell_of(keys)[0]
    assert without_orientation(keys)[2] == without_orientation(keys)[0] != without_orientation(keys)[3]
    assert without_synergy(keys)[3] == without_synergy(keys)[0] != without_synergy(keys)[2]


@pytest.mark.parametrize(("gene", "label"), [(-1.0, 0), (-0.68, 0), (-0.66, 1), (0.2, 2), (1.0, 3)])
def test_the_synergy_is_read_from_the_genome_as_evaluation_reads_it(gene: float, label: int) -> None:
    assert FOUR.labels(np.array([[0.0, gene]], np.float32)).tolist() == [label]


def test_poses_that_are_given_hold_the_label_itself() -> None:
    given = GenomeReader(Layout(GIVEN, (Gene("x", -1.0, 1.0), Gene("synergy", 0.0, 3.0))))
    assert given.labels(np.array([[0.0, 2.0], [0.0, NO_SYNERGY]], np.float32)).tolist() == [2, NO_SYNERGY]
