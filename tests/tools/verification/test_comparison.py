"""Differences are found to the last bit, and put into words."""

import numpy as np
import pytest

from qdgrasp_protocol.messages import deflated
from qdgrasp_protocol.replay_messages import REPLAYED, ReplayAnswer
from qdgrasp_protocol.rows import Outcome, Rows, RowShape, pack
from qdgrasp_tools.verification import comparison


@pytest.fixture
def recorded() -> Rows:
    rows = RowShape(genes=2, joints=2).empty(3)
    rows["outcome"], rows["fitness"], rows["joints"] = Outcome.HELD, 2, (0.01, 0.02)
    return rows


def test_the_last_bit_of_a_number_and_the_sign_of_a_zero_are_differences(recorded: Rows) -> None:
    now = recorded.copy()
    assert not any(map(comparison.row_differences, recorded, now))
    now["joints"][1, 0] = np.nextafter(np.float32(0.01), np.float32(1))
    now["nu"][2] = -0.0
    assert [list(found) for found in map(comparison.row_differences, recorded, now)] == [
        [],
        ["joints"],
        ["nu"],
    ]


def test_numbers_are_told_so_that_they_are_told_apart(recorded: Rows) -> None:
    now = recorded.copy()
    now["penetration"] = 0.001
    recorded["penetration"] = np.nextafter(np.float32(0.001), np.float32(1))
    (words,) = comparison.difference_words(comparison.row_differences(recorded[0], now[0]))
    assert words == "penetration 0.001 instead of 0.0010000002"


def test_a_replay_differs_from_its_row_in_the_columns_of_the_verdict_alone() -> None:
    (found,) = rows = RowShape(2, 2, contact_slots=2).empty(1)
    found["outcome"], found["joints"], found["settled"], found["contact_links"] = 7, 0.01, 0.5, 1
    answer = ReplayAnswer(columns=deflated(pack(rows, REPLAYED)), snapshots=())
    row = found.copy()
    row["nu"], row["steps"] = 1.0, 12
    assert comparison.row_differences(row, comparison.row_with_answer(row, answer)) == {}
    row["settled"][0] += 0.001
    row["contact_points"][0] = 0.02
    found = comparison.row_differences(row, comparison.row_with_answer(row, answer))
    assert found.keys() == {"settled", "contact_points"}
