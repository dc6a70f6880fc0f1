from math import inf

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from qdgrasp_coordinator.recorder.run_writer import (
    GROUP_ROWS,
    GROUP_SECONDS,
    MOST_WAITING,
    Arrival,
    CommitQueue,
)
from qdgrasp_coordinator.storage.journal_slice import JournalSlice
from qdgrasp_protocol.rows import RowShape

SHAPE = RowShape(genes=1, joints=0)


def stretch(first: int, stop: int) -> JournalSlice:
    rows = SHAPE.empty(stop - first)
    rows["index"] = np.arange(first, stop)
    return JournalSlice(first, rows)


def numbers(intake: CommitQueue) -> list[int]:
    return [] if intake.group is None else intake.group.rows["index"].tolist()


def test_rows_that_follow_are_taken() -> None:
    intake = CommitQueue(epoch=1, durable=10)
    assert intake.offer(1, stretch(10, 12), 0.0) is Arrival.TAKEN
    assert intake.offer(1, stretch(12, 15), 0.0) is Arrival.TAKEN
    assert numbers(intake) == [10, 11, 12, 13, 14]
    assert (intake.expected, intake.durable) == (15, 10)


def test_of_rows_that_overlap_only_the_new_ones_are_taken() -> None:
    intake = CommitQueue(epoch=1, durable=10)
    intake.offer(1, stretch(10, 12), 0.0)
    assert intake.offer(1, stretch(5, 14), 0.0) is Arrival.TAKEN
    assert numbers(intake) == [10, 11, 12, 13]


def test_known_rows_and_no_rows_at_all_are_duplicates() -> None:
    intake = CommitQueue(epoch=1, durable=10)
    intake.offer(1, stretch(10, 12), 0.0)
    for first, stop in ((0, 5), (0, 10), (9, 12), (10, 11), (12, 12), (3, 3)):
        assert intake.offer(1, stretch(first, stop), 0.0) is Arrival.DUPLICATE
    assert numbers(intake) == [10, 11]


def test_rows_behind_a_gap_are_not_taken() -> None:
    intake = CommitQueue(epoch=1, durable=10)
    assert intake.offer(1, stretch(11, 12), 0.0) is Arrival.GAP
    assert intake.group is None


def test_a_replaced_coordinator_is_refused_and_a_newer_one_adopted() -> None:
    intake = CommitQueue(epoch=3, durable=0)
    assert intake.offer(2, stretch(0, 1), 0.0) is Arrival.STALE
    assert intake.offer(5, stretch(0, 1), 0.0) is Arrival.TAKEN
    assert intake.offer(3, stretch(1, 2), 0.0) is Arrival.STALE
    assert intake.epoch == 5


def test_a_group_is_due_when_its_first_row_has_waited_long_enough() -> None:
    intake = CommitQueue(epoch=1, durable=0)
    assert intake.deadline == inf
    intake.offer(1, stretch(0, 1), 100.0)
    intake.offer(1, stretch(1, 2), 100.2)
    assert intake.deadline == 100.0 + GROUP_SECONDS
    intake.committed()
    assert (intake.durable, intake.deadline, intake.group) == (2, inf, None)


def test_a_large_group_is_due_at_once() -> None:
    intake = CommitQueue(epoch=1, durable=7)
    intake.offer(1, stretch(7, 7 + GROUP_ROWS), 100.0)
    assert intake.deadline == -inf


def test_no_more_rows_wait_than_there_is_room_for() -> None:
    intake = CommitQueue(epoch=1, durable=0)
    assert intake.offer(1, stretch(0, MOST_WAITING), 0.0) is Arrival.TAKEN
    assert intake.offer(1, stretch(MOST_WAITING, MOST_WAITING + 1), 0.0) is Arrival.FULL
    intake.committed()
    assert intake.offer(1, stretch(MOST_WAITING, MOST_WAITING + 1), 0.0) is Arrival.TAKEN


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 40), st.booleans())))
def test_whatever_arrives_each_row_is_committed_once_and_in_order(
    offers: list[tuple[int, int, bool]],
) -> None:
    intake, committed = CommitQueue(epoch=1, durable=0), []
    for first, length, commit in [*offers, (0, 0, True)]:
        intake.offer(1, stretch(first, first + length), 0.0)
        if commit:
            committed += numbers(intake)
            intake.committed()
    assert committed == list(range(intake.durable))
