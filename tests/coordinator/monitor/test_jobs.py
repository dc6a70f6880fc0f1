"""What is known of jobs by whoever only listens."""

from tests.coordinator.monitor.heard import MUGS, START, seen, told, watching
from tests.coordinator.monitor.shown import curve, event, figures, run, team, values, worker

from qdgrasp_coordinator.counts.events import KEPT, Events
from qdgrasp_coordinator.counts.figures import to_json
from qdgrasp_coordinator.monitor.job import MOST_RUNS
from qdgrasp_coordinator.monitor.jobs import MOST, Jobs
from qdgrasp_protocol.keys import Keys


def test_whoever_comes_late_sees_all_that_coordinators_answer() -> None:
    more = {MUGS.stat("curve/a"): curve("a", 2, 5, 9), MUGS.recent: Events(events=[event(1), event(2)])}
    answers = values(workers=130) | {key: to_json(value) for key, value in more.items()}
    view = seen(watching(answers=answers), START)
    assert (view.job, view.state, view.meta.epoch, view.figures.evaluations) == (
        "mugs",
        "running",
        2,
        1000,
    )
    assert [one.run for one in view.runs] == ["a", "b"]
    assert len({one.wid for one in view.workers}) == len(view.workers) == 130
    assert [one.number for one in view.events] == [1, 2]
    assert [point.evaluations for point in view.curves["a"].points] == [2, 5, 9, 10]
    assert [point.evaluations for point in view.curves["b"].points] == [10]


def test_what_is_heard_takes_the_place_of_what_was_heard_before() -> None:
    jobs = watching()
    for second in range(1, 5):
        told(
            jobs,
            START + second,
            stat_job=figures(evaluations=1000 + second, seconds=10.0 + second),
            stat_run_a=run("a", evaluations=10 + second, cells=second),
        )
    view = seen(jobs, START + 4)
    assert view.figures.evaluations == 1004
    assert [one.evaluations for one in view.runs] == [14, 10]
    assert view.history.evaluations == [1000, 1001, 1002, 1003, 1004]
    assert view.histories["a"].cells == [0, 1, 2, 3, 4]
    assert [point.cells for point in view.curves["a"].points] == [0, 1, 2, 3, 4]


def test_two_jobs_are_told_apart() -> None:
    jobs = watching(answers=values("mugs") | values("cubes", runs=7))
    jobs.heard(Keys("cubes").stat("job"), to_json(figures(job="cubes", evaluations=2000)), START)
    assert [(view.job, view.figures.evaluations) for view in jobs.views(START)] == [
        ("cubes", 2000),
        ("mugs", 1000),
    ]


def test_pages_of_a_team_that_are_no_more_are_forgotten() -> None:
    jobs = watching(answers=values(workers=200))
    (page,) = team(worker(1), worker(2))
    told(jobs, START, stat_team_0=page)
    assert len(seen(jobs, START).workers) == 2


def test_a_worker_on_two_pages_is_shown_once() -> None:
    jobs = watching(answers=values(workers=200))
    before = seen(jobs, START).workers
    pages = team(*(before[64:65] + before[:63] + before[64:]))  # one went from the second to the first
    told(jobs, START, stat_team_0=pages[0])
    wids = [one.wid for one in seen(jobs, START).workers]
    assert len(wids) == len({*wids})
    assert before[64].wid in wids


def test_events_that_are_told_twice_are_shown_once_in_their_order() -> None:
    jobs = watching()
    for number in (3, 1, 2, 3):
        told(jobs, START, event_job=event(number))
    told(jobs, START, event_recent=Events(events=[event(2), event(4)]))
    assert [one.number for one in seen(jobs, START).events] == [1, 2, 3, 4]


def test_what_is_remembered_is_bounded() -> None:
    jobs = watching()
    for number in range(MOST_RUNS + 5):
        told(jobs, START, event_job=event(number), **{f"stat_run_r{number}": run(f"r{number}")})
    view = seen(jobs, START)
    assert len(view.runs) == len(view.curves) == MOST_RUNS
    assert len(view.events) == KEPT
    for number in range(MOST + 5):
        jobs.answered(values(f"job-{number}"), START)
    assert len(jobs.views(START)) == MOST


def test_the_job_that_is_forgotten_is_the_one_that_was_silent_for_longest() -> None:
    jobs = Jobs()
    for number in range(MOST):
        jobs.answered(values(f"job-{number:02}"), START + number)
    jobs.heard(Keys("job-00").stat("job"), to_json(figures(job="job-00")), START + MOST)
    jobs.answered(values("new"), START + MOST)
    names = {view.job for view in jobs.views(START + MOST)}
    assert (len(names), names & {"job-00", "job-01", "new"}) == (MOST, {"job-00", "new"})


def test_of_many_runs_those_that_are_over_are_forgotten_first_then_the_silent_ones() -> None:
    jobs = watching()
    over = run("over", finished="all are spent")
    told(jobs, START + 2, stat_run_over=over)
    for number in range(MOST_RUNS - 3):
        told(jobs, START + 1, **{f"stat_run_r{number}": run(f"r{number}")})
    told(jobs, START + 3, stat_run_a=run("a"), stat_run_new=run("new"))
    names = [one.run for one in seen(jobs, START + 3).runs]
    assert (len(names), names[0], "b" in names, "over" in names) == (MOST_RUNS, "a", True, False)
    told(jobs, START + 4, stat_run_newer=run("newer"))
    names = [one.run for one in seen(jobs, START + 4).runs]
    assert (len(names), names[0], "b" in names) == (MOST_RUNS, "a", False)


def test_what_is_left_out_where_not_all_runs_can_be_shown_is_over_or_silent() -> None:
    jobs = watching()
    told(jobs, START + 1, stat_run_c=run("c", finished="all are spent"), stat_run_d=run("d"))
    told(jobs, START + 2, stat_run_a=run("a"))
    view = seen(jobs, START + 2)
    assert [one.run for one in view.runs] == ["a", "b", "c", "d"]
    assert [[one.run for one in view.foremost(most)] for most in (1, 2, 3)] == [
        ["a"],
        ["a", "d"],
        ["a", "b", "d"],
    ]
