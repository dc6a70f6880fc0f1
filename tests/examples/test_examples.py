"""The scripts of examples/, as a user starts them, and the demo."""

import ast
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from docs.demo import MARKER, clear
from tests.common import PATIENCE, own_endpoint
from tests.coordinator.recorded_runs import record
from tests.coordinator.scenes import made_scene
from tests.system.commands import ROUTER, Commands, end_of, says
from tests.tools.export.conftest import random_rows

import qdgrasp
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.rows import Outcome

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


class Scripts(Commands):
    """Starts scripts in a folder of their own, with budgets that are cut."""

    def start(self, name: str, *arguments: object, **cuts: str) -> subprocess.Popen[str]:
        source = (EXAMPLES / name).read_text()
        for before, after in cuts.items():
            assert source.count(f"{before}=") == 1, f"{name} says {before}= once"
            source = source.replace(f"{before}=400", f"{before}={after}")
        script = self.home / name
        script.write_text(source)
        return self.begin(script, *arguments)

    def __call__(self, name: str, *arguments: object, **cuts: str) -> str:
        return end_of(self.start(name, *arguments, **cuts))[0]


@pytest.fixture
def scripts(tmp_path: Path) -> Iterator[Scripts]:
    with Scripts(tmp_path) as scripts:
        yield scripts


@pytest.fixture
def commands(tmp_path: Path) -> Iterator[Commands]:
    with Commands(tmp_path) as commands:
        yield commands


@pytest.mark.parametrize("script", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name)
def test_a_script_is_short_and_says_how_it_is_started(script: Path) -> None:
    text = script.read_text()
    assert len(text.splitlines()) <= 40
    assert f"python {script.name}" in str(ast.get_docstring(ast.parse(text)))


def test_a_search_of_ones_own_makes_a_run_whose_grasps_are_arrays(scripts: Scripts) -> None:
    said = scripts("own_optimiser.py", "mine", evaluations="160")
    run = qdgrasp.open(scripts.home / "mine")
    assert said == f"{run.summary.words}\n"
    assert run.summary.evaluations == 160

    said = scripts("grasps.py", "mine")
    assert "160 evaluations of custom_approach" in said
    assert f"{len(run.grasps())} grasps" in said
    for grasp in run.grasps(diverse=5):
        assert f"{grasp.number}: {grasp.outcome.name} at " in said
    with np.load(scripts.home / "mine-grasps.npz") as kept:
        assert kept["poses"].tobytes() == run.grasps().settled_poses("mesh").tobytes()


VISER = """
class Handle:
    def __init__(self, value):
        self.value = value
    def on_update(self, call):
        return call
    def remove(self):
        print("removed")
class ViserServer:
    def __init__(self, host, port):
        print("served at", host, port)
        self.scene = self.gui = self.initial_camera = self
    def set_up_direction(self, direction): pass
    def add_frame(self, name, **looks): pass
    def add_dropdown(self, name, labels):
        return Handle(labels[0])
    def add_checkbox(self, name, value):
        return Handle(value)
    def add_mesh_trimesh(self, name, mesh):
        print(name, len(mesh.faces))
        return Handle(name)
    def sleep_forever(self): pass
"""
"""Stand-in for the part of viser that the example uses; viser is not installed."""


def test_grasps_are_shown_with_viser(scripts: Scripts) -> None:
    rows = random_rows(made_scene(), [Outcome.HELD] * 3)
    record(scripts.home / "mug", made_scene(), rows, method="contact_rand")
    (scripts.home / "viser.py").write_text(VISER)
    said = scripts("viser_grasps.py", "mug", 8123).splitlines()
    assert said[0] == "served at 127.0.0.1 8123"
    assert sorted(line.split()[0] for line in said[1:]) == [
        *("/hand/left_finger", "/hand/palm", "/hand/right_finger", "/object")
    ]
    assert all(int(line.split()[1]) == 12 for line in said[1:])


def test_both_of_ones_own_meet_at_a_router(scripts: Scripts, commands: Commands) -> None:
    endpoint = own_endpoint()
    router = commands.start("--listen", endpoint, module=ROUTER)
    says(router, "listening")
    worker = scripts.start("own_evaluator.py", endpoint)
    scripts("own_optimiser.py", "mine", endpoint, evaluations="120")

    run = qdgrasp.open(scripts.home / "mine")
    rows, axis = run.rows(), np.array(run.scene.gripper.approach_axis)
    assert len(rows) == 120
    lines = np.cross(rows["base_to_object"][:, :3].astype(float), turned(rows["base_to_object"][:, 3:], axis))
    is_held = np.linalg.norm(lines, axis=1) < 0.01
    assert ((rows["outcome"] == qdgrasp.Outcome.HELD) == is_held).all()
    assert is_held.any()
    assert run.summary.platform["evaluator"] == "Aim"
    for process in (worker, router):
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE) in {0, 128 + signal.SIGTERM}


def turned(quaternions: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """An axis (3,) in the frames that quaternions (n, 4) xyzw turn to: (n, 3)."""
    q = quaternions.astype(float)
    aside = 2 * np.cross(q[:, :3], axis)
    return axis + q[:, 3:] * aside + np.cross(q[:, :3], aside)


def test_an_earlier_demo_is_replaced(tmp_path):
    out = tmp_path / "demo"
    out.mkdir()
    (out / MARKER).touch()
    (out / "run.sqlite").touch()
    clear(out)
    assert not out.exists()


def test_a_folder_without_the_marker_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(FolderError, match=MARKER):
        clear(tmp_path)
    assert (tmp_path / "thesis.tex").exists()
