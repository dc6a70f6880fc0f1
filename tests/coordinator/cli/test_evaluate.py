"""`qdgrasp evaluate`: what it does not write over."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from qdgrasp_coordinator.cli.main import app
from qdgrasp_protocol.errors import FolderError, InputError


def refusal(*arguments: object) -> str:
    asked = ("evaluate", "--gripper", "panda", "--object", "mug", *map(str, arguments))
    error = CliRunner().invoke(app, asked).exception
    assert isinstance(error, FolderError)
    return str(error)


@pytest.mark.parametrize(("given", "missing"), [((), "--poses"), (("--poses", "poses.npz"), "--out")])
def test_files_that_are_not_named_are_asked_for(given: tuple[str, ...], missing: str) -> None:
    error = CliRunner().invoke(app, ["evaluate", "--gripper", "panda", "--object", "mug", *given]).exception
    assert isinstance(error, InputError)
    assert str(error).startswith(f"{missing} is missing: name an npz file")


@pytest.fixture
def poses(tmp_path: Path) -> Path:
    turns = np.array([[0.0, 0.0, 0.0, 1.0]])
    np.savez(tmp_path / "poses.npz", base_position=np.zeros((1, 3)), base_quaternion_xyzw=turns)
    return tmp_path / "poses.npz"


def test_poses_are_not_replaced_by_their_scores_even_by_force(poses: Path) -> None:
    before = poses.read_bytes()
    (poses.parent / "again.npz").hardlink_to(poses)
    for out in (poses, poses.parent / "again.npz"):
        assert "is a file that is read here" in refusal("--poses", poses, "--out", out, "--force")
    assert poses.read_bytes() == before


def test_scores_that_are_there_are_kept_unless_force_is_given(poses: Path) -> None:
    out = poses.parent / "scores.npz"
    out.write_bytes(b"precious")
    assert "is there already; name another path with --out, or replace it with --force" in refusal(
        "--poses", poses, "--out", out
    )
    assert out.read_bytes() == b"precious"
    assert "is a folder, where a file is to be written" in refusal(
        "--poses", poses, "--out", poses.parent, "--force"
    )
