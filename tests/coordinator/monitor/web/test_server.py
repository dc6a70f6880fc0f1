"""The server of the page: addresses, connections and the files it brings."""

import hashlib
import json
import re
import socket
import subprocess
import sys
import threading
import zipfile
from concurrent.futures import ThreadPoolExecutor
from http.client import HTTPConnection
from pathlib import Path
from urllib.request import urlopen

import pytest
from prometheus_client.parser import text_string_to_metric_families
from tests.common import PATIENCE, free_port
from tests.coordinator.monitor.web.conftest import HERE, client, serving
from tests.coordinator.monitor.web.fakes import STEP, FakeFeed, FakeLibrary

from qdgrasp_coordinator.monitor.web import server
from qdgrasp_coordinator.monitor.web.routes import html
from qdgrasp_coordinator.monitor.web.server import STATIC

ROOT = Path(__file__).resolve().parents[4]
PACKAGE = ROOT / "coordinator" / "qdgrasp_coordinator"
STATIC_FILES = PACKAGE / "monitor" / "web" / "static"
VENDOR = STATIC_FILES / "vendor"
NOTICES = (ROOT / "THIRD_PARTY_NOTICES.md").read_text(encoding="utf-8")


def files(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_the_scripts_of_others_are_those_in_the_notices() -> None:
    noticed = dict(re.findall(r"^\| `([\w./]+)` \| `([0-9a-f]{64})` \|$", NOTICES, re.MULTILINE))
    there = {name: hashlib.sha256((VENDOR / name).read_bytes()).hexdigest() for name in files(VENDOR)}
    assert there
    assert there == noticed


@pytest.mark.parametrize(
    ("package", "script", "stated"),
    [("three", "three.core.min.js", '="{1}"'), ("uPlot", "uPlot.iife.min.js", "(v{0}.{1}.{2})")],
)
def test_the_versions_in_the_notices_are_those_that_the_scripts_state(
    package: str, script: str, stated: str
) -> None:
    noticed = re.search(rf"^\| \[{package}\]\S* \| (\S+) \|", NOTICES, re.MULTILINE)
    assert noticed
    text = (VENDOR / package.lower() / script).read_text(encoding="utf-8")
    assert stated.format(*noticed[1].split(".")) in text


def test_the_wheel_holds_the_page_with_the_scripts_of_others_and_their_licences(tmp_path: Path) -> None:
    pytest.importorskip("hatchling", reason="needs hatchling, which builds the wheel")
    build = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    packed = set(zipfile.ZipFile(wheel).namelist())
    for folder in (STATIC_FILES, STATIC_FILES.with_name("pages")):
        home = folder.relative_to(PACKAGE.parent).as_posix()
        assert {f"{home}/{name}" for name in files(folder)} <= packed
    licences = {
        name.partition("/vendor/")[2] for name in packed if "/licenses/" in name and "/vendor/" in name
    }
    assert licences == {"three/LICENSE", "uplot/LICENSE"}


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
    "path", ["/static/../server.py", "/static/%2e%2e/server.py", "/static/..%2fserver.py", "/static/"]
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


def ended(connection: socket.socket) -> bool:
    """Whether the server ends a connection; False: it said something."""
    connection.settimeout(PATIENCE)
    try:
        return connection.recv(1) == b""
    except ConnectionResetError:
        return True


@pytest.mark.parametrize("begun", [b"", b"GET /api/sta", b"GET / HTTP/1.1\r\nHost: localhost\r\nA: "])
def test_whoever_asks_nothing_is_let_go(
    feed: FakeFeed, monkeypatch: pytest.MonkeyPatch, begun: bytes
) -> None:
    monkeypatch.setattr(server, "FIRST_REQUEST_SECONDS", 0.2)
    port = free_port()
    with serving(feed, port), socket.create_connection((HERE, port)) as idle:
        idle.sendall(begun)
        assert ended(idle)


def test_a_stream_that_was_asked_for_goes_on(feed: FakeFeed, monkeypatch: pytest.MonkeyPatch) -> None:
    looked, leave = threading.Event(), server.LimitedConnection.close_if_idle

    def leave_later(self: server.LimitedConnection) -> None:
        """Look whether something was asked when it was: on a busy machine a question may be late."""
        if self.cycle is None:
            self.loop.call_later(0.01, self.close_if_idle)
        else:
            leave(self)
            looked.set()

    monkeypatch.setattr(server, "FIRST_REQUEST_SECONDS", 0.1)
    monkeypatch.setattr(server.LimitedConnection, "close_if_idle", leave_later)
    with serving(feed, free_port()) as address:
        stream = urlopen(f"{address}/api/stream", timeout=PATIENCE)  # noqa: S310 - our own
        assert looked.wait(PATIENCE)
        frames = [line for line in (stream.readline() for _ in range(12)) if line.startswith(b"data: ")]
        stream.close()
    assert len(frames) >= 3


def test_one_address_does_not_take_the_room_of_others(
    feed: FakeFeed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "MAX_CONNECTIONS_PER_ADDRESS", 4)
    port = free_port()
    with serving(feed, port) as address:
        crowd = [socket.create_connection((HERE, port)) for _ in range(8)]
        assert ended(crowd[-1])
        with pytest.raises(OSError, match=r"."):
            urlopen(f"{address}/api/state", timeout=PATIENCE)  # noqa: S310 - our own
        with socket.create_connection((HERE, port), source_address=("127.0.0.2", 0)) as other:
            other.sendall(b"GET /api/state HTTP/1.1\r\nHost: localhost\r\n\r\n")
            assert not ended(other)
        for one in crowd:
            one.close()


def test_whoever_comes_to_a_full_house_is_asked_to_try_again(
    feed: FakeFeed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "MAX_CONNECTIONS", 4)
    port = free_port()
    with serving(feed, port):
        guests = [HTTPConnection(HERE, port, timeout=PATIENCE) for _ in range(4)]
        assert [asked(guest) for guest in guests] == [200, 200, 200, 503]
        for guest in guests:
            guest.close()


def asked(guest: HTTPConnection) -> int:
    """What a connection is answered with that stays there afterwards."""
    guest.request("GET", "/api/state")
    answer = guest.getresponse()
    answer.read()
    return answer.status
