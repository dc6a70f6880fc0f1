"""What the server answers: the state of jobs, and finished runs in folders."""

import os
from pathlib import Path

import msgspec
import pytest
from starlette.testclient import TestClient
from tests.coordinator.monitor import sample_jobs
from tests.coordinator.monitor.web.fakes import FakeFeed
from tests.coordinator.monitor.web.test_scene_data import read
from tests.coordinator.recorded_runs import random_rows, record

from qdgrasp_coordinator.metrics import job_status
from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.metrics.run_stats import successes
from qdgrasp_coordinator.monitor.job_view import JobView
from qdgrasp_coordinator.monitor.records import FolderIndex
from qdgrasp_coordinator.monitor.web.access import Access
from qdgrasp_coordinator.monitor.web.routes import folder_site
from qdgrasp_coordinator.monitor.web.server import application
from qdgrasp_coordinator.monitor.web.state_stream import MOST_RUNS, MOST_WORKERS, JobState, PageState
from qdgrasp_protocol.errors import UnknownName
from qdgrasp_protocol.keys import Keys


def view(**more: int) -> JobView:
    (made,) = sample_jobs.views(sample_jobs.values(**more))
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
    runs = {keys.stat(f"run/{name}"): job_status.to_json(sample_jobs.run(name)) for name in names}
    (many,) = sample_jobs.views(sample_jobs.values() | runs)
    state = JobState.of(many)
    assert len(state.runs) == len(state.lefts) == len(state.speeds) == MOST_RUNS


def test_what_is_told_are_the_figures_of_the_coordinator(feed: FakeFeed) -> None:
    told = msgspec.json.decode(PageState(feed).state())["jobs"][1]
    (job,) = [job for job in feed.views() if job.job == "mug"]
    assert told["figures"] == msgspec.to_builtins(job.figures)
    assert told["runs"] == msgspec.to_builtins(job.runs)
    assert told["left"] == job.figures.left


def test_a_job_that_nobody_knows_has_no_curves(feed: FakeFeed) -> None:
    with pytest.raises(UnknownName, match="Known: hands, mug"):
        PageState(feed).curves("mag")


ROWS = random_rows(60)


def client(*paths: Path) -> TestClient:
    app = application(folder_site(FolderIndex(paths)), Access(local=True))
    return TestClient(app, base_url="http://localhost:8080", raise_server_exceptions=False)


@pytest.fixture
def path(tmp_path: Path, make_scene) -> Path:
    return record(tmp_path / "mug", make_scene(), ROWS).path


def test_it_lists_jobs_and_their_runs(path: Path) -> None:
    assert client(path).get("/api/jobs").json() == [{"job": "mug", "folder": str(path), "runs": ["run"]}]


def test_the_cells_are_those_of_all_successes(path: Path) -> None:
    answer = client(path).get("/api/jobs/mug/runs/run/cells")
    places = {place for place, _, _ in read(answer.content)[2]}
    assert places == {tuple(place) for place in cells(successes(ROWS)["descriptor"]).tolist()}


def test_a_grasp_is_told_with_its_frames_and_commands(path: Path) -> None:
    number = int((ROWS["outcome"] >= 5).argmax())
    told = client(path).get(f"/api/jobs/mug/runs/run/grasps/{number}").json()
    assert told["base"] == "palm"
    assert told["commands"] == [
        f"qdgrasp show {path} --grasp {number}",
        f"qdgrasp render {path} --grasp {number} -o grasp.png",
    ]


def test_what_is_not_there_is_said(path: Path) -> None:
    answer = client(path).get("/api/jobs/mug/runs/rum/scene")
    assert answer.status_code == 404
    assert answer.json()["error"].startswith("Unknown run 'rum'.")
    assert client(path).get("/api/state").status_code == 404


def test_a_folder_whose_name_is_no_text_breaks_nothing(tmp_path: Path, make_scene) -> None:
    path = record(tmp_path / "mug", make_scene(), ROWS).path
    odd = Path(os.fsdecode(os.fsencode(tmp_path) + b"/m\xffug"))
    path.rename(odd)
    number = int((ROWS["outcome"] >= 5).argmax())
    assert client(odd).get("/api/jobs").json()[0]["folder"].endswith(r"m\udcffug")
    command = client(odd).get(f"/api/jobs/mug/runs/run/grasps/{number}").json()["commands"][0]
    assert command.endswith(f"--grasp {number}")
    (odd / "scene.bundle").unlink()
    sorry = client(odd).get("/api/jobs/mug/runs/run/scene")
    assert sorry.status_code == 404
    assert r"m\udcffug" in sorry.json()["error"]
