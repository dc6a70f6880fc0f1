"""`qdgrasp import` writes poses and the command that scores them."""

from pathlib import Path

import numpy as np
import trimesh
from tests.tools.export.foreign_files import ISAAC, POSITION, acronym, matrix
from typer.testing import CliRunner, Result

from qdgrasp_coordinator.search.fixed_poses import read_poses
from qdgrasp_tools.cli.main import app
from qdgrasp_tools.export.importer import object_frame


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
