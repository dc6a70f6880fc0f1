from dataclasses import replace

import msgspec
import numpy as np
import pytest

from qdgrasp_coordinator.analysis.coverage import coverage
from qdgrasp_coordinator.analysis.reference import BuiltFrom, ReferenceSet
from qdgrasp_coordinator.analysis.released import ReleasedArchive

SHIFTED = ReleasedArchive(np.full(3, -0.14), 0.291)
"""29 bins of 10.03 mm; edges at 0.48 and 10.52 mm."""


def reference(cells: list[tuple[int, int, int]], fitness: list[int]) -> ReferenceSet:
    return ReferenceSet(
        "cube", np.array(cells, dtype=np.int64).reshape(-1, 3), np.array(fitness, dtype=np.uint8)
    )


FOUR = reference([(1, 0, 0), (2, 0, 0), (3, 0, 0), (-4, 5, 6)], [0, 1, 2, 2])


def at(*centimetres: tuple[float, float, float]) -> np.ndarray:
    return np.array(centimetres, dtype=np.float32).reshape(-1, 3) / 100


def test_a_position_counts_once_however_often_it_was_reached() -> None:
    found = coverage(
        at((1.0, 0, 0), (1.2, 0.3, -0.4), (0.8, 0, 0), (3.1, 0, 0)), np.array([0, 2, 1, 1]), FOUR
    )
    assert (found.found, found.size, found.coverage) == (2, 4, 0.5)


def test_positions_that_are_not_in_the_set_count_as_outside() -> None:
    found = coverage(at((9.0, 0, 0), (9.1, 0, 0), (0, 9.0, 0), (2, 0, 0)), np.zeros(4), FOUR)
    assert (found.found, found.outside) == (1, 2)


def test_mirrored_positions_are_told_apart() -> None:
    found = coverage(at((4, 5, 6), (-4, -5, 6), (5, -4, 6)), np.zeros(3), FOUR)
    assert (found.found, found.outside) == (0, 3)
    assert coverage(at((-4, 5, 6)), np.zeros(1), FOUR).found == 1


def test_halves_round_to_even_as_the_set_was_rounded() -> None:
    edge = np.array([[0.125, 0.0, 0.0], [0.375, 0.0, 0.0]])
    twelve_and_38 = reference([(12, 0, 0), (38, 0, 0)], [2, 2])
    assert coverage(edge, np.zeros(2), twelve_and_38).coverage == 1.0


def test_the_robust_share_asks_for_fitness_2_on_both_sides() -> None:
    held_where_only_one_shake_is_known, held, dropped = (2, 0, 0), (3, 0, 0), (-4, 5, 6)
    found = coverage(at(held_where_only_one_shake_is_known, held, dropped), np.array([2, 2, 1]), FOUR)
    assert (found.robust_found, found.robust_size, found.robust) == (1, 2, 0.5)


def test_no_success_covers_nothing() -> None:
    found = coverage(np.zeros((0, 3), np.float32), np.zeros(0), FOUR, SHIFTED)
    assert (found.coverage, found.robust, found.released, found.outside) == (0.0, 0.0, 0.0, 0)


def test_an_empty_set_has_no_coverage_and_says_so() -> None:
    found = coverage(at((1, 0, 0)), np.array([2]), reference([], []), SHIFTED)
    assert (found.coverage, found.robust, found.released, found.released_robust) == (None,) * 4
    assert "is empty" in found.sentence
    assert b'"coverage":null' in msgspec.json.encode(found)


def test_a_set_without_robust_entries_has_no_robust_share() -> None:
    assert coverage(at((1, 0, 0)), np.array([2]), reference([(1, 0, 0)], [1])).robust is None


def test_finding_the_whole_set_covers_it() -> None:
    found = coverage(FOUR.cells / 100, np.full(4, 2), FOUR)
    assert (found.coverage, found.robust, found.outside) == (1.0, 1.0, 0)


@pytest.mark.parametrize("seed", range(5))
def test_more_successes_never_cover_less(seed: int) -> None:
    random = np.random.default_rng(seed)
    positions, fitness = random.uniform(-0.04, 0.04, (300, 3)), random.integers(0, 3, 300)
    cells = np.unique(random.integers(-4, 5, (90, 3)), axis=0)
    known = ReferenceSet("cube", cells, random.integers(0, 3, len(cells)).astype(np.uint8))
    shares = [coverage(positions[:n], fitness[:n], known).coverage for n in range(0, 301, 30)]
    assert shares == sorted(shares)
    assert shares[-1] > 0


def test_the_released_count_takes_two_elites_that_round_to_one_position() -> None:
    """Its bins are a little wider than 1 cm and not aligned with the rounding."""
    left, right = (0.8, 0, 0), (1.2, 0, 0)
    found = coverage(at(left, right), np.zeros(2), FOUR, SHIFTED)
    assert (found.found, found.released_found) == (1, 2)


def test_the_released_count_can_lose_what_it_had() -> None:
    known_cell, better_beside_it = (1, 0.1, 0), (1, 0.9, 0)
    first = coverage(at(known_cell), np.array([1]), FOUR, SHIFTED)
    both = coverage(at(known_cell, better_beside_it), np.array([1, 2]), FOUR, SHIFTED)
    assert (first.found, first.released_found) == (1, 1)
    assert (both.found, both.released_found) == (1, 0)


def test_without_an_archive_of_the_released_code_its_figures_are_left_out() -> None:
    found = coverage(at((1, 0, 0)), np.array([2]), FOUR)
    assert (found.released, found.released_robust, found.released_found) == (None, None, None)


def test_on_a_set_of_ones_own_the_released_code_has_no_count() -> None:
    own = replace(FOUR, origin=BuiltFrom("panda", "part.stl", "part", ("paper",)))
    found = coverage(at((1, 0, 0)), np.array([2]), own, SHIFTED)
    assert (found.found, found.released, found.released_robust, found.released_found) == (1, None, None, None)
    assert "released" not in found.sentence


def test_the_sentence_says_what_the_figures_say() -> None:
    found = coverage(at((1, 0, 0), (3, 0, 0), (9, 0, 0)), np.array([1, 2, 0]), FOUR, SHIFTED)
    assert found.sentence == (
        "2 of the 4 cells of 'cube' were found (50.00%), and 1 cell that is not in the set. "
        "With fitness 2 were found 1 of the 2 that have it in the set (50.00%). "
        "The released code counts 2 of the 4 (50.00%)."
    )
