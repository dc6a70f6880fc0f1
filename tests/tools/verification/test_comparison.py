"""Differences are found to the last bit, and put into words."""

import numpy as np
import pytest

from qdgrasp_protocol.rows import Outcome, Rows, RowShape
from qdgrasp_tools.verification import comparison


@pytest.fixture
def recorded() -> Rows:
    rows = RowShape(genes=2, joints=2).empty(3)
    rows["outcome"], rows["fitness"], rows["joints"] = Outcome.HELD, 2, (0.01, 0.02)
    return rows


def columns(recorded: Rows, now: Rows) -> dict[str, list[int]]:
    """The rows that differ, by those columns in which one does."""
    found = comparison.compare_rows(recorded, now).items()
    return {name: np.flatnonzero(unlike).tolist() for name, unlike in found if unlike.any()}


def test_the_last_bit_of_a_number_and_the_sign_of_a_zero_are_differences(recorded: Rows) -> None:
    now = recorded.copy()
    assert columns(recorded, now) == {}
    now["joints"][1, 0] = np.nextafter(np.float32(0.01), np.float32(1))
    now["nu"][2] = -0.0
    assert columns(recorded, now) == {"joints": [1], "nu": [2]}


def test_what_differs_is_told_column_by_column(recorded: Rows) -> None:
    now = recorded.copy()
    now["outcome"], now["fitness"] = Outcome.DROPPED, 0
    words = comparison.difference_words(comparison.row_differences(recorded[0], now[0]))
    assert words == ["outcome dropped instead of held", "fitness 0.0 instead of 2.0"]


def test_numbers_are_told_so_that_they_are_told_apart(recorded: Rows) -> None:
    now = recorded.copy()
    now["penetration"] = 0.001
    recorded["penetration"] = np.nextafter(np.float32(0.001), np.float32(1))
    (words,) = comparison.difference_words(comparison.row_differences(recorded[0], now[0]))
    assert words == "penetration 0.001 instead of 0.0010000002"


@pytest.mark.parametrize(
    ("recorded", "expected"),
    [
        ({}, comparison.PLATFORM_UNKNOWN),
        ({"numpy": "2.4.6"}, comparison.PLATFORM_SAME),
        ({"numpy": "1.0"}, "It was recorded on another platform; here is numpy 2.4.6 instead of 1.0."),
    ],
)
def test_platforms_are_compared_in_a_sentence(recorded: dict[str, str], expected: str) -> None:
    assert comparison.platform_words(recorded, {"numpy": "2.4.6"}) == expected
