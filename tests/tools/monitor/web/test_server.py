"""The server of the page: addresses, connections and the files it brings."""

import json
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from socket import gethostname
from urllib.request import urlopen

import pytest
from prometheus_client.parser import text_string_to_metric_families
from starlette.testclient import TestClient
from tests.common import PATIENCE
from tests.coordinator.recorded_runs import random_rows, record, success_mask
from tests.tools.monitor.web.conftest import HERE, STEP, FakeFeed, client, serving
from tests.tools.monitor.web.test_scene_data import read as read_page

from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_protocol.errors import EndpointError
from qdgrasp_protocol.process import Stop
from qdgrasp_tools.monitor.records import FolderIndex
from qdgrasp_tools.monitor.web.run_cache import JobCaches
from qdgrasp_tools.monitor.web.server import Access, application, folder_routes, serve


def test_the_state_tells_what_is_known_of_all_jobs(feed: FakeFeed) -> None:
    jobs = {job["job"]: job for job in client(feed).get("/api/state").json()["jobs"]}
    assert jobs["mug"]["figures"]["evaluations"] == 3 * STEP
    assert len(jobs["hands"]["runs"]) == 6
    assert jobs["hands"]["team"]["states"] == {"working": 4}


def test_metrics_are_what_prometheus_reads(feed: FakeFeed) -> None:
    answer = client(feed).get("/metrics")
    assert answer.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    samples = [sample for family in text_string_to_metric_families(answer.text) for sample in family.samples]
    found = {one.labels["job"]: one.value for one in samples if one.name == "qdgrasp_job_evaluations_total"}
    assert found == {"mug": 3 * STEP, "hands": 6 * 3 * STEP}


@pytest.mark.parametrize(
    ("page", "status", "words"),
    [
        ("/api/jobs/mags/history", 404, "Unknown job 'mags'. Known: hands, mug."),
        ("/api/jobs/mug/runs/other/scene", 404, "Unknown run 'other'"),
        ("/api/jobs/hands/runs", 503, "nobody answers"),
    ],
)
def test_what_cannot_be_answered_is_said_in_a_sentence(feed, page, status, words) -> None:
    answer = client(feed).get(page)
    assert answer.status_code == status
    assert words in answer.json()["error"]


def test_a_library_that_hangs_keeps_nothing_else_waiting(feed, monkeypatch) -> None:
    over = threading.Event()
    monkeypatch.setattr(JobCaches, "runs", lambda *_: b"{}" if over.wait(PATIENCE) else b"")
    with serving(feed) as address, ThreadPoolExecutor(64) as pool:
        asked = [pool.submit(urlopen, f"{address}/api/jobs/mug/runs", timeout=PATIENCE) for _ in range(64)]
        try:
            for page in ("/", "/metrics", "/api/state", "/static/style.css"):
                assert urlopen(address + page, timeout=PATIENCE).status == 200  # noqa: S310 - our own
            assert not any(one.done() for one in asked)
        finally:
            over.set()
        assert {one.result().status for one in asked} == {200}


@pytest.mark.parametrize("since", ["5", "", "-1", "x", "5000000000", "9" * 5000])
def test_cells_are_asked_for_from_a_number_on(feed: FakeFeed, since: str) -> None:
    answer = client(feed).get("/api/jobs/mug/runs/mug/cells", params={"from": since})
    assert answer.headers["content-type"] == "application/octet-stream"
    assert read_page(answer.content)[1:] == (False, {})


def test_browsers_get_the_state_again_and_again(feed) -> None:
    with serving(feed) as address, ExitStack() as stack:
        opened = [urlopen(f"{address}/api/stream", timeout=PATIENCE) for _ in range(2)]  # noqa: S310 - our own
        streams = [stack.enter_context(each) for each in opened]
        for stream in streams:
            events = [line for line in (stream.readline() for _ in range(4)) if line.startswith(b"data: ")]
            assert [len(json.loads(event[6:])["jobs"]) for event in events] == [2, 2]


def test_a_port_in_use_is_an_error_that_says_so() -> None:
    with socket.create_server((HERE, 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(EndpointError, match=f"{HERE}:{port}: Address already in use"):
            serve([], HERE, port, "", Stop(), print)


COOKIE = "qdgrasp-monitor-8080"
TOKEN = "a-token-of-some-length"  # noqa: S105 - it opens nothing
LOCKED = Access(local=False, token=TOKEN)
PATHS = ("/", "/api/state", "/metrics", "/static/app.js", "/api/jobs/mug/history", "/nowhere")


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1:8080", "[::1]:8080", "LOCALHOST:80", "127.8.0.1"])
def test_a_page_on_loopback_answers_to_the_names_of_this_machine(feed: FakeFeed, host: str) -> None:
    assert client(feed).get("/", headers={"host": host}).status_code == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8080", "192.168.0.7", "localhost.evil.example", "", "["]
)
def test_a_page_on_loopback_answers_to_no_other_name(feed: FakeFeed, host: str) -> None:
    for page in PATHS:
        assert client(feed).get(page, headers={"host": host}).status_code == 421


@pytest.mark.parametrize("method", ["POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "CONNECT"])
def test_nothing_can_be_written(feed: FakeFeed, method: str) -> None:
    for page in PATHS:
        answer = client(feed).request(method, page)
        assert (answer.status_code, answer.headers["allow"]) == (405, "GET, HEAD")


def test_without_the_token_nothing_is_seen(feed: FakeFeed) -> None:
    outsider = client(feed, LOCKED)
    assert {outsider.get(page).status_code for page in PATHS} == {401}


@pytest.mark.parametrize("wrong", ["", "a", TOKEN[:-1], TOKEN + "x", TOKEN.upper(), "töken"])
def test_another_token_opens_nothing(feed: FakeFeed, wrong: str) -> None:
    outsider = client(feed, LOCKED)
    for name, value in (("authorization", f"Bearer {wrong}"), ("cookie", f"{COOKIE}={wrong}")):
        assert outsider.get("/api/state", headers={name: value.encode()}).status_code == 401
    assert outsider.get("/", params={"token": wrong}).status_code == 401


def test_the_token_opens_the_page_in_a_header_or_a_cookie(feed: FakeFeed) -> None:
    guest = client(feed, LOCKED)
    assert guest.get("/metrics", headers={"authorization": f"Bearer {TOKEN}"}).status_code == 200
    assert guest.get("/metrics", headers={"cookie": f"other=1; {COOKIE}={TOKEN}"}).status_code == 200


def test_the_token_in_the_address_becomes_a_cookie_that_no_script_and_no_other_page_gets(feed) -> None:
    guest = client(feed, LOCKED)
    entered = guest.get("/", params={"token": TOKEN})
    assert (entered.status_code, entered.headers["location"]) == (303, "/")
    cookie = entered.headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=lax" in cookie
    assert guest.get("/api/state").status_code == 200


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "head", "192.168.0.7"])  # noqa: S104
def test_elsewhere_there_is_always_a_token_and_each_time_another_one(host: str) -> None:
    made = {Access.at(host).token for _ in range(5)}
    assert len(made) == 5
    assert min(map(len, made)) >= 32


def test_the_address_says_where_the_page_is() -> None:
    assert Access.at("127.0.0.1").address("127.0.0.1", 8080) == "http://127.0.0.1:8080/"
    assert Access.at("::1").address("::1", 8080) == "http://[::1]:8080/"
    assert gethostname() in Access.at("::").address("::", 80)
    made = Access.at("head")
    assert made.address("head", 80) == f"http://head:80/?token={made.token}"


def test_every_answer_has_the_headers_that_keep_a_browser_safe(feed: FakeFeed) -> None:
    for guest in (client(feed), client(feed, LOCKED)):
        refused = guest.post("/"), guest.get("/", headers={"host": "evil.example"})
        for answer in (*map(guest.get, PATHS), *refused):
            policy = answer.headers["content-security-policy"]
            assert "default-src 'none'" in policy
            assert "unsafe" not in policy
            assert answer.headers["x-content-type-options"] == "nosniff"
            assert answer.headers["referrer-policy"] == "no-referrer"
            assert "access-control-allow-origin" not in answer.headers


ROWS = random_rows(60)


def folder_client(*paths: Path) -> TestClient:
    app = application(folder_routes(FolderIndex(paths)), Access(local=True))
    return TestClient(app, base_url="http://localhost:8080", raise_server_exceptions=False)


@pytest.fixture
def path(tmp_path: Path, make_scene) -> Path:
    return record(tmp_path / "mug", make_scene(), ROWS).path


def test_it_lists_jobs_and_their_runs(path: Path) -> None:
    listed = folder_client(path).get("/api/jobs").json()
    assert listed == [{"job": "mug", "folder": str(path), "runs": ["run"]}]


def test_the_cells_are_those_of_all_successes(path: Path) -> None:
    answer = folder_client(path).get("/api/jobs/mug/runs/run/cells")
    places = {place for place, *_ in read_page(answer.content)[2].values()}
    assert places == {tuple(place) for place in cells(ROWS[success_mask(ROWS)]["descriptor"]).tolist()}
