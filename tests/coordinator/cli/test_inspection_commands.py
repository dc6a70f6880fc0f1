"""Commands that look at runs: what they print and refuse."""

import json
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest
from tests.common import PATIENCE
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.report.test_row_report import OUTCOMES, run_of
from tests.coordinator.scenes import SceneMaker, made_scene
from typer.testing import CliRunner, Result

from qdgrasp_coordinator.cli.inspection_commands import has_desktop
from qdgrasp_coordinator.cli.main import app
from qdgrasp_coordinator.cli.options import host_and_port
from qdgrasp_coordinator.search.registry import METHODS
from qdgrasp_protocol.errors import FolderError, ImpossibleValue, InputError
from qdgrasp_protocol.spec import DEFAULT_METHOD


@pytest.fixture
def path(tmp_path: Path, make_scene: SceneMaker) -> Path:
    return run_of(tmp_path / "mug", make_scene(), OUTCOMES).folder.path


def show(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["show", *map(str, arguments)])


def test_a_grasp_is_shown_line_by_line_and_the_run_by_the_name_of_its_folder(path: Path) -> None:
    lines = show(path, "--grasp", 1).stdout.splitlines()
    for words in ("run              mug", "outcome          held: every disturbance was survived"):
        assert words in lines
    assert "number           1 of 5 rows, counted from 0" in lines


def test_machines_are_told_the_same(path: Path) -> None:
    told = json.loads(show(path, "--grasp", 1, "--json").stdout)
    assert (told["number"], told["outcome"], told["fitness"], told["eta"]) == (1, "held", 2.0, None)
    assert told["base_to_object"]["quaternion_xyzw"] == [0, 0, 0, 1]


def test_a_row_that_is_not_there_is_refused(path: Path) -> None:
    refused = show(path, "--grasp", 5).exception
    assert isinstance(refused, InputError)
    assert str(refused) == (
        f"The journal of {path} has no row 5: it has 5, numbered from 0, and the nearest success is 3."
    )


@pytest.mark.parametrize("command", [("show", "--grasp", "0"), ("verify",), ("view",)])
def test_a_folder_without_a_run_is_refused(tmp_path: Path, command: tuple[str, ...]) -> None:
    assert isinstance(CliRunner().invoke(app, [*command, str(tmp_path)]).exception, FolderError)


def test_a_number_is_asked_for(path: Path) -> None:
    assert "Missing option '--grasp'" in show(path).output


def refused(path: Path, out: object, *arguments: object, grasp: int = 1) -> str:
    command = ["render", path, "--grasp", grasp, "-o", out, *arguments]
    error = CliRunner().invoke(app, list(map(str, command))).exception
    assert isinstance(error, InputError)
    return str(error)


SIZE_WORDS = "--size must be 320x240 to 1280x960 for a .gif"
SIZES = ("640", "640x", "10x10", "640x560x3", "-640x560", "9999x9999")
VIEWS = ("40", "40,25,3", "x,y", "nan,3", "500,3", "0,91")


@pytest.mark.parametrize(
    ("name", "flags", "words"),
    [
        ("a.gif", ("--pregrasp",), "--pregrasp draws one picture, and"),
        ("a.jpg", (), "a.jpg must end with .png or .gif; name another path with --out."),
        ("a.png", ("--what", "shakes"), "--what chooses a part of a film"),
        *(("a.gif", (f"--size={size}",), f"{SIZE_WORDS}, got '{size}'.") for size in SIZES),
        *(("a.png", (f"--from={view}",), "--from must be AZIMUTH,ELEVATION in degrees") for view in VIEWS),
    ],
)
def test_a_picture_that_cannot_be_drawn_is_refused(
    path: Path, tmp_path: Path, name: str, flags: tuple[str, ...], words: str
) -> None:
    said = refused(path, tmp_path / name, *flags)
    assert said.startswith(f"{tmp_path}/{words}" if name == "a.jpg" else words)
    assert not words.endswith(".") or said.endswith(words)


def test_a_row_without_a_pose_is_refused(path: Path, tmp_path: Path) -> None:
    assert refused(path, tmp_path / "a.png", grasp=2) == (
        "There is nothing of row 2 to show: it is a dead end, for which decoding found no pose."
    )
    assert not (tmp_path / "a.png").exists()


def refusal(*arguments: object) -> BaseException | None:
    return CliRunner().invoke(app, ["verify", *map(str, arguments)]).exception


def test_all_rows_leave_nothing_to_a_sample(tmp_path: Path) -> None:
    refused = refusal(tmp_path, "--all", "--sample", 3)
    assert isinstance(refused, InputError)
    assert str(refused) == "--all leaves nothing to --sample: give one of them."


def test_a_run_without_rows_is_refused(tmp_path: Path, make_scene: SceneMaker) -> None:
    empty = record(tmp_path / "empty", make_scene(), random_rows(0))
    refused = refusal(empty.path)
    assert isinstance(refused, InputError)
    assert str(refused) == "Nothing is recorded there that could be evaluated again."


@pytest.mark.parametrize(
    ("text", "place"),
    [("127.0.0.1:8080", ("127.0.0.1", 8080)), ("[::1]:80", ("::1", 80)), ("head:0", ("head", 0))],
)
def test_the_place_of_the_page_is_a_host_and_a_port(text: str, place: tuple[str, int]) -> None:
    assert host_and_port(text) == place


@pytest.mark.parametrize("text", ["", "8080", ":8080", "head", "head:", "head:x", "head:65536", "head:-1"])
def test_what_is_no_place_is_refused_with_how_to_write_one(text: str) -> None:
    with pytest.raises(ImpossibleValue, match="HOST:PORT, such as"):
        host_and_port(text)


@pytest.mark.parametrize(
    ("environment", "is_there"),
    [
        ({}, False),
        ({"DISPLAY": ""}, False),
        ({"DISPLAY": ":0"}, True),
        ({"WAYLAND_DISPLAY": "wayland-0"}, True),
        ({"DISPLAY": "localhost:10.0", "SSH_CONNECTION": "10.0.0.1 22 10.0.0.2 22"}, False),
    ],
)
def test_a_browser_is_opened_where_somebody_sits(environment: dict[str, str], is_there: bool) -> None:
    assert has_desktop(environment) is is_there


@pytest.mark.parametrize(("flags", "is_opened"), [([], True), (["--no-open"], False)])
def test_the_address_is_printed_and_opened_unless_somebody_says_no(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flags: list[str], is_opened: bool
) -> None:
    seen, address = SimpleQueue[str](), "http://127.0.0.1:8080/"

    def serve(*given: Any) -> None:
        given[-1](address)
        if is_opened:
            seen.put(seen.get(timeout=PATIENCE))  # until the browser has heard of it

    monkeypatch.setattr("qdgrasp_coordinator.monitor.web.server.serve", serve)
    monkeypatch.setattr("webbrowser.open", seen.put)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.delenv("SSH_CONNECTION", raising=False)
    path = record(tmp_path / "mug", made_scene(), random_rows(5)).path
    done = CliRunner().invoke(app, ["view", str(path), *flags])
    assert done.exit_code == 0, done.exception
    assert done.stdout == f"The grasps are shown at {address} until Ctrl-C.\n"
    assert seen.empty() is not is_opened


def test_every_method_has_a_line() -> None:
    done = CliRunner().invoke(app, ["methods"])
    assert done.exit_code == 0
    head, *lines = done.stdout.splitlines()
    assert head.split() == [
        "name",
        "prior",
        "overlaps",
        "population",
        "generations_in_flight",
        "in_flight",
        "summary",
    ]
    assert [line.split()[0] for line in lines] == list(METHODS)


def test_the_default_comes_first_and_is_marked() -> None:
    assert next(iter(METHODS)) == DEFAULT_METHOD
    assert [name for name, entry in METHODS.items() if "default" in entry.summary] == [DEFAULT_METHOD]


def test_machines_get_the_same_table() -> None:
    table = json.loads(CliRunner().invoke(app, ["methods", "--json"]).stdout)
    assert {entry["name"]: entry["prior"] for entry in table} == {
        name: entry.prior for name, entry in METHODS.items()
    }
    assert next(entry for entry in table if entry["name"] == "cma_mae")["population"] == 540
