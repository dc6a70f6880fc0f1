"""What is known of jobs by whoever only listens."""

from collections.abc import Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Struct
from tests.coordinator.monitor.shown import curve, event, figures, meta, run, team, values, worker

from qdgrasp_coordinator.counts.events import KEPT, Events
from qdgrasp_coordinator.counts.figures import to_json
from qdgrasp_coordinator.monitor.job import MOST_RUNS, SILENCE
from qdgrasp_coordinator.monitor.jobs import AGAIN, MOST, Jobs, JobView
from qdgrasp_protocol.keys import AnyJob, Keys

MUGS = Keys("mugs")
START = 1000.0
PLACES = (
    "meta",
    "stat/job",
    "stat/run/a",
    "stat/team/0",
    "stat/curve/a",
    "event/job",
    "event/recent",
    "x",
    "",
)


def told(jobs: Jobs, now: float, **shown: Struct) -> None:
    """Let jobs hear something of the job mugs: `stat_run_a=...` on stat/run/a."""
    for place, struct in shown.items():
        jobs.heard(f"{MUGS.root}/{place.replace('_', '/')}", to_json(struct), now)


def watching(now: float = START, answers: Mapping[str, bytes] | None = None) -> Jobs:
    """A monitor that has asked, and was answered."""
    jobs = Jobs()
    jobs.questions(now)
    jobs.token(MUGS.coordinator_token(2), True, now)
    jobs.questions(now)
    jobs.answered(values() if answers is None else answers, now)
    jobs.questions(now)
    return jobs


def seen(jobs: Jobs, now: float) -> JobView:
    (view,) = jobs.views(now)
    return view


class TestWhatIsShown:
    def test_whoever_comes_late_sees_all_that_coordinators_answer(self) -> None:
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

    def test_what_is_heard_takes_the_place_of_what_was_heard_before(self) -> None:
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

    def test_two_jobs_are_told_apart(self) -> None:
        jobs = watching(answers=values("mugs") | values("cubes", runs=7))
        jobs.heard(Keys("cubes").stat("job"), to_json(figures(job="cubes", evaluations=5)), START)
        assert [(view.job, view.figures.evaluations) for view in jobs.views(START)] == [
            ("cubes", 5),
            ("mugs", 1000),
        ]

    def test_pages_of_a_team_that_are_no_more_are_forgotten(self) -> None:
        jobs = watching(answers=values(workers=200))
        (page,) = team(worker(1), worker(2))
        told(jobs, START, stat_team_0=page)
        assert len(seen(jobs, START).workers) == 2

    def test_events_that_are_told_twice_are_shown_once_in_their_order(self) -> None:
        jobs = watching()
        for number in (3, 1, 2, 3):
            told(jobs, START, event_job=event(number))
        told(jobs, START, event_recent=Events(events=[event(2), event(4)]))
        assert [one.number for one in seen(jobs, START).events] == [1, 2, 3, 4]

    def test_what_is_remembered_is_bounded(self) -> None:
        jobs = watching()
        for number in range(MOST_RUNS + 5):
            told(jobs, START, event_job=event(number), **{f"stat_run_r{number}": run(f"r{number}")})
        view = seen(jobs, START)
        assert len(view.runs) == len(view.curves) == MOST_RUNS
        assert len(view.events) == KEPT
        for number in range(MOST + 5):
            jobs.answered(values(f"job-{number}"), START)
        assert len(jobs.views(START)) == MOST


class TestStates:
    def test_a_job_is_what_its_coordinator_says_while_it_speaks(self) -> None:
        jobs = watching(answers=values(state="paused"))
        assert seen(jobs, START + SILENCE).state == "paused"

    def test_a_coordinator_that_says_nothing_is_silent_and_is_heard_again(self) -> None:
        jobs = watching()
        view = seen(jobs, START + SILENCE + 1)
        assert (view.state, view.silent) == ("silent", SILENCE + 1)
        told(jobs, START + 20, stat_job=figures())
        assert seen(jobs, START + 21).state == "running"

    def test_a_coordinator_whose_token_vanishes_is_gone_at_once(self) -> None:
        jobs = watching()
        jobs.token(MUGS.coordinator_token(2), False, START + 1)
        told(jobs, START + 1.5, stat_job=figures())  # it was on its way
        assert seen(jobs, START + 2).state == "gone"

    def test_another_coordinator_goes_on_with_a_job(self) -> None:
        jobs = watching()
        jobs.token(MUGS.coordinator_token(2), False, START + 1)
        told(jobs, START + 9, meta=meta(epoch=0), stat_job=figures(state="starting"))
        assert seen(jobs, START + 9).state == "starting"
        jobs.token(MUGS.coordinator_token(3), True, START + 10)
        jobs.answered(values(epoch=3), START + 10)
        assert (seen(jobs, START + 10).state, seen(jobs, START + 10).meta.epoch) == ("running", 3)

    def test_a_token_of_an_epoch_that_is_over_takes_nothing_away(self) -> None:
        jobs = watching()
        jobs.token(MUGS.coordinator_token(3), True, START + 1)
        jobs.token(MUGS.coordinator_token(2), False, START + 2)
        assert seen(jobs, START + 2).state == "running"

    @pytest.mark.parametrize(
        "last", [{"runs_done": 3}, {"runs_done": 2, "runs_failed": 1}, {"state": "ending"}]
    )
    def test_a_job_that_had_nothing_left_to_do_has_ended(self, last: dict[str, object]) -> None:
        jobs = watching()
        told(jobs, START + 1, stat_job=figures(**last))
        jobs.token(MUGS.coordinator_token(2), False, START + 1.1)
        assert seen(jobs, START + 2).state == "ended"

    @pytest.mark.parametrize("news", [("link", "token"), ("token", "link")])
    def test_while_the_router_is_away_nobody_knows_whether_a_coordinator_is_there(
        self, news: tuple[str, str]
    ) -> None:
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

    def test_a_coordinator_that_does_not_come_back_with_the_router_is_gone(self) -> None:
        jobs = watching()
        jobs.linked(False, START + 1)
        jobs.token(MUGS.coordinator_token(2), False, START + 1)
        jobs.linked(True, START + 60)
        assert seen(jobs, START + 61).state == "silent"
        assert seen(jobs, START + 60 + SILENCE + 1).state == "gone"


class TestQuestions:
    def test_at_first_everything_is_asked_once(self) -> None:
        jobs, any_job = Jobs(), AnyJob()
        asked = [any_job.stat(), any_job.stat("curve/*"), any_job.meta, any_job.recent]
        assert jobs.questions(START) == asked
        assert jobs.questions(START + 60) == []

    def test_a_coordinator_that_appears_is_asked(self) -> None:
        jobs = watching()
        assert jobs.questions(START + 1) == []
        jobs.token(MUGS.coordinator_token(3), True, START + 2)
        assert MUGS.stat() in jobs.questions(START + 2)

    def test_when_the_router_is_back_everything_is_asked_and_nothing_while_it_is_away(self) -> None:
        jobs = watching()
        jobs.linked(False, START)
        jobs.token(MUGS.coordinator_token(3), True, START + 1)
        assert jobs.questions(START + 1) == []
        jobs.linked(True, START + 2)
        assert AnyJob().meta in jobs.questions(START + 2)

    def test_a_job_of_which_too_little_is_known_is_asked_again_now_and_then(self) -> None:
        jobs = Jobs()
        jobs.questions(START)
        told(jobs, START + 1, stat_job=figures())
        assert MUGS.meta in jobs.questions(START + 1)
        told(jobs, START + 1.5, stat_job=figures())
        assert jobs.questions(START + 1.5) == []
        assert MUGS.meta in jobs.questions(START + 1 + AGAIN)
        jobs.answered(values(), START + 7)
        assert not set(jobs.questions(START + 60)) & {MUGS.meta, MUGS.stat()}

    def test_the_curve_of_a_run_that_was_not_seen_from_its_beginning_on_is_asked_for_once(self) -> None:
        jobs = Jobs()
        jobs.questions(START)
        jobs.answered({MUGS.meta: to_json(meta()), MUGS.stat("job"): to_json(figures())}, START)
        told(
            jobs,
            START,
            stat_run_new=run("new", evaluations=0),
            stat_run_resumed=run("resumed", evaluations=70),
        )
        assert jobs.questions(START) == [MUGS.stat("curve/resumed")]
        assert jobs.questions(START + 60) == []


class TestGarbage:
    @given(st.binary(max_size=200), st.sampled_from(PLACES))
    def test_what_is_no_message_changes_nothing(self, payload: bytes, place: str) -> None:
        jobs = watching()
        before = seen(jobs, START)
        jobs.heard(f"{MUGS.root}/{place}", payload, START)
        assert seen(jobs, START) == before

    @pytest.mark.parametrize(
        "key", ["", "else/where", "qdgrasp/v1/BAD NAME/stat/job", "qdgrasp/v2/mugs/stat/job"]
    )
    def test_keys_of_others_are_left_alone(self, key: str) -> None:
        jobs = Jobs()
        jobs.heard(key, to_json(figures()), START)
        jobs.token(key, True, START)
        assert (jobs.views(START), jobs.strangers) == ([], [])

    def test_a_job_of_another_version_is_named_until_it_can_be_read(self) -> None:
        jobs = Jobs()
        jobs.heard(MUGS.stat("job"), b'{"job": "mugs", "figures": "quite other ones"}', START)
        assert (jobs.views(START), jobs.strangers) == ([], ["mugs"])
        jobs.answered(values(), START)
        assert (len(jobs.views(START)), jobs.strangers) == (1, [])

    def test_fields_that_a_later_version_adds_are_passed_over(self) -> None:
        jobs = watching()
        later = to_json(figures(evaluations=2000)).replace(b'{"job"', b'{"mood": "good", "job"', 1)
        jobs.heard(MUGS.stat("job"), later, START)
        assert seen(jobs, START).figures.evaluations == 2000
