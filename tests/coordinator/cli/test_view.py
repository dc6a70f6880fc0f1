"""The grasps of runs in folders, on a page."""

from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import made_scene
from tests.patience import PATIENCE
from typer.testing import CliRunner

from qdgrasp_coordinator.cli.main import app
from qdgrasp_coordinator.cli.view import has_desktop
from qdgrasp_coordinator.cli.web_place import web_place
from qdgrasp_protocol.errors import FolderError, ImpossibleValue


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("127.0.0.1:8080", ("127.0.0.1", 8080)),
        ("[::1]:80", ("::1", 80)),
        ("head:0", ("head", 0)),
    ],
)
def test_the_place_of_the_page_is_a_host_and_a_port(text: str, place: tuple[str, int]) -> None:
    assert web_place(text) == place


@pytest.mark.parametrize("text", ["", "8080", ":8080", "head", "head:", "head:x", "head:65536", "head:-1"])
def test_what_is_no_place_is_refused_with_how_to_write_one(text: str) -> None:
    with pytest.raises(ImpossibleValue, match="HOST:PORT, such as"):
        web_place(text)


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


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    refused = CliRunner().invoke(app, ["view", str(tmp_path)])
    assert isinstance(refused.exception, FolderError)
    assert "holds no run and no campaign, nor does a folder in it" in str(refused.exception)


@pytest.mark.parametrize(("flags", "is_opened"), [([], True), (["--no-open"], False)])
def test_the_address_is_printed_and_opened_unless_somebody_says_no(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flags: list[str], is_opened: bool
) -> None:
    seen, address = SimpleQueue[str](), "http://127.0.0.1:8080/"

    def serve(*given: Any) -> None:
        given[-1](address)
        if is_opened:
            seen.put(seen.get(timeout=PATIENCE))  # until the browser has heard of it

    monkeypatch.setattr("qdgrasp_coordinator.monitor.web.app.serve", serve)
    monkeypatch.setattr("webbrowser.open", seen.put)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.delenv("SSH_CONNECTION", raising=False)
    path = record(tmp_path / "mug", made_scene(), random_rows(5)).path
    done = CliRunner().invoke(app, ["view", str(path), *flags])
    assert done.exit_code == 0, done.exception
    assert done.stdout == f"The grasps are shown at {address} until Ctrl-C.\n"
    assert seen.empty() is not is_opened
