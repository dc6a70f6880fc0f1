"""`qdgrasp show`: for a person, for machines, and what it refuses."""

import json
from pathlib import Path

import pytest
from tests.coordinator.analysis.test_profile import OUTCOMES, run_of
from tests.coordinator.scenes import SceneMaker
from typer.testing import CliRunner, Result

from qdgrasp_coordinator.cli.main import app
from qdgrasp_protocol.errors import FolderError, InputError


@pytest.fixture
def path(tmp_path: Path, make_scene: SceneMaker) -> Path:
    return run_of(tmp_path / "mug", make_scene(), OUTCOMES).folder.path


def show(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["show", *map(str, arguments)])


def test_a_grasp_is_shown_line_by_line(path: Path) -> None:
    lines = show(path, "--grasp", 1).stdout.splitlines()
    assert "outcome          held: both shakes were survived" in lines
    assert "number           1 of 5 rows, counted from 0" in lines


def test_the_run_is_told_by_the_name_of_its_folder(path: Path) -> None:
    assert "run              mug" in show(path, "--grasp", 1).stdout.splitlines()


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


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    assert isinstance(show(tmp_path, "--grasp", 0).exception, FolderError)


def test_a_number_is_asked_for(path: Path) -> None:
    assert "Missing option '--grasp'" in show(path).output
