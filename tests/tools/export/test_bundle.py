"""Bundles: a folder whose script lifts the grasps in plain MuJoCo, without this project."""

import re
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from tests.common import PATIENCE
from tests.tools.export.conftest import evaluated

from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import InputError
from qdgrasp_tools.export.exporter import export_grasps
from qdgrasp_tools.export.grasp_reader import GraspChoice

ALONE = """
import runpy, sys
for room in ("", "_assets", "_protocol", "_coordinator", "_tools", "_worker"):
    sys.modules[f"qdgrasp{room}"] = None  # cannot be imported
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


@pytest.fixture(scope="module")
def mug(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """Poses of a jaw on an object whose centre of mass is beside the origin of its mesh."""
    settings = {"protocol": "physical", "engine": "mujoco"}
    return evaluated(tmp_path_factory.mktemp("mug") / "run", "panda", "mug", 150, "antipodal", **settings)


def lifted(bundle: Path, home: Path, most: int) -> tuple[int, int]:
    """How many grasps the script lifts, of how many, started in another folder."""
    command = [sys.executable, "-c", ALONE, str(bundle / "replay.py"), str(most)]
    said = subprocess.run(command, cwd=home, timeout=PATIENCE, check=True, capture_output=True, text=True)
    up, tried = re.match(r"(\d+) of (\d+) lifted", said.stdout).groups()
    return int(up), int(tried)


@pytest.mark.parametrize("frame", ["mesh", "com"])
def test_its_script_lifts_most_grasps_of_a_jaw_in_plain_mujoco(mug, tmp_path, frame) -> None:
    out, home = tmp_path / "bundle", tmp_path / "home"
    home.mkdir()
    export_grasps(mug, out, "bundle", GraspChoice(top=10), frame=frame)
    up, tried = lifted(out, home, 10)
    assert tried >= 8
    assert up >= 0.75 * tried
    with np.load(out / "grasps.npz") as grasps:
        moved = dict(grasps)
    moved["pose"][:, :3] += 0.2  # beside the object
    np.savez(out / "grasps.npz", **moved)
    assert (lifted(out, home, 3), lifted(out, home, 0)) == ((0, 3), (0, 0))


@pytest.mark.parametrize("evaluated_run", ["allegro", "barrett"], indirect=True)
def test_fingers_of_other_hands_close_in_its_script_as_they_did(evaluated_run, tmp_path) -> None:
    export_grasps(evaluated_run, tmp_path / "bundle", "bundle", GraspChoice(min_fitness=2, top=10))
    up, tried = lifted(tmp_path / "bundle", tmp_path, 10)
    assert up >= tried / 2


def test_the_hand_and_the_object_lie_beside_the_grasps(mug, tmp_path) -> None:
    said = export_grasps(mug, tmp_path / "bundle", "bundle")
    scene = mug.scene()
    assert said.startswith(f"{len(np.load(tmp_path / 'bundle' / 'grasps.npz')['pose'])} grasps")
    hand = mujoco.MjModel.from_xml_path(str(tmp_path / "bundle" / "hand" / "hand.urdf"))
    assert [hand.joint(n).name for n in range(hand.njnt)] == [joint.name for joint in scene.gripper.joints]
    mesh = trimesh.load_mesh(tmp_path / "bundle" / "object" / "mesh.obj", process=False)
    assert np.allclose(mesh.bounds, scene.object.mesh.moved(scene.object.com_in_mesh).bounds)
    with pytest.raises(InputError, match="is there already"):
        export_grasps(mug, tmp_path / "bundle", "bundle")
    export_grasps(mug, tmp_path / "bundle", "bundle", GraspChoice(top=1), force=True)
    assert len(np.load(tmp_path / "bundle" / "grasps.npz")["pose"]) == 1


def test_each_run_of_a_data_set_has_a_bundle(mug, tmp_path) -> None:
    export_grasps([mug, mug], tmp_path / "out", "bundle")
    assert len(list((tmp_path / "out" / "data").glob("*/*/replay.py"))) == 2
