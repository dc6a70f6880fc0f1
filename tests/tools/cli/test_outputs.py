"""Refusals of every command for a path that it cannot read or write."""

from pathlib import Path

import pytest
import trimesh
from tests.assets import example_hands
from tests.coordinator.scenes import SceneMaker
from tests.tools.export.foreign_files import ISAAC
from tests.tools.report.test_run_report import OUTCOMES, run_of
from typer.testing import CliRunner, Result

from qdgrasp_protocol.errors import OutputError
from qdgrasp_tools.cli.main import app

FILES = {
    "evaluate": "evaluate --gripper panda --object mug --poses poses.npz --out OUT.npz",
    "export": "export run --format csv -o OUT.csv",
    "gripper new": "gripper new jaw.urdf -o OUT.toml",
    "import": "import grasps.yaml --gripper panda --object mug -o OUT.npz",
    "object check": "object check part.stl --no-parts --repaired OUT.stl",
    "render": "render run --grasp 1 -o OUT.png",
}
"""Commands that write a file, by name."""
FOLDERS = {
    "analyse": "analyse run --out OUT",
    "campaign": "campaign campaign.toml --out OUT",
    "export graspgen": "export run --format graspgen -o OUT",
    "rerank": "rerank run --out OUT",
    "run": "run --gripper panda --object mug --evaluations 10 --out OUT",
    "security init": "security init OUT",
}
"""Commands that write a folder."""
CAMPAIGN = '[[cross]]\ngripper = "panda"\nobject = "mug"\nmethod = "me_rand"\n'


@pytest.fixture
def home(tmp_path: Path, make_scene: SceneMaker, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with all that the commands read."""
    run_of(tmp_path / "run", make_scene(), OUTCOMES)
    (tmp_path / "jaw.urdf").write_text(example_hands.JAW_URDF)
    (tmp_path / "grasps.yaml").write_text(ISAAC)
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    trimesh.creation.box((0.04, 0.05, 0.06)).export(tmp_path / "part.stl")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "cache"))
    return tmp_path


def done(command: str, out: str) -> Result:
    return CliRunner().invoke(app, command.replace("OUT", out).split())


def refused(command: str, out: str = "out") -> str:
    error = done(command, out).exception
    assert isinstance(error, OutputError), error
    assert error.exit_code == 2
    return str(error)


def written(command: str, out: str = "out") -> Path:
    """The path that a command is to write to."""
    return Path(next(word for word in command.split() if "OUT" in word).replace("OUT", out))


def flag(command: str) -> str:
    return next((name for name in ("--repaired", "--picture") if name in command), "--out")


def each(*tables: dict[str, str]) -> pytest.MarkDecorator:
    found = {f"{name} {flag(command)}": command for table in tables for name, command in table.items()}
    return pytest.mark.parametrize("command", found.values(), ids=found)


@pytest.mark.usefixtures("home")
@each(FILES)
def test_a_file_that_is_there_stays(command: str) -> None:
    out = written(command)
    out.write_text("mine")
    force = "" if flag(command) == "--repaired" else ", or replace it with --force"
    assert refused(command) == f"{out} is there already; name another path with {flag(command)}{force}."
    assert out.read_text() == "mine"


@pytest.mark.usefixtures("home")
@pytest.mark.parametrize(
    ("command", "read"),
    [
        ("evaluate --gripper panda --object part.stl --poses poses.npz --out OUT --force", "poses.npz"),
        ("evaluate --gripper panda --object part.stl --poses poses.npz --out OUT --force", "part.stl"),
        ("import grasps.yaml --gripper hand.toml --object part.stl -o OUT --force", "grasps.yaml"),
        ("import grasps.yaml --gripper hand.toml --object part.stl -o OUT --force", "hand.toml"),
        ("import grasps.yaml --gripper hand.toml --object part.stl -o OUT --force", "part.stl"),
        ("gripper new urdf.toml -o OUT --force", "urdf.toml"),
    ],
)
def test_a_file_takes_the_place_of_none_that_is_read(command: str, read: str) -> None:
    for name in {"poses.npz", "hand.toml", "urdf.toml"} & {read}:
        Path(name).write_text("mine")
    before = Path(read).read_bytes()
    assert refused(command, read) == (f"{read} is a file that is read here; name another path with --out.")
    assert Path(read).read_bytes() == before


@pytest.mark.usefixtures("home")
@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("gripper check jaw.urdf --picture out", "jaw"),
        ("object check part.stl --picture out", "part"),
    ],
)
def test_a_picture_takes_the_place_of_none_that_others_made(command: str, name: str) -> None:
    Path("out").mkdir()
    theirs = Path(f"out/{name}.png")
    theirs.write_bytes(b"\x89PNG, mine")
    assert refused(command).startswith(
        f"{theirs} is there already, and was not made by qdgrasp; name another path with --picture"
    )
    assert theirs.read_bytes() == b"\x89PNG, mine"


@pytest.mark.usefixtures("home")
@each(FOLDERS)
def test_a_folder_takes_the_place_of_no_other_files(command: str) -> None:
    Path("out").mkdir()
    Path("out/thesis").write_text("mine")
    assert refused(command).startswith("out holds other files (thesis); name another path")
    assert Path("out/thesis").read_text() == "mine"


@pytest.mark.parametrize("name", ["export", "gripper new", "import", "object check"])
def test_what_is_refused_for_another_reason_makes_no_folder(home: Path, name: str) -> None:
    for file in ("jaw.urdf", "grasps.yaml", "run/run.sqlite", "part.stl"):
        (home / file).write_text("damaged")
    before = sorted(home.iterdir())
    assert done(FILES[name], "new/folder/out").exit_code != 0
    assert sorted(path for path in home.iterdir() if path.name != "cache") == before
