import json
import re
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.request import urlopen

import pytest
from prometheus_client.parser import text_string_to_metric_families
from tests.coordinator.monitor.web.conftest import client, free_port, serving
from tests.coordinator.monitor.web.fakes import STEP, FakeFeed, FakeLibrary
from tests.patience import PATIENCE

from qdgrasp_coordinator.monitor.web.app import STATIC
from qdgrasp_coordinator.monitor.web.markup import html

PAGES = ("index", "view")
SCRIPTS = [path for path in STATIC.rglob("*") if path.is_file() and "vendor" not in path.parts]


def test_the_state_tells_what_is_known_of_all_jobs(feed: FakeFeed) -> None:
    jobs = {job["job"]: job for job in client(feed).get("/api/state").json()["jobs"]}
    assert jobs["mug"]["figures"]["evaluations"] == 3 * STEP
    assert len(jobs["hands"]["runs"]) == 6
    assert jobs["hands"]["team"]["states"] == {"working": 4}


def test_the_curves_lead_to_what_the_state_tells(feed: FakeFeed) -> None:
    curves = client(feed).get("/api/jobs/mug/curves").json()
    assert curves["history"]["evaluations"][-1] == 3 * STEP
    assert curves["curves"]["mug"]["points"][-1][0] == 3 * STEP


def test_metrics_are_what_prometheus_reads(feed: FakeFeed) -> None:
    answer = client(feed).get("/metrics")
    assert answer.headers["content-type"].startswith("text/plain; version=")
    samples = [sample for family in text_string_to_metric_families(answer.text) for sample in family.samples]
    found = {
        sample.labels["job"]: sample.value
        for sample in samples
        if sample.name == "qdgrasp_job_evaluations_total"
    }
    assert found == {"mug": 3 * STEP, "hands": 6 * 3 * STEP}


@pytest.mark.parametrize(
    ("page", "status", "words"),
    [
        ("/api/jobs/mags/curves", 404, "Unknown job 'mags'. Known: hands, mug."),
        ("/api/jobs/mug/runs/other/scene", 404, "Unknown run 'other'"),
        ("/api/jobs/hands/runs", 503, "nobody answers"),
    ],
)
def test_what_cannot_be_answered_is_said_in_a_sentence(
    feed: FakeFeed, page: str, status: int, words: str
) -> None:
    answer = client(feed).get(page)
    assert answer.status_code == status
    assert words in answer.json()["error"]


def test_names_with_anything_in_them_reach_the_library(feed: FakeFeed) -> None:
    assert "Unknown run 'x y&?'" in client(feed).get("/api/jobs/mug/runs/x%20y%26%3F/scene").json()["error"]
    assert client(feed).get("/api/jobs/mug/runs/mug/grasps/12").json() == {"number": 12}
    for number in ("twelve", "-1", "5000000000", "9" * 5000):
        assert client(feed).get(f"/api/jobs/mug/runs/mug/grasps/{number}").status_code == 404


def test_a_library_that_hangs_keeps_nothing_else_waiting(
    feed: FakeFeed, monkeypatch: pytest.MonkeyPatch
) -> None:
    over = threading.Event()
    monkeypatch.setattr(FakeLibrary, "runs", lambda *_: b"{}" if over.wait(PATIENCE) else b"")
    with serving(feed, free_port()) as address, ThreadPoolExecutor(64) as pool:
        asked = [pool.submit(urlopen, f"{address}/api/jobs/mug/runs", timeout=PATIENCE) for _ in range(64)]
        try:
            for page in ("/", "/metrics", "/api/state", "/static/style.css"):
                assert urlopen(address + page, timeout=PATIENCE).status == 200  # noqa: S310 - our own
            assert not any(one.done() for one in asked)
        finally:
            over.set()
        assert {one.result().status for one in asked} == {200}


@pytest.mark.parametrize(
    ("since", "read"), [("5", 5), ("", 0), ("-1", 0), ("x", 0), ("5000000000", 0), ("9" * 5000, 0)]
)
def test_cells_are_asked_for_from_a_number_on(feed: FakeFeed, since: str, read: int) -> None:
    answer = client(feed).get("/api/jobs/mug/runs/mug/cells", params={"from": since})
    assert answer.headers["content-type"] == "application/octet-stream"
    assert int.from_bytes(answer.content[8:12], "little") == read


@pytest.mark.parametrize(
    "path", ["/static/../app.py", "/static/%2e%2e/app.py", "/static/..%2fapp.py", "/static/"]
)
def test_nothing_beside_the_page_is_handed_out(feed: FakeFeed, path: str) -> None:
    assert client(feed).get(path).status_code == 404


def test_scripts_are_asked_for_again_and_sent_only_when_they_changed(feed: FakeFeed) -> None:
    guest = client(feed)
    first = guest.get("/static/app.js")
    assert first.headers["cache-control"] == "no-cache"
    assert guest.get("/static/app.js", headers={"if-none-match": first.headers["etag"]}).status_code == 304


def test_large_answers_are_packed(feed: FakeFeed) -> None:
    answer = client(feed).get("/static/vendor/three/three.core.min.js")
    assert answer.headers["content-encoding"] == "gzip"


@pytest.mark.parametrize("path", SCRIPTS, ids=[path.relative_to(STATIC).as_posix() for path in SCRIPTS])
def test_nothing_in_the_page_comes_from_elsewhere(path: Path) -> None:
    text = path.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
    assert re.findall(r"(?:https?:)?//[\w.-]+\.\w+", text) == []


@pytest.mark.parametrize("name", PAGES)
def test_a_page_has_no_script_or_style_in_itself(name: str) -> None:
    assert re.findall(r"<script(?![^>]* src=)|<style|\sstyle=|\son\w+=", html(name)) == []


@pytest.mark.parametrize("name", PAGES)
def test_a_page_has_all_its_parts_and_each_name_once(name: str) -> None:
    text = html(name)
    assert "<!-- " not in text
    names = re.findall(r'\sid="([^"]+)"', text)
    assert {"skip", "link", "theme", "main", "scene", "grasp", "scene-filters"} <= set(names)
    assert len(names) == len(set(names))
    assert text.index("<meta charset") < 1024


def test_what_the_page_loads_is_there() -> None:
    loaded = [name for page in PAGES for name in re.findall(r'(?:src|href)="static/([^"]+)"', html(page))]
    imported = [
        (path.parent / name).resolve()
        for path in SCRIPTS
        if path.suffix == ".js"
        for name in re.findall(r'(?:from|import\(?)\s*"([^"]+)"', path.read_text(encoding="utf-8"))
    ]
    assert len(loaded) > 4
    assert len(imported) > 15
    assert [path for path in [*(STATIC / name for name in loaded), *imported] if not path.is_file()] == []


def test_the_state_is_one_line_so_that_it_can_be_an_event(feed: FakeFeed) -> None:
    feed.happen("two\nlines")
    text = client(feed).get("/api/state").text
    assert "\n" not in text
    assert "two\nlines" in [event["words"] for event in json.loads(text)["jobs"][1]["events"]]
