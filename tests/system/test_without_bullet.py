"""Without PyBullet: runs in MuJoCo to their end, and refusals of all that needs Bullet."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import made_scene
from tests.system.commands import Commands, end_of
from tests.system.test_without_extras import LEFT_OUT
from typer.testing import CliRunner

import qdgrasp as api
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.spec import MissingEngine
from qdgrasp_tools.cli.main import app

SCENE = ("--gripper", "panda", "--object", "tennis_ball")
CAMPAIGN = """
[defaults]
gripper = "panda"
evaluations = 20
protocol = "physical"
[[cross]]
object = ["tennis_ball"]
engine = ["mujoco", "bullet"]
"""


@pytest.fixture
def without_bullet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A folder with a run in Bullet, poses and a campaign; PyBullet cannot be imported."""
    monkeypatch.setitem(sys.modules, "pybullet", None)
    monkeypatch.chdir(tmp_path)
    record(tmp_path / "finished", made_scene(), random_rows(60), evaluations=60)
    np.savez("poses.npz", base_position=np.zeros((1, 3)), base_quaternion_xyzw=np.eye(4)[3:])
    Path("both.toml").write_text(CAMPAIGN)
    return tmp_path


def files_in(folder: Path) -> list[Path]:
    """All files but those that SQLite makes to read."""
    return sorted(path for path in folder.rglob("*") if not path.name.startswith("run.sqlite-"))


@pytest.mark.parametrize(
    "words",
    [
        ("run", *SCENE, "--evaluations", "20", "--out", "made", "--engine", "bullet"),
        ("evaluate", *SCENE, "--poses", "poses.npz", "--out", "made/scores.npz", "--protocol", "released"),
        ("verify", "finished"),
        ("campaign", "both.toml", "--out", "made"),
    ],
    ids=lambda words: words[0],
)
def test_what_needs_bullet_is_refused_before_anything_is_written(without_bullet: Path, words) -> None:
    before = files_in(without_bullet)
    refused = CliRunner().invoke(app, list(words)).exception
    assert isinstance(refused, MissingEngine), refused
    assert refused.exit_code == 2
    assert "PyBullet is not installed" in str(refused)
    assert "--engine mujoco" in str(refused)
    assert files_in(without_bullet) == before


def test_a_program_is_refused_too_unless_others_evaluate(without_bullet: Path) -> None:
    with pytest.raises(MissingEngine):
        api.evaluate(np.zeros((1, 3)), np.eye(4)[3:], gripper="panda", object="tennis_ball", engine="bullet")
    elsewhere = api.Place(workers=0, connect="tcp/localhost:1")
    api.Evaluations(gripper="panda", object="tennis_ball", engine="bullet", place=elsewhere)


def test_a_run_in_mujoco_is_carried_out_verified_and_exported_without_extras_too(qdgrasp: Commands) -> None:
    absent = [*LEFT_OUT, "pybullet"]
    (qdgrasp.home / "absent").mkdir()
    blocked = f"import sys; sys.modules.update(dict.fromkeys({absent}))"
    (qdgrasp.home / "absent" / "sitecustomize.py").write_text(blocked)
    paths = os.pathsep.join([str(qdgrasp.home / "absent"), os.environ.get("PYTHONPATH", "")])

    def said(*words: object) -> str:
        return end_of(qdgrasp.start(*words, PYTHONPATH=paths))[0]

    _, told = end_of(
        qdgrasp.start("run", *SCENE, "--evaluations", 20, "--workers", 1, "--out", "run", PYTHONPATH=paths)
    )
    assert "mujoco" in told.splitlines()[0]
    assert RunFolder.open(qdgrasp.home / "run").spec.engine == "mujoco"
    with RunFolder.open(qdgrasp.home / "run").journal() as journal:
        assert {"mujoco", "mujoco_probes"} <= journal.platform.keys()
        assert not {"pybullet", "probes"} & journal.platform.keys()
    assert "this platform" in said("verify", "run", "--workers", 1)
    said("render", "run", "--grasp", 0, "-o", "drawn.png")
    said("export", "run", "--format", "isaac", "-o", "g.yaml")
    assert all((qdgrasp.home / name).stat().st_size for name in ("drawn.png", "g.yaml"))
