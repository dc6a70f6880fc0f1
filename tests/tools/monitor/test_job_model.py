"""The model of jobs that a monitor builds from messages."""

from datetime import timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs
from tests.tools.monitor.sample_jobs import (
    MUGS,
    NOON,
    START,
    curve,
    event,
    figures,
    meta,
    publish,
    run,
    team,
    values,
    view_of,
    watching,
    worker,
)

from qdgrasp_coordinator.metrics.job_status import EVENTS_KEPT, JobEvents, to_json
from qdgrasp_protocol.keys import AnyJob, Keys
from qdgrasp_tools.monitor import job_model
from qdgrasp_tools.monitor.job_model import JobModels
from qdgrasp_tools.monitor.job_view import JobView


@pytest.fixture
def jobs() -> JobModels:
    return watching()


def test_whoever_comes_late_sees_all_that_coordinators_answer() -> None:
    more = {MUGS.stat("curve/a"): curve("a", 2, 5, 9), MUGS.recent: JobEvents(events=[event(1), event(2)])}
    answers = values(workers=130) | {key: to_json(value) for key, value in more.items()}
    view = view_of(watching(answers=answers), START)
    assert (view.job, view.state, view.meta.epoch, view.figures.evaluations) == ("mugs", "running", 2, 1000)
    assert [one.run for one in view.runs] == ["a", "b"]
    assert len({one.wid for one in view.workers}) == len(view.workers) == 130
    assert [one.number for one in view.events] == [1, 2]
    assert [point.evaluations for point in view.curves["a"].points] == [2, 5, 9, 10]
    assert [point.evaluations for point in view.curves["b"].points] == [10]


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
    assert view.histories["a"].cells == [0, 1, 2, 3, 4]
    assert [point.cells for point in view.curves["a"].points] == [0, 1, 2, 3, 4]


def test_two_jobs_are_told_apart() -> None:
    jobs = watching(answers=values("mugs") | values("cubes", runs=7))
    jobs.receive(Keys("cubes").stat("job"), to_json(figures(job="cubes", evaluations=2000)), START)
    seen = [(view.job, view.figures.evaluations) for view in jobs.views(START)]
    assert seen == [("cubes", 2000), ("mugs", 1000)]


def test_pages_of_a_team_that_are_no_more_are_forgotten() -> None:
    jobs = watching(answers=values(workers=200))
    (page,) = team(worker(1), worker(2))
    publish(jobs, START, stat_team_0=page)
    assert len(view_of(jobs, START).workers) == 2


def test_a_worker_on_two_pages_is_shown_once() -> None:
    jobs = watching(answers=values(workers=200))
    before = view_of(jobs, START).workers
    pages = team(*(before[64:65] + before[:63] + before[64:]))  # one went from the second to the first
    publish(jobs, START, stat_team_0=pages[0])
    wids = [one.wid for one in view_of(jobs, START).workers]
    assert len(wids) == len({*wids})
    assert before[64].wid in wids


def test_events_that_are_told_twice_are_shown_once_in_their_order(jobs: JobModels) -> None:
    for number in (3, 1, 2, 3):
        publish(jobs, START, event_job=event(number))
    publish(jobs, START, event_recent=JobEvents(events=[event(2), event(4)]))
    assert [one.number for one in view_of(jobs, START).events] == [1, 2, 3, 4]


def test_what_is_remembered_is_bounded(jobs: JobModels) -> None:
    for number in range(job_model.MOST_RUNS + 5):
        publish(jobs, START, event_job=event(number), **{f"stat_run_r{number}": run(f"r{number}")})
    view = view_of(jobs, START)
    assert len(view.runs) == len(view.curves) == job_model.MOST_RUNS
    assert len(view.events) == EVENTS_KEPT
    for number in range(job_model.MAX_JOBS + 5):
        jobs.receive_answers(values(f"job-{number}"), START)
    assert len(jobs.views(START)) == job_model.MAX_JOBS


def test_the_job_that_is_forgotten_is_the_one_that_was_silent_for_longest() -> None:
    jobs = JobModels()
    for number in range(job_model.MAX_JOBS):
        jobs.receive_answers(values(f"job-{number:02}"), START + number)
    jobs.receive(Keys("job-00").stat("job"), to_json(figures(job="job-00")), START + job_model.MAX_JOBS)
    jobs.receive_answers(values("new"), START + job_model.MAX_JOBS)
    names = {view.job for view in jobs.views(START + job_model.MAX_JOBS)}
    assert (len(names), names & {"job-00", "job-01", "new"}) == (job_model.MAX_JOBS, {"job-00", "new"})


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


def test_what_is_left_out_where_not_all_runs_can_be_shown_is_over_or_silent(jobs: JobModels) -> None:
    publish(jobs, START + 1, stat_run_c=run("c", finished="all are spent"), stat_run_d=run("d"))
    publish(jobs, START + 2, stat_run_a=run("a"))
    view = view_of(jobs, START + 2)
    assert [one.run for one in view.runs] == ["a", "b", "c", "d"]
    assert ["".join(one.run for one in view.foremost(most)) for most in (1, 2, 3)] == ["a", "ad", "abd"]


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
    assert view.histories["a"].successes == [500, 500, 500, 501]


def test_what_remains_does_not_rise_while_runs_are_opened_again(jobs: JobModels) -> None:
    for second, count in enumerate((2400, 0, 900, 2500), 1):
        told = figures(evaluations=count, budget=3000, remaining=3000 - count)
        publish(jobs, START + second, stat_job=told)
        one = view_of(jobs, START + second).figures
        assert (one.remaining, one.done) == (3000 - one.evaluations, one.evaluations / 3000)


def test_what_a_coordinator_counts_of_itself_begins_anew(jobs: JobModels) -> None:
    publish(jobs, START + 1, stat_job=figures(requeued=7, waiting=50))
    begins(jobs, START + 20, 3)
    publish(jobs, START + 20, stat_job=figures(requeued=1, waiting=2))
    one = view_of(jobs, START + 20).figures
    assert (one.requeued, one.waiting) == (1, 2)


def test_another_job_of_the_same_name_begins_with_nothing_of_the_old_one(jobs: JobModels) -> None:
    publish(jobs, START + 1, event_job=event(1), stat_run_old=run("old", evaluations=70, cells=9))
    publish(jobs, START + 2, stat_job=figures(evaluations=2000))
    begins(jobs, START + 60, 0)  # whose work it goes on with it does not know yet
    publish(jobs, START + 60, stat_job=figures(evaluations=0, state="starting"))
    assert "old" in view_of(jobs, START + 60).curves
    jobs.receive(MUGS.event("job"), to_json(event(60)), START + 60)
    begins(jobs, START + 60, 1)
    view = view_of(jobs, START + 60)
    assert (view.runs, view.curves, view.workers, view.history.at) == ([], {}, [], [])
    assert (view.figures.evaluations, [one.number for one in view.events]) == (0, [60])
    publish(jobs, START + 61, stat_job=figures(evaluations=3), stat_run_a=run("a", evaluations=3))
    view = view_of(jobs, START + 61)
    assert (view.history.evaluations, [point.evaluations for point in view.curves["a"].points]) == ([3], [3])


@pytest.mark.parametrize(
    ("identities", "epoch", "shown"),
    [
        (("a", "b"), 9, 300),  # another folder, which has seen more turns
        (("a", "a"), 1, 500),  # the same one, restored from a copy
        (("", "b"), 9, 500),
        (("a", ""), 9, 500),
        (("", ""), 1, 300),
    ],
)
def test_a_job_is_known_by_its_identity_and_by_its_turns_where_it_has_none(identities, epoch, shown) -> None:
    jobs = watching(answers={})
    for identity, turn, count in zip(identities, (2, epoch), (500, 300), strict=True):
        begins(jobs, START + count, 0)
        begins(jobs, START + count, turn, identity)
        view = finds(jobs, START + count, count)
    assert (view.figures.evaluations, view.runs[0].evaluations) == (shown, shown)


def test_answers_of_another_job_take_the_place_of_all_that_was_heard_of_the_old_one(jobs: JobModels) -> None:
    publish(jobs, START + 1, stat_run_a=run("a", evaluations=900))
    since = structs.replace(meta(epoch=1), since=NOON + timedelta(seconds=60))
    answers = {key: value for key, value in values().items() if key != MUGS.meta}
    jobs.receive_answers(answers | {MUGS.meta: to_json(since)}, START + 60)
    view = view_of(jobs, START + 60)
    assert [(one.run, one.evaluations) for one in view.runs] == [("a", 10), ("b", 10)]


@pytest.mark.parametrize("last", [{"runs_done": 3}, {"state": "cancelled"}])
def test_what_is_over_is_shown_as_it_is(jobs: JobModels, last: dict[str, object]) -> None:
    publish(jobs, START + 1, stat_run_a=run("a", cells=50))
    begins(jobs, START + 20, 3)
    publish(jobs, START + 20, stat_run_a=run("a", cells=40), stat_job=figures(cells=4))
    assert (view_of(jobs, START + 20).runs[0].cells, view_of(jobs, START + 20).figures.cells) == (50, 5)
    publish(jobs, START + 21, stat_job=figures(cells=4, **last))
    assert (view_of(jobs, START + 21).runs[0].cells, view_of(jobs, START + 21).figures.cells) == (40, 4)
    publish(jobs, START + 21, stat_run_a=run("a", cells=39))
    assert view_of(jobs, START + 21).runs[0].cells == 39


def test_a_run_that_is_over_is_shown_as_it_is(jobs: JobModels) -> None:
    publish(jobs, START + 1, stat_run_a=run("a", cells=50))
    publish(jobs, START + 2, stat_run_a=run("a", cells=40, finished="all are spent"))
    assert view_of(jobs, START + 2).runs[0].cells == 40


def test_at_first_everything_is_asked_once() -> None:
    jobs, any_job = JobModels(), AnyJob()
    asked = [any_job.stat(), any_job.stat("curve/*"), any_job.meta, any_job.recent]
    assert jobs.due_queries(START) == asked
    assert jobs.due_queries(START + 60) == []


def test_a_coordinator_that_appears_is_asked(jobs: JobModels) -> None:
    assert jobs.due_queries(START + 1) == []
    jobs.coordinator_changed(MUGS.coordinator_token(3), True, START + 2)
    assert MUGS.stat() in jobs.due_queries(START + 2)


def test_when_the_router_is_back_everything_is_asked_and_nothing_while_it_is_away(jobs: JobModels) -> None:
    jobs.link_changed(False, START)
    jobs.coordinator_changed(MUGS.coordinator_token(3), True, START + 1)
    assert jobs.due_queries(START + 1) == []
    jobs.link_changed(True, START + 2)
    assert AnyJob().meta in jobs.due_queries(START + 2)


def test_a_job_of_which_too_little_is_known_is_asked_again_now_and_then() -> None:
    jobs = JobModels()
    jobs.due_queries(START)
    publish(jobs, START + 1, stat_job=figures())
    assert MUGS.meta in jobs.due_queries(START + 1)
    publish(jobs, START + 1.5, stat_job=figures())
    assert jobs.due_queries(START + 1.5) == []
    assert MUGS.meta in jobs.due_queries(START + 1 + job_model.RETRY_SECONDS)
    jobs.receive_answers(values(), START + 7)
    assert not set(jobs.due_queries(START + 60)) & {MUGS.meta, MUGS.stat()}


def test_the_curve_of_a_run_that_was_not_seen_from_its_beginning_on_is_asked_for_until_it_comes() -> None:
    jobs = JobModels()
    jobs.due_queries(START)
    jobs.receive_answers({MUGS.meta: to_json(meta()), MUGS.stat("job"): to_json(figures())}, START)
    publish(jobs, START, stat_run_new=run("new", evaluations=0))
    publish(jobs, START, stat_run_resumed=run("resumed", evaluations=70))
    asked = [MUGS.stat("curve/resumed")]
    assert jobs.due_queries(START) == asked
    jobs.receive_answers({}, START + 1)  # it did not come in time
    publish(jobs, START + job_model.RETRY_SECONDS, stat_job=figures())
    assert (jobs.due_queries(START + 1), jobs.due_queries(START + job_model.RETRY_SECONDS)) == ([], asked)
    jobs.receive_answers({MUGS.stat("curve/resumed"): to_json(curve("resumed", 5, 70))}, START + 6)
    publish(jobs, START + 60, stat_job=figures())
    assert jobs.due_queries(START + 60) == []


def test_curves_are_asked_for_also_when_another_job_begins(jobs: JobModels) -> None:
    publish(jobs, START, stat_run_resumed=run("resumed", evaluations=70))
    jobs.coordinator_changed(Keys("cubes").coordinator_token(1), True, START)
    assert {MUGS.stat("curve/resumed"), Keys("cubes").meta} <= {*jobs.due_queries(START)}


def test_many_curves_are_one_question(jobs: JobModels) -> None:
    for name in ("c", "d"):
        publish(jobs, START, **{f"stat_run_{name}": run(name)})
    assert jobs.due_queries(START) == [MUGS.stat("curve/*")]


def test_curves_that_nobody_has_any_more_are_not_asked_for() -> None:
    jobs = JobModels()
    jobs.due_queries(START)
    jobs.receive_answers({key: value for key, value in values().items() if "run" not in key}, START)
    publish(jobs, START, stat_run_c=run("c", finished="all are spent"))
    assert jobs.due_queries(START) == []
    publish(jobs, START, stat_run_d=run("d"))
    assert jobs.due_queries(START + 2 * job_model.SILENCE_SECONDS) == []


def test_a_job_is_what_its_coordinator_says_while_it_speaks() -> None:
    jobs = watching(answers=values(state="paused"))
    assert view_of(jobs, START + job_model.SILENCE_SECONDS).state == "paused"


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


def test_a_token_of_an_epoch_that_is_over_takes_nothing_away(jobs: JobModels) -> None:
    jobs.coordinator_changed(MUGS.coordinator_token(3), True, START + 1)
    jobs.coordinator_changed(MUGS.coordinator_token(2), False, START + 2)
    assert view_of(jobs, START + 2).state == "running"


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
def test_how_a_job_ended_is_told_by_what_its_coordinator_said_last(jobs, last, state) -> None:
    publish(jobs, START + 1, stat_job=figures(**last))
    jobs.coordinator_changed(MUGS.coordinator_token(2), False, START + 1.1)
    assert view_of(jobs, START + 2).state == state


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


def test_a_coordinator_that_does_not_come_back_with_the_router_is_gone(jobs: JobModels) -> None:
    jobs.link_changed(False, START + 1)
    jobs.coordinator_changed(MUGS.coordinator_token(2), False, START + 1)
    jobs.link_changed(True, START + 60)
    assert view_of(jobs, START + 61).state == "silent"
    assert view_of(jobs, START + 60 + job_model.SILENCE_SECONDS + 1).state == "gone"


STATS = [f"stat/{name}" for name in ("job", "run/a", "team/0", "curve/a")]
PLACES = ("", "x", "meta", *STATS, "event/job", "event/recent")


@given(st.binary(max_size=200), st.sampled_from(PLACES))
def test_what_is_no_message_changes_nothing(payload: bytes, place: str) -> None:
    jobs = watching()
    before = view_of(jobs, START)
    jobs.receive(f"{MUGS.root}/{place}", payload, START)
    assert view_of(jobs, START) == before


@pytest.mark.parametrize(
    "key", ["", "else/where", "qdgrasp/v1/BAD NAME/stat/job", "qdgrasp/v2/mugs/stat/job"]
)
def test_keys_of_others_are_left_alone(key: str) -> None:
    jobs = JobModels()
    jobs.receive(key, to_json(figures()), START)
    jobs.coordinator_changed(key, True, START)
    assert (jobs.views(START), jobs.foreign_jobs) == ([], [])


def test_a_job_of_another_version_is_named_until_it_can_be_read() -> None:
    jobs = JobModels()
    jobs.receive(MUGS.stat("job"), b'{"job": "mugs", "figures": "quite other ones"}', START)
    assert (jobs.views(START), jobs.foreign_jobs) == ([], ["mugs"])
    jobs.receive_answers(values(), START)
    assert (len(jobs.views(START)), jobs.foreign_jobs) == (1, [])


def test_fields_that_a_later_version_adds_are_passed_over(jobs: JobModels) -> None:
    later = to_json(figures(evaluations=2000)).replace(b'{"job"', b'{"mood": "good", "job"', 1)
    jobs.receive(MUGS.stat("job"), later, START)
    assert view_of(jobs, START).figures.evaluations == 2000
