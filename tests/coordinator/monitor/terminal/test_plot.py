"""Curves in characters."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from qdgrasp_coordinator.monitor.terminal.glyphs import ASCII, UNICODE, Glyphs
from qdgrasp_coordinator.monitor.terminal.plot import plot, sampled


@pytest.mark.parametrize("glyphs", [ASCII, UNICODE], ids=["ascii", "unicode"])
@given(
    values=st.lists(st.floats(0, 1e6), max_size=50),
    width=st.integers(1, 40),
    height=st.integers(1, 10),
)
def test_a_curve_takes_exactly_its_room(glyphs: Glyphs, values: list[float], width: int, height: int) -> None:
    lines = plot(range(len(values)), values, width, height, max(values, default=0.0), glyphs)
    assert [len(line) for line in lines] == [width] * height
    assert (glyphs is UNICODE) or "".join(lines).isascii()


def test_a_straight_line_is_drawn_as_one() -> None:
    assert plot([0, 10], [0, 10], 5, 5, 10, ASCII) == ["    *", "   * ", "  *  ", " *   ", "*    "]


def test_a_jump_is_drawn_without_a_gap() -> None:
    lines = plot([0, 5, 5.001, 10], [0, 0, 10, 10], 4, 4, 10, ASCII)
    assert all("*" in line for line in lines)


def test_braille_has_two_by_four_dots() -> None:
    assert plot([0, 1], [0, 7], 1, 2, 8, UNICODE) == ["⢸", "⡸"]
    assert plot([0, 1], [3, 3], 1, 1, 4, UNICODE) == ["⠉"]


def test_one_point_and_none_are_curves_as_well() -> None:
    assert plot([], [], 4, 1, 0, ASCII) == ["    "]
    assert plot([3], [5], 4, 1, 5, ASCII) == ["*   "]


def test_a_curve_is_read_between_its_points() -> None:
    assert sampled([0, 10, 20], [0, 10, 10], 5) == [0, 5, 10, 10, 10]
    assert sampled([], [], 5) == []
