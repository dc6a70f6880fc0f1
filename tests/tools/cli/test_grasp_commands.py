"""`qdgrasp evaluate` and `import`: nothing is replaced unasked."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from tests.tools.export.foreign_files import ISAAC, POSITION, acronym, matrix
from typer.testing import CliRunner, Result

from qdgrasp_coordinator.search.fixed_poses import read_poses
from qdgrasp_protocol.errors import FolderError, InputError
from qdgrasp_tools.cli.main import app
from qdgrasp_tools.export.importer import object_frame


def refusal(*arguments: object) -> InputError:
    asked = ("evaluate", "--gripper", "panda", "--object", "mug", *map(str, arguments))
    error = CliRunner().invoke(app, asked).exception
    assert isinstance(error, InputError)
    return error


@pytest.fixture
def poses(tmp_path: Path) -> Path:
    turns = np.array([[0.0, 0.0, 0.0, 1.0]])
    np.savez(tmp_path / "poses.npz", base_position=np.zeros((1, 3)), base_quaternion_xyzw=turns)
    return tmp_path / "poses.npz"


def test_poses_are_not_replaced_by_their_scores_even_by_force(poses: Path) -> None:
    before = poses.read_bytes()
    (poses.parent / "again.npz").hardlink_to(poses)
    for out in (poses, poses.parent / "again.npz"):
        error = refusal("--poses", poses, "--out", out, "--force")
        assert isinstance(error, FolderError)
        assert "is a file that is read here" in str(error)
    assert poses.read_bytes() == before


def command(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["import", *map(str, arguments)])


def test_the_command_writes_poses_for_evaluate_and_says_how_to_score_them(tmp_path: Path) -> None:
    (tmp_path / "f.yaml").write_text(ISAAC)
    out = tmp_path / "poses.npz"
    done = command(tmp_path / "f.yaml", "--gripper", "panda", "--object", "mug", "-o", out)
    assert done.exit_code == 0, done.exception
    scores = tmp_path / "poses-scores.npz"
    assert done.stdout.splitlines() == [
        f"1 pose written to {out}; this scores them:",
        f"  qdgrasp evaluate --gripper panda --object mug --protocol physical --poses {out} --out {scores}",
    ]
    expected = POSITION - object_frame("mug").com_in_mesh
    np.testing.assert_allclose(read_poses(out).positions, [expected], atol=1e-7)


def test_what_a_file_says_of_a_mesh_is_in_the_command_that_scores_it(tmp_path: Path) -> None:
    trimesh.creation.box((0.04, 0.05, 0.06)).export(tmp_path / "box.stl")
    acronym(tmp_path / "f.h5", [matrix()], object__mass=0.25, object__friction=1.0)
    asked = ("--gripper", "panda", "--object", tmp_path / "box.stl", "-o", tmp_path / "p.npz")
    assert (
        "--mass 0.25 --protocol physical --set friction=1.0 --poses"
        in command(tmp_path / "f.h5", *asked).stdout
    )
    (tmp_path / "f.yaml").write_text(ISAAC)
    assert (
        "box.stl --mass KG --protocol physical --poses"
        in command(tmp_path / "f.yaml", *asked, "--force").stdout
    )
