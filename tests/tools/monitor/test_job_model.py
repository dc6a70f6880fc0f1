"""The model of jobs that a monitor builds from messages."""

from datetime import timedelta

import pytest
from msgspec import structs
from tests.tools.monitor.sample_jobs import (
    MUGS,
    NOON,
    START,
    event,
    figures,
    meta,
    publish,
    run,
    values,
    view_of,
    watching,
)

from qdgrasp_coordinator.metrics.job_status import JobEvents, to_json
from qdgrasp_protocol.keys import AnyJob
from qdgrasp_tools.monitor import job_model
from qdgrasp_tools.monitor.job_model import MAX_POINTS, JobModels, JobView, SeriesBuilder


@pytest.fixture
def jobs() -> JobModels:
    return watching()


def test_whoever_comes_late_sees_all_that_coordinators_answer() -> None:
    answers = values(workers=130) | {MUGS.recent: to_json(JobEvents(events=[event(1), event(2)]))}
    view = view_of(watching(answers=answers), START)
    assert (view.job, view.state, view.meta.epoch, view.figures.evaluations) == ("mugs", "running", 2, 1000)
    assert [one.run for one in view.runs] == ["a", "b"]
    assert len({one.wid for one in view.workers}) == len(view.workers) == 130
    assert [one.number for one in view.events] == [1, 2]


def test_what_is_heard_takes_the_place_of_what_was_heard_before(jobs: JobModels) -> None:
    for second in range(1, 5):
        job = figures(evaluations=1000 + second, seconds=10.0 + second)
        publish(
            jobs, START + second, stat_job=job, stat_run_a=run("a", evaluations=10 + second, cells=second)
        )
    view = view_of(jobs, START + 4)
    assert view.figures.evaluations == 1004
    assert [one.evaluations for one in view.runs] == [14, 10]
    assert view.history.evaluations == [1000, 1001, 1002, 1003, 1004]


def test_of_many_runs_those_that_are_over_are_forgotten_first_then_the_silent_ones(jobs: JobModels) -> None:
    publish(jobs, START + 2, stat_run_over=run("over", finished="all are spent"))
    for number in range(job_model.MOST_RUNS - 3):
        publish(jobs, START + 1, **{f"stat_run_r{number}": run(f"r{number}")})
    publish(jobs, START + 3, stat_run_a=run("a"), stat_run_new=run("new"))
    names = [one.run for one in view_of(jobs, START + 3).runs]
    assert (len(names), names[0], "b" in names, "over" in names) == (job_model.MOST_RUNS, "a", True, False)
    publish(jobs, START + 4, stat_run_newer=run("newer"))
    names = [one.run for one in view_of(jobs, START + 4).runs]
    assert (len(names), names[0], "b" in names) == (job_model.MOST_RUNS, "a", False)


def begins(jobs: JobModels, now: float, epoch: int, identity: str = "") -> None:
    """Another coordinator begins, as long after `NOON` as it is after the start."""
    since = NOON + timedelta(seconds=now - START)
    publish(jobs, now, meta=structs.replace(meta(epoch=epoch), since=since, identity=identity))


def finds(jobs: JobModels, now: float, count: int) -> JobView:
    """Return the view of a job whose coordinator publishes such counts."""
    found = {"evaluations": count, "successes": count, "cells": count, "seconds": 1.0}
    publish(jobs, now, stat_job=figures(**found), stat_run_a=run("a", **found, outcomes={"held": count}))
    return view_of(jobs, now)


def test_no_count_falls_where_one_goes_on() -> None:
    jobs = watching(answers={})
    steps = ((1, 2, 500, 500), (20, 0, 0, 500), (21, 3, 300, 500), (40, 4, 501, 501))
    for second, epoch, count, shown in steps:
        begins(jobs, START + second, epoch)
        view = finds(jobs, START + second, count)
        (one,) = view.runs
        counts = {view.figures.evaluations, view.figures.cells, one.evaluations, one.cells}
        assert counts | {one.outcomes["held"]} == {shown}
    assert view.history.evaluations == [500, 500, 500, 501]


def test_another_job_of_the_same_name_begins_with_nothing_of_the_old_one(jobs: JobModels) -> None:
    publish(jobs, START + 1, event_job=event(1), stat_run_old=run("old", evaluations=70, cells=9))
    publish(jobs, START + 2, stat_job=figures(evaluations=2000))
    begins(jobs, START + 60, 0)  # whose work it goes on with it does not know yet
    publish(jobs, START + 60, stat_job=figures(evaluations=0, state="starting"))
    assert "old" in [one.run for one in view_of(jobs, START + 60).runs]
    jobs.receive(MUGS.event("job"), to_json(event(60)), START + 60)
    begins(jobs, START + 60, 1)
    view = view_of(jobs, START + 60)
    assert (view.runs, view.workers, view.history.at) == ([], [], [])
    assert (view.figures.evaluations, [one.number for one in view.events]) == (0, [60])
    publish(jobs, START + 61, stat_job=figures(evaluations=3), stat_run_a=run("a", evaluations=3))
    assert view_of(jobs, START + 61).history.evaluations == [3]


@pytest.mark.parametrize("last", [{"runs_done": 3}, {"state": "cancelled"}])
def test_what_is_over_is_shown_as_it_is(jobs: JobModels, last: dict[str, object]) -> None:
    publish(jobs, START + 1, stat_run_a=run("a", cells=50))
    begins(jobs, START + 20, 3)
    publish(jobs, START + 20, stat_run_a=run("a", cells=40), stat_job=figures(cells=4))
    assert (view_of(jobs, START + 20).runs[0].cells, view_of(jobs, START + 20).figures.cells) == (50, 5)
    publish(jobs, START + 21, stat_job=figures(cells=4, **last))
    publish(jobs, START + 21, stat_run_a=run("a", cells=39))
    assert (view_of(jobs, START + 21).runs[0].cells, view_of(jobs, START + 21).figures.cells) == (39, 4)


def test_when_the_router_is_back_everything_is_asked_and_nothing_while_it_is_away(jobs: JobModels) -> None:
    jobs.link_changed(False, START)
    jobs.coordinator_changed(MUGS.coordinator_token(3), True, START + 1)
    assert jobs.due_queries(START + 1) == []
    jobs.link_changed(True, START + 2)
    assert AnyJob().meta in jobs.due_queries(START + 2)


def test_a_coordinator_that_says_nothing_is_silent_and_is_heard_again(jobs: JobModels) -> None:
    view = view_of(jobs, START + job_model.SILENCE_SECONDS + 1)
    assert (view.state, view.silent) == ("silent", job_model.SILENCE_SECONDS + 1)
    publish(jobs, START + 20, stat_job=figures())
    assert view_of(jobs, START + 21).state == "running"


def test_a_coordinator_whose_token_vanishes_is_gone_at_once(jobs: JobModels) -> None:
    jobs.coordinator_changed(MUGS.coordinator_token(2), False, START + 1)
    publish(jobs, START + 1.5, stat_job=figures())  # it was on its way
    assert view_of(jobs, START + 2).state == "gone"


def test_another_coordinator_goes_on_with_a_job(jobs: JobModels) -> None:
    jobs.coordinator_changed(MUGS.coordinator_token(2), False, START + 1)
    publish(jobs, START + 9, meta=meta(epoch=0), stat_job=figures(state="starting"))
    assert view_of(jobs, START + 9).state == "starting"
    jobs.coordinator_changed(MUGS.coordinator_token(3), True, START + 10)
    jobs.receive_answers(values(epoch=3), START + 10)
    assert (view_of(jobs, START + 10).state, view_of(jobs, START + 10).meta.epoch) == ("running", 3)


@pytest.mark.parametrize("news", [("link", "token"), ("token", "link")])
def test_while_the_router_is_away_nobody_knows_whether_a_coordinator_is_there(jobs, news) -> None:
    for one in news:
        if one == "link":
            jobs.link_changed(False, START + 1)
        else:
            jobs.coordinator_changed(MUGS.coordinator_token(2), False, START + 1)
    assert view_of(jobs, START + 60).state == "silent"
    jobs.link_changed(True, START + 61)
    jobs.coordinator_changed(MUGS.coordinator_token(2), True, START + 61)
    publish(jobs, START + 61, stat_job=figures())
    assert view_of(jobs, START + 62).state == "running"


def test_what_cannot_be_read_is_passed_over() -> None:
    jobs = JobModels()
    jobs.receive(MUGS.stat("job"), b'{"job": "mugs", "figures": "quite other ones"}', START)
    assert jobs.views(START) == []


def test_the_columns_of_a_history_are_of_one_length_and_bounded() -> None:
    history = SeriesBuilder()
    for second in range(3 * MAX_POINTS):
        history.add(figures(evaluations=second, seconds=float(second)), float(second))
    series = history.series
    assert {len(getattr(series, name)) for name in series.__struct_fields__} == {len(series.at)}
    assert len(series.at) <= MAX_POINTS
    assert (series.at[0], series.at[-1]) == (0.0, 3.0 * MAX_POINTS - 1)
    gaps = [after - before for before, after in zip(series.at, series.at[1:], strict=False)]
    assert max(gaps) <= 4 * 3
    assert series.evaluations[-1] == 3 * MAX_POINTS - 1


def test_a_coordinator_that_begins_to_count_anew_makes_no_rate_negative_or_huge() -> None:
    history = SeriesBuilder()
    for second in range(120):
        history.add(figures(seconds=float(second % 60), rate=10.0), 1000.0 + second)
    assert max(history.series.rate) == pytest.approx(10.0)
    assert min(history.series.rate) >= 0.0
