"""Which rows are looked at: each kind has its share."""

import numpy as np
import pytest

from qdgrasp_coordinator.looking.sampling import balanced

KINDS = np.repeat(np.array([1, 2, 4, 7], dtype=np.uint8), [500, 3, 40, 8])


def drawn(n: int, seed: int = 0) -> np.ndarray:
    return balanced(KINDS, n, np.random.default_rng(seed))


@pytest.mark.parametrize("n", [1, 12, 30, 100, 551])
def test_no_kind_has_more_than_another_unless_that_has_no_more(n: int) -> None:
    found = np.bincount(KINDS[drawn(n)], minlength=8)
    there = np.bincount(KINDS, minlength=8)
    assert found.sum() == n
    assert all(found[k] == there[k] or found[k] >= found.max() - 1 for k in (1, 2, 4, 7))


def test_every_row_is_drawn_once_at_most_and_in_order() -> None:
    assert (np.diff(drawn(100)) > 0).all()


def test_all_rows_are_drawn_where_there_are_no_more() -> None:
    assert drawn(10_000).tolist() == list(range(len(KINDS)))
    assert len(balanced(KINDS[:0], 5, np.random.default_rng(0))) == 0


def test_a_seed_draws_the_same_again_and_another_one_others() -> None:
    assert drawn(100).tolist() == drawn(100).tolist()
    assert drawn(100).tolist() != drawn(100, seed=1).tolist()


def test_a_larger_sample_has_the_smaller_one() -> None:
    assert set(drawn(20)) <= set(drawn(50))
