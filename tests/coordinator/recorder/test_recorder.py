from math import inf
from pathlib import Path

import pytest

from qdgrasp_coordinator.recorder.recorder import (
    REPORT_INTERVAL,
    REPORT_SECONDS,
    RETRY_INTERVAL,
    DiskSpaceRetry,
    ReportSchedule,
)
from qdgrasp_protocol.errors import DiskFull


def test_news_is_reported_at_once() -> None:
    reports = ReportSchedule()
    reports.news("a", 5.0)
    assert reports.deadline == 5.0
    assert reports.due(5.0) == ["a"]
    assert reports.due(5.0) == []


def test_a_run_that_was_heard_of_is_reported_each_second_for_a_while_and_no_longer() -> None:
    reports, said = ReportSchedule(), []
    reports.heard("a", 0.0)
    for tenth in range(10 * int(REPORT_SECONDS + 5)):
        said += [tenth / 10] * len(reports.due(tenth / 10))
    assert said == [REPORT_INTERVAL * n for n in range(1, int(REPORT_SECONDS / REPORT_INTERVAL) + 1)]
    assert reports.deadline == inf


def test_what_is_heard_of_often_is_not_reported_more_often() -> None:
    reports, said = ReportSchedule(), 0
    for tenth in range(100):
        reports.heard("a", tenth / 10)
        said += len(reports.due(tenth / 10))
    assert said == 9


def test_runs_are_reported_each_in_its_own_time() -> None:
    reports = ReportSchedule()
    reports.news("a", 0.0)
    reports.heard("b", 0.5)
    assert reports.due(0.5) == ["a"]
    assert sorted(reports.due(1.5)) == ["a", "b"]
    reports.news("a", 1.6)
    assert reports.due(1.6) == ["a"]


def test_a_run_that_was_forgotten_is_remembered_by_its_next_news() -> None:
    reports = ReportSchedule()
    reports.news("a", 0.0)
    while reports.deadline < inf:
        reports.due(reports.deadline)
    reports.news("a", 100.0)
    assert reports.due(100.0) == ["a"]


def test_all_that_are_remembered_can_be_repeated() -> None:
    reports = ReportSchedule()
    for run in "abc":
        reports.heard(run, 0.0)
    reports.repeat(0.1)
    assert sorted(reports.due(0.1)) == ["a", "b", "c"]


def test_a_full_disk_is_tried_again_and_given_up_after_the_patience() -> None:
    room = DiskSpaceRetry(Path("runs/mugs"), patience=10.0)
    for now in (100.0, 105.0, 110.0):
        room.missed("no room", now, "qdgrasp resume runs/mugs")
        assert (room.trouble, room.try_at) == ("no room", now + RETRY_INTERVAL)
    with pytest.raises(DiskFull, match=r"runs/mugs has had no room for 10 s.*`qdgrasp resume runs/mugs`"):
        room.missed("no room", 110.1, "qdgrasp resume runs/mugs")


def test_room_that_was_found_begins_the_patience_anew() -> None:
    room = DiskSpaceRetry(Path("runs/mugs"), patience=10.0)
    room.missed("no room", 100.0, "")
    room.found()
    assert (room.trouble, room.try_at) == ("", -inf)
    room.missed("no room", 200.0, "")
