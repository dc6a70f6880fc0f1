import msgspec
import pytest
from tests.coordinator.monitor import shown
from tests.coordinator.monitor.web.fakes import FakeFeed

from qdgrasp_coordinator.monitor.jobs import JobView
from qdgrasp_coordinator.monitor.web.showing import MOST_RUNS, MOST_WORKERS, JobState, Showing
from qdgrasp_protocol.errors import UnknownName
from qdgrasp_protocol.keys import Keys


def view(**more: int) -> JobView:
    (made,) = shown.views(shown.values(**more))
    return made


def test_of_many_workers_those_in_trouble_are_listed_and_all_are_counted() -> None:
    many = view(workers=MOST_WORKERS + 100)
    workers = [*many.workers[:-1], msgspec.structs.replace(many.workers[-1], state="stuck")]
    team = JobState.of(msgspec.structs.replace(many, workers=workers)).team
    assert team.total == sum(team.states.values()) == MOST_WORKERS + 100
    assert len(team.workers) == MOST_WORKERS
    assert team.workers[0].state == "stuck"


def test_of_few_workers_the_order_stays() -> None:
    assert JobState.of(view(workers=9)).team.workers == view(workers=9).workers


def test_of_many_runs_the_latest_are_told() -> None:
    keys = Keys("mugs")
    names = [f"run{number}" for number in range(MOST_RUNS + 5)]
    runs = {keys.stat(f"run/{name}"): shown.to_json(shown.run(name)) for name in names}
    (many,) = shown.views(shown.values() | runs)
    state = JobState.of(many)
    assert len(state.runs) == len(state.lefts) == len(state.speeds) == MOST_RUNS


def test_what_is_told_are_the_figures_of_the_coordinator(feed: FakeFeed) -> None:
    told = msgspec.json.decode(Showing(feed).state())["jobs"][1]
    (job,) = [job for job in feed.views() if job.job == "mug"]
    assert told["figures"] == msgspec.to_builtins(job.figures)
    assert told["runs"] == msgspec.to_builtins(job.runs)
    assert told["left"] == job.figures.left


def test_a_job_that_nobody_knows_has_no_curves(feed: FakeFeed) -> None:
    with pytest.raises(UnknownName, match="Known: hands, mug"):
        Showing(feed).curves("mag")
