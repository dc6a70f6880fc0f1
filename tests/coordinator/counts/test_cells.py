import numpy as np
import pytest

from qdgrasp_coordinator.counts.cells import best, cells, keys


def test_a_cell_reaches_half_a_centimetre_to_both_sides() -> None:
    found = cells([[0.0049, -0.0049, 0.0051], [0.1449, 0.1451, -0.3]])
    assert found.tolist() == [[0, 0, 1], [14, 15, -30]]


def test_cells_are_the_rounding_of_the_reference_set() -> None:
    positions = np.random.default_rng(0).uniform(-0.4, 0.4, (10_000, 3))
    assert np.array_equal(cells(positions) / 100, np.around(positions, 2))


def test_halves_go_to_the_even_cell() -> None:
    assert cells([[0.005, 0.015, 0.025], [-0.005, -0.015, -0.025]]).tolist() == [[0, 2, 2], [0, -2, -2]]


def test_float32_positions_are_widened_before_they_are_rounded() -> None:
    position = np.float32(0.165)
    assert float(position) > 0.165
    assert position * np.float32(100) == 16.5
    assert cells(np.array([[position] * 3])).tolist() == [[17, 17, 17]]


def test_keys_are_equal_for_equal_cells_only() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(-12, 13)] * 3), axis=-1).reshape(-1, 3)
    assert len(np.unique(keys(grid))) == len(grid)
    assert np.array_equal(keys(grid), keys(grid.copy()))


@pytest.mark.parametrize("far", [-(1 << 20), (1 << 20) - 1])
def test_keys_hold_for_far_cells(far: int) -> None:
    grid = np.array([[far, 0, 0], [0, far, 0], [0, 0, far], [0, 0, 0], [far, far, far]])
    assert len(np.unique(keys(grid))) == len(grid)


def test_the_best_of_each_cell_is_its_greatest_value_and_cells_are_in_order() -> None:
    random = np.random.default_rng(1)
    found, values = random.integers(-3, 4, (500, 3)), random.integers(0, 3, 500)
    distinct, greatest = best(found, values)
    expected: dict[tuple[int, ...], int] = {}
    for cell, value in zip(map(tuple, found.tolist()), values.tolist(), strict=True):
        expected[cell] = max(value, expected.get(cell, 0))
    assert [(tuple(cell), value) for cell, value in zip(distinct.tolist(), greatest, strict=True)] == sorted(
        expected.items()
    )
