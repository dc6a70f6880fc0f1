"""`qdgrasp render`: what it refuses before anything is started."""

from pathlib import Path

import pytest
from tests.coordinator.analysis.test_profile import OUTCOMES, run_of
from tests.coordinator.scenes import SceneMaker
from typer.testing import CliRunner

from qdgrasp_coordinator.cli.main import app
from qdgrasp_protocol.errors import InputError


@pytest.fixture
def path(tmp_path: Path, make_scene: SceneMaker) -> Path:
    return run_of(tmp_path / "mug", make_scene(), OUTCOMES).folder.path


def refused(path: Path, out: object, *arguments: object, grasp: int = 1) -> str:
    command = ["render", path, "--grasp", grasp, "-o", out, *arguments]
    error = CliRunner().invoke(app, list(map(str, command))).exception
    assert isinstance(error, InputError)
    return str(error)


def test_a_file_of_another_kind_is_refused(path: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.jpg"
    assert refused(path, out) == f"{out} must end with .png or .gif; name another path with --out."


def test_a_part_of_a_picture_is_refused(path: Path, tmp_path: Path) -> None:
    assert "--what chooses a part of a film" in refused(path, tmp_path / "a.png", "--what", "shakes")


def test_a_file_that_is_there_stays(path: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.png"
    out.write_text("kept")
    assert refused(path, out) == (
        f"{out} is there already; name another path with --out, or replace it with --force."
    )
    assert out.read_text() == "kept"


@pytest.mark.parametrize("size", ["640", "640x", "10x10", "640x560x3", "-640x560", "9999x9999"])
def test_an_impossible_size_is_refused(path: Path, tmp_path: Path, size: str) -> None:
    said = refused(path, tmp_path / "a.gif", f"--size={size}")
    assert said == f"--size must be 320x240 to 1280x960 for a .gif, got '{size}'."


@pytest.mark.parametrize("view", ["40", "40,25,3", "x,y", "nan,3", "500,3", "0,91"])
def test_an_impossible_view_is_refused(path: Path, tmp_path: Path, view: str) -> None:
    assert "--from must be AZIMUTH,ELEVATION in degrees" in refused(
        path, tmp_path / "a.png", f"--from={view}"
    )


def test_a_row_without_a_pose_is_refused(path: Path, tmp_path: Path) -> None:
    assert refused(path, tmp_path / "a.png", grasp=2) == (
        "There is nothing of row 2 to show: it is a dead end, for which decoding found no pose."
    )
    assert not (tmp_path / "a.png").exists()
