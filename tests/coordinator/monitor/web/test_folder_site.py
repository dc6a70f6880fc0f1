"""What the server of finished runs answers."""

import os
from pathlib import Path

import pytest
from starlette.testclient import TestClient
from tests.coordinator.monitor.web.test_voxels import read
from tests.coordinator.recorded_runs import random_rows, record

from qdgrasp_coordinator.counts.cells import cells
from qdgrasp_coordinator.counts.tally import successes
from qdgrasp_coordinator.monitor.collection import Collection
from qdgrasp_coordinator.monitor.web.access import Access
from qdgrasp_coordinator.monitor.web.app import application
from qdgrasp_coordinator.monitor.web.folder_site import FolderSite

ROWS = random_rows(60)


def client(*paths: Path) -> TestClient:
    app = application(FolderSite(Collection(paths)), Access(local=True))
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
