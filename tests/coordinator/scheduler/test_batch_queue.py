import numpy as np
import pytest
from tests.fakes.messages import result_message

from qdgrasp_coordinator.scheduler.auditor import read_result
from qdgrasp_coordinator.scheduler.batch_queue import BATCH_SECONDS, LEAST_SECONDS, MOST_ROWS, BatchSizer
from qdgrasp_coordinator.scheduler.worker_registry import LEASE_SECONDS, LeaseTimeout
from qdgrasp_protocol.messages import Failure, Result, deflated
from qdgrasp_protocol.rows import RESULT, Outcome, RowShape, pack

SHAPE = RowShape(genes=2, joints=1)


def result(outcomes: list[int]) -> Result:
    rows = SHAPE.empty(len(outcomes))
    rows["outcome"] = outcomes
    return result_message(n=len(outcomes), columns=deflated(pack(rows, RESULT)))


def test_the_rows_of_a_result_are_read() -> None:
    read, rows = read_result(result([Outcome.ERROR, Outcome.HELD]), SHAPE)
    assert read.failures == []
    np.testing.assert_array_equal(rows["outcome"], [Outcome.ERROR, Outcome.HELD])


@pytest.mark.parametrize(
    ("column", "number"),
    [
        ("outcome", Outcome.HELD + 1),
        ("outcome", 255),
        ("fitness", 3e38),
        ("fitness", np.nan),
        ("fitness", -1),
        ("descriptor", 2e4),
        ("base_to_object", -np.inf),
        ("joints", 1e30),
        ("nu", 8),
        ("penetration", -0.5),
    ],
)
def test_a_row_with_a_number_that_cannot_be_fails_alone(column: str, number: float) -> None:
    rows = SHAPE.empty(3)
    rows["outcome"], rows[column][1] = Outcome.MISSED, number
    failed = Failure(row=2, reason="the simulator crashed")
    read, rows = read_result(
        result_message(n=3, columns=deflated(pack(rows, RESULT)), failures=[failed]), SHAPE
    )
    assert [failure.row for failure in read.failures] == [1, 2]
    assert read.failures[0].reason.startswith(
        f"column '{column}' holds {np.float32(number):g}, expected a number from "
    )
    assert read.failures[1] == failed
    assert rows["outcome"][0] == Outcome.MISSED
    assert rows[1] == np.zeros((), SHAPE.dtype)


def test_all_rows_of_a_result_that_cannot_be_read_fail() -> None:
    read, rows = read_result(result_message(n=2, columns={"outcome": b"12"}), SHAPE)
    assert [failure.row for failure in read.failures] == [0, 1]
    assert not rows["outcome"].any()


def measured(seconds_per_row: float) -> BatchSizer:
    sizer = BatchSizer()
    for _ in range(3):
        sizer.measure(10, 10 * seconds_per_row)
    return sizer


def batches(sizer: BatchSizer, remaining: int, workers: int) -> list[int]:
    """The batches that a generation is cut into."""
    cut = []
    while remaining:
        cut.append(sizer.next_size(remaining, workers))
        remaining -= cut[-1]
    return cut


@pytest.mark.parametrize(
    ("cost", "rows"), [(0.0, MOST_ROWS), (1e-7, MOST_ROWS), (0.001, BATCH_SECONDS / 0.001), (3.0, 1)]
)
def test_a_batch_takes_about_a_quarter_of_a_second_and_has_a_row_and_not_too_many(cost, rows) -> None:
    size = measured(cost).next_size(1_000_000, 2)
    assert pytest.approx(rows, rel=0.02) == size <= MOST_ROWS


@pytest.mark.parametrize("workers", [1, 2, 7])
def test_the_end_of_a_generation_is_shared(workers: int) -> None:
    left = 500
    for rows in batches(measured(0.002), 500, workers):
        smallest = LEAST_SECONDS / 0.002
        assert rows <= max(-(-left // (2 * workers)), smallest)
        left -= rows
    assert left == 0


@pytest.mark.parametrize(
    ("turnarounds", "limit"),
    [
        ([], LEASE_SECONDS),
        ([2.0] * 95 + [60.0] * 5, 20.0),
        ([2.0] * 95 + [60.0] * 15, 600.0),
        ([60.0] * 300 + [0.1] * 300, LEASE_SECONDS),  # what was long ago is forgotten
    ],
)
def test_timeout_is_ten_times_the_turnaround_that_nineteen_of_twenty_keep(turnarounds, limit) -> None:
    timeout = LeaseTimeout()
    for seconds in turnarounds:
        timeout.measure(seconds)
    assert timeout.limit == limit


def test_runs_share_the_workers_so_each_cuts_for_its_part_of_them() -> None:
    sizer = BatchSizer()
    sizer.measure(10, 0.2)
    assert (
        sizer.next_size(500, 1000, runs=100) == 12
    )  # 0.25 s, less than half of the part of each of 10 workers
    assert sizer.next_size(500, 1000, runs=16) == 4
    assert sizer.next_size(500, 1000) == 1
