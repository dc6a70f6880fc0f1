"""What a monitor asks, and when."""

from tests.coordinator.monitor.heard import MUGS, START, told, watching
from tests.coordinator.monitor.shown import curve, figures, meta, run, values

from qdgrasp_coordinator.counts.figures import to_json
from qdgrasp_coordinator.monitor.job import AGAIN, SILENCE
from qdgrasp_coordinator.monitor.jobs import Jobs
from qdgrasp_protocol.keys import AnyJob, Keys


def test_at_first_everything_is_asked_once() -> None:
    jobs, any_job = Jobs(), AnyJob()
    asked = [any_job.stat(), any_job.stat("curve/*"), any_job.meta, any_job.recent]
    assert jobs.questions(START) == asked
    assert jobs.questions(START + 60) == []


def test_a_coordinator_that_appears_is_asked() -> None:
    jobs = watching()
    assert jobs.questions(START + 1) == []
    jobs.token(MUGS.coordinator_token(3), True, START + 2)
    assert MUGS.stat() in jobs.questions(START + 2)


def test_when_the_router_is_back_everything_is_asked_and_nothing_while_it_is_away() -> None:
    jobs = watching()
    jobs.linked(False, START)
    jobs.token(MUGS.coordinator_token(3), True, START + 1)
    assert jobs.questions(START + 1) == []
    jobs.linked(True, START + 2)
    assert AnyJob().meta in jobs.questions(START + 2)


def test_a_job_of_which_too_little_is_known_is_asked_again_now_and_then() -> None:
    jobs = Jobs()
    jobs.questions(START)
    told(jobs, START + 1, stat_job=figures())
    assert MUGS.meta in jobs.questions(START + 1)
    told(jobs, START + 1.5, stat_job=figures())
    assert jobs.questions(START + 1.5) == []
    assert MUGS.meta in jobs.questions(START + 1 + AGAIN)
    jobs.answered(values(), START + 7)
    assert not set(jobs.questions(START + 60)) & {MUGS.meta, MUGS.stat()}


def test_the_curve_of_a_run_that_was_not_seen_from_its_beginning_on_is_asked_for_until_it_comes() -> None:
    jobs = Jobs()
    jobs.questions(START)
    jobs.answered({MUGS.meta: to_json(meta()), MUGS.stat("job"): to_json(figures())}, START)
    told(
        jobs,
        START,
        stat_run_new=run("new", evaluations=0),
        stat_run_resumed=run("resumed", evaluations=70),
    )
    asked = [MUGS.stat("curve/resumed")]
    assert jobs.questions(START) == asked
    jobs.answered({}, START + 1)  # it did not come in time
    told(jobs, START + AGAIN, stat_job=figures())
    assert (jobs.questions(START + 1), jobs.questions(START + AGAIN)) == ([], asked)
    jobs.answered({MUGS.stat("curve/resumed"): to_json(curve("resumed", 5, 70))}, START + 6)
    told(jobs, START + 60, stat_job=figures())
    assert jobs.questions(START + 60) == []


def test_curves_are_asked_for_also_when_another_job_begins() -> None:
    jobs = watching()
    told(jobs, START, stat_run_resumed=run("resumed", evaluations=70))
    jobs.token(Keys("cubes").coordinator_token(1), True, START)
    asked = jobs.questions(START)
    assert {MUGS.stat("curve/resumed"), Keys("cubes").meta} <= {*asked}


def test_many_curves_are_one_question() -> None:
    jobs = watching()
    for name in ("c", "d"):
        told(jobs, START, **{f"stat_run_{name}": run(name)})
    assert jobs.questions(START) == [MUGS.stat("curve/*")]


def test_curves_that_nobody_has_any_more_are_not_asked_for() -> None:
    jobs = Jobs()
    jobs.questions(START)
    answers = {key: value for key, value in values().items() if "run" not in key}
    jobs.answered(answers, START)
    told(jobs, START, stat_run_c=run("c", finished="all are spent"))
    assert jobs.questions(START) == []
    told(jobs, START, stat_run_d=run("d"))
    assert jobs.questions(START + 2 * SILENCE) == []
