"""What a monitor says a job is about."""

import pytest
from tests.coordinator.monitor.heard import MUGS, START, seen, told, watching
from tests.coordinator.monitor.shown import figures, meta, values

from qdgrasp_coordinator.monitor.job import SILENCE


def test_a_job_is_what_its_coordinator_says_while_it_speaks() -> None:
    jobs = watching(answers=values(state="paused"))
    assert seen(jobs, START + SILENCE).state == "paused"


def test_a_coordinator_that_says_nothing_is_silent_and_is_heard_again() -> None:
    jobs = watching()
    view = seen(jobs, START + SILENCE + 1)
    assert (view.state, view.silent) == ("silent", SILENCE + 1)
    told(jobs, START + 20, stat_job=figures())
    assert seen(jobs, START + 21).state == "running"


def test_a_coordinator_whose_token_vanishes_is_gone_at_once() -> None:
    jobs = watching()
    jobs.token(MUGS.coordinator_token(2), False, START + 1)
    told(jobs, START + 1.5, stat_job=figures())  # it was on its way
    assert seen(jobs, START + 2).state == "gone"


def test_another_coordinator_goes_on_with_a_job() -> None:
    jobs = watching()
    jobs.token(MUGS.coordinator_token(2), False, START + 1)
    told(jobs, START + 9, meta=meta(epoch=0), stat_job=figures(state="starting"))
    assert seen(jobs, START + 9).state == "starting"
    jobs.token(MUGS.coordinator_token(3), True, START + 10)
    jobs.answered(values(epoch=3), START + 10)
    assert (seen(jobs, START + 10).state, seen(jobs, START + 10).meta.epoch) == ("running", 3)


def test_a_token_of_an_epoch_that_is_over_takes_nothing_away() -> None:
    jobs = watching()
    jobs.token(MUGS.coordinator_token(3), True, START + 1)
    jobs.token(MUGS.coordinator_token(2), False, START + 2)
    assert seen(jobs, START + 2).state == "running"


@pytest.mark.parametrize(
    ("last", "state"),
    [
        ({"runs_done": 3}, "ended"),
        ({"runs_done": 2, "runs_failed": 1}, "ended"),
        ({"runs_done": 3, "state": "ending"}, "ended"),
        ({"state": "cancelled"}, "cancelled"),
        ({"state": "ending"}, "gone"),  # it died while it waited for the last rows to be recorded
        ({"state": "paused"}, "gone"),
    ],
)
def test_how_a_job_ended_is_told_by_what_its_coordinator_said_last(
    last: dict[str, object], state: str
) -> None:
    jobs = watching()
    told(jobs, START + 1, stat_job=figures(**last))
    jobs.token(MUGS.coordinator_token(2), False, START + 1.1)
    assert seen(jobs, START + 2).state == state


@pytest.mark.parametrize("news", [("link", "token"), ("token", "link")])
def test_while_the_router_is_away_nobody_knows_whether_a_coordinator_is_there(news: tuple[str, str]) -> None:
    jobs = watching()
    for one in news:
        if one == "link":
            jobs.linked(False, START + 1)
        else:
            jobs.token(MUGS.coordinator_token(2), False, START + 1)
    assert seen(jobs, START + 60).state == "silent"
    jobs.linked(True, START + 61)
    jobs.token(MUGS.coordinator_token(2), True, START + 61)
    told(jobs, START + 61, stat_job=figures())
    assert seen(jobs, START + 62).state == "running"


def test_a_coordinator_that_does_not_come_back_with_the_router_is_gone() -> None:
    jobs = watching()
    jobs.linked(False, START + 1)
    jobs.token(MUGS.coordinator_token(2), False, START + 1)
    jobs.linked(True, START + 60)
    assert seen(jobs, START + 61).state == "silent"
    assert seen(jobs, START + 60 + SILENCE + 1).state == "gone"
