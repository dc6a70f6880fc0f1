"""Without the packages of extras: the main job to its end, and a sentence for each feature that needs one."""

import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import made_scene
from typer.testing import CliRunner

from qdgrasp_protocol.errors import EXTRAS, InputError
from qdgrasp_tools.cli.main import app

ROOT = Path(__file__).parents[2]
IMPORTED = {
    "pin": "pinocchio",
    "prometheus-client": "prometheus_client",
    "sse-starlette": "sse_starlette",
    "mujoco-warp": "mujoco_warp",
    "warp-lang": "warp",
}
"""Import names of packages with another name."""
SCENE = ("--gripper", "panda", "--object", "tennis_ball")
LEFT_OUT = sorted(name for names in EXTRAS.values() for name in names)


@pytest.fixture
def without_extras(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A folder with a run and files of each kind that is read; no package of an extra can be imported."""
    for name in LEFT_OUT:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.chdir(tmp_path)
    record(Path("finished"), made_scene(), random_rows(100), evaluations=100)
    Path("grasps.h5").write_bytes(b"\x89HDF\r\n\x1a\nmore")
    Path("grasps.parquet").write_bytes(b"PAR1 more")
    Path("objects.parquet").write_bytes(b"PAR1 more")
    return tmp_path


CAMPAIGN = ("campaign", "--gripper", "panda", "--out", "made")
EXPORT = ("export", "finished", "-o", "made", "--format")
IMPORT = ("import", *SCENE, "-o", "made.npz")


@pytest.mark.parametrize(
    ("words", "need", "package", "extra"),
    [
        ((*CAMPAIGN, "objects.parquet"), "objects.parquet", "pyarrow", "export"),
        ((*EXPORT, "acronym"), "The format acronym", "h5py", "export"),
        ((*EXPORT, "parquet"), "The format parquet", "pyarrow", "export"),
        ((*IMPORT, "grasps.h5"), "grasps.h5", "h5py", "export"),
        ((*IMPORT, "grasps.parquet"), "grasps.parquet", "pyarrow", "export"),
        (("view", "finished"), "The page", "prometheus_client", "monitor"),
    ],
    ids=lambda value: " ".join(value[:2]) if isinstance(value, tuple) else "",
)  # fmt: skip
def test_a_feature_names_the_extra_that_it_needs_and_writes_nothing(
    without_extras: Path, words: tuple[str, ...], need: str, package: str, extra: str
) -> None:
    before = sorted(without_extras.rglob("*"))
    check_refusal(CliRunner().invoke(app, list(words)).exception, need, package, extra)
    assert sorted(without_extras.rglob("*")) == before


def check_refusal(refused: BaseException | None, need: str, package: str, extra: str) -> None:
    assert isinstance(refused, InputError), refused
    assert refused.exit_code == 2
    said = f"{need} needs {package}, which is not installed here; "
    assert said + f"install it with `pip install 'qdgrasp[{extra}]'`." in str(refused)


def test_the_extras_are_those_of_the_distribution() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    listed = project["optional-dependencies"]
    for extra, packages in EXTRAS.items():
        names = [Requirement(text).name for text in listed[extra]]
        assert {IMPORTED.get(name, name) for name in names} == set(packages)
    (every,) = map(Requirement, listed["all"])
    assert every.extras == {*EXTRAS, "worker"} - {"arm", "gpu"}
    base = {Requirement(text).name for text in project["dependencies"]}
    assert not base & {name for names in EXTRAS.values() for name in names}
