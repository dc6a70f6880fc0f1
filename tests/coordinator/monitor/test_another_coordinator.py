"""What becomes of a job's counts and curves when another coordinator tells of it."""

from datetime import timedelta

import pytest
from msgspec import structs
from tests.coordinator.monitor.heard import MUGS, START, seen, told, watching
from tests.coordinator.monitor.shown import NOON, event, figures, meta, run, values

from qdgrasp_coordinator.counts.figures import to_json
from qdgrasp_coordinator.monitor.jobs import Jobs, JobView


def begins(jobs: Jobs, now: float, epoch: int, identity: str = "") -> None:
    """Another coordinator begins, as long after `NOON` as it is after the start."""
    since = NOON + timedelta(seconds=now - START)
    told(jobs, now, meta=structs.replace(meta(epoch=epoch), since=since, identity=identity))


def finds(jobs: Jobs, now: float, count: int) -> JobView:
    """What is seen where a coordinator says that so much was found."""
    found = {"evaluations": count, "successes": count, "cells": count, "seconds": 1.0}
    told(jobs, now, stat_job=figures(**found), stat_run_a=run("a", **found, outcomes={"held": count}))
    return seen(jobs, now)


def test_no_count_falls_where_one_goes_on() -> None:
    jobs = watching(answers={})
    for second, epoch, count, shown in (
        (1, 2, 500, 500),
        (20, 0, 0, 500),
        (21, 3, 300, 500),
        (40, 4, 501, 501),
    ):
        begins(jobs, START + second, epoch)
        view = finds(jobs, START + second, count)
        (one,) = view.runs
        counts = {view.figures.evaluations, view.figures.cells, one.evaluations, one.cells}
        assert counts | {one.outcomes["held"]} == {shown}
    assert view.history.evaluations == [500, 500, 500, 501]
    assert view.histories["a"].successes == [500, 500, 500, 501]


def test_what_remains_does_not_rise_while_runs_are_opened_again() -> None:
    jobs = watching()
    for second, count in enumerate((2400, 0, 900, 2500), 1):
        told(jobs, START + second, stat_job=figures(evaluations=count, budget=3000, remaining=3000 - count))
        one = seen(jobs, START + second).figures
        assert (one.remaining, one.done) == (3000 - one.evaluations, one.evaluations / 3000)


def test_what_a_coordinator_counts_of_itself_begins_anew() -> None:
    jobs = watching()
    told(jobs, START + 1, stat_job=figures(requeued=7, waiting=50))
    begins(jobs, START + 20, 3)
    told(jobs, START + 20, stat_job=figures(requeued=1, waiting=2))
    one = seen(jobs, START + 20).figures
    assert (one.requeued, one.waiting) == (1, 2)


def test_another_job_of_the_same_name_begins_with_nothing_of_the_old_one() -> None:
    jobs = watching()
    told(jobs, START + 1, event_job=event(1), stat_run_old=run("old", evaluations=70, cells=9))
    told(jobs, START + 2, stat_job=figures(evaluations=2000))
    begins(jobs, START + 60, 0)  # whose work it goes on with it does not know yet
    told(jobs, START + 60, stat_job=figures(evaluations=0, state="starting"))
    assert "old" in seen(jobs, START + 60).curves
    jobs.heard(MUGS.event("job"), to_json(event(60)), START + 60)
    begins(jobs, START + 60, 1)
    view = seen(jobs, START + 60)
    assert (view.runs, view.curves, view.workers, view.history.at) == ([], {}, [], [])
    assert (view.figures.evaluations, [one.number for one in view.events]) == (0, [60])
    told(jobs, START + 61, stat_job=figures(evaluations=3), stat_run_a=run("a", evaluations=3))
    view = seen(jobs, START + 61)
    assert (view.history.evaluations, [point.evaluations for point in view.curves["a"].points]) == (
        [3],
        [3],
    )


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
def test_a_job_is_known_by_its_identity_and_by_its_turns_where_it_has_none(
    identities: tuple[str, str], epoch: int, shown: int
) -> None:
    jobs = watching(answers={})
    for identity, turn, count in zip(identities, (2, epoch), (500, 300), strict=True):
        begins(jobs, START + count, 0)
        begins(jobs, START + count, turn, identity)
        view = finds(jobs, START + count, count)
    assert (view.figures.evaluations, view.runs[0].evaluations) == (shown, shown)


def test_answers_of_another_job_take_the_place_of_all_that_was_heard_of_the_old_one() -> None:
    jobs = watching()
    told(jobs, START + 1, stat_run_a=run("a", evaluations=900))
    since = structs.replace(meta(epoch=1), since=NOON + timedelta(seconds=60))
    answers = {key: value for key, value in values().items() if key != MUGS.meta}
    jobs.answered(answers | {MUGS.meta: to_json(since)}, START + 60)
    view = seen(jobs, START + 60)
    assert [(one.run, one.evaluations) for one in view.runs] == [("a", 10), ("b", 10)]


@pytest.mark.parametrize("last", [{"runs_done": 3}, {"state": "cancelled"}])
def test_what_is_over_is_shown_as_it_is(last: dict[str, object]) -> None:
    jobs = watching()
    told(jobs, START + 1, stat_run_a=run("a", cells=50))
    begins(jobs, START + 20, 3)
    told(jobs, START + 20, stat_run_a=run("a", cells=40), stat_job=figures(cells=4))
    assert (seen(jobs, START + 20).runs[0].cells, seen(jobs, START + 20).figures.cells) == (50, 5)
    told(jobs, START + 21, stat_job=figures(cells=4, **last))
    assert (seen(jobs, START + 21).runs[0].cells, seen(jobs, START + 21).figures.cells) == (40, 4)
    told(jobs, START + 21, stat_run_a=run("a", cells=39))
    assert seen(jobs, START + 21).runs[0].cells == 39


def test_a_run_that_is_over_is_shown_as_it_is() -> None:
    jobs = watching()
    told(jobs, START + 1, stat_run_a=run("a", cells=50))
    told(jobs, START + 2, stat_run_a=run("a", cells=40, finished="all are spent"))
    assert seen(jobs, START + 2).runs[0].cells == 40
