"""Commands that look at runs: their output and refusals."""

import json
from pathlib import Path

import pytest
from tests.coordinator.recorded_campaigns import record_campaign
from tests.coordinator.scenes import SceneMaker
from tests.tools.report.test_run_report import OUTCOMES, run_of
from typer.testing import CliRunner, Result

from qdgrasp_protocol.errors import InputError
from qdgrasp_tools.cli.main import app


@pytest.fixture
def path(tmp_path: Path, make_scene: SceneMaker) -> Path:
    return run_of(tmp_path / "mug", make_scene(), OUTCOMES).folder.path


def test_a_grasp_is_shown_line_by_line_and_the_run_by_the_name_of_its_folder(path: Path) -> None:
    shown = CliRunner().invoke(app, ["show", str(path), "--grasp", "1"])
    assert {"run              mug", "outcome          held"} <= set(shown.stdout.splitlines())


def test_a_picture_that_cannot_be_drawn_is_refused(path: Path, tmp_path: Path) -> None:
    command = ["render", str(path), "--grasp", "1", "-o", str(tmp_path / "a.jpg")]
    error = CliRunner().invoke(app, command).exception
    assert isinstance(error, InputError)
    assert str(error) == f"{tmp_path}/a.jpg must end with .png or .gif; name another path with --out."


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign over ten objects, eight of which have begun, with two hands."""
    return record_campaign(tmp_path_factory.mktemp("campaigns") / "parts", 10, begun=0.8).path


def info(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["info", *map(str, arguments)])


def test_a_run_says_what_it_has_found(path: Path) -> None:
    done = info(path)
    assert done.exit_code == 0, done.exception
    assert "rows             5" in done.stdout.splitlines()


def test_a_campaign_says_what_its_objects_got_and_which_got_little(campaign: Path) -> None:
    lines = info(campaign).stdout.splitlines()
    assert "runs done        15" in lines
    assert "objects by state 3 skipped, 1 running, 2 waiting, 7 done" in lines
    assert "got little       4" in lines
    assert f"{'':<16} part_00002: no grasp: the open hand overlaps it in 100 of 100 poses" in lines
    assert "left out         2: it is not closed" in lines


def objects_of(result: Result) -> list[str]:
    return [line.split()[0] for line in result.stdout.splitlines()[1:]]


def test_the_table_of_objects_has_a_line_for_each(campaign: Path) -> None:
    assert len(objects_of(info(campaign, "--objects"))) == 13
    found = {each["object"]: each for each in json.loads(info(campaign, "--objects", "--json").stdout)}
    one = found["part_00007"]
    assert (one["state"], one["runs_done"], one["evaluations"]) == ("running", 1, 75)
