from pathlib import Path

import msgspec
import numpy as np
import pytest
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import SceneMaker

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.analysis.harvest import build
from qdgrasp_coordinator.analysis.target import Targets


@pytest.fixture
def published(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An asset path with sets of one hand: of `block`, and an empty one of `mug`."""
    file = tmp_path / "assets/reference/S_G_bh280.npz"
    file.parent.mkdir(parents=True)
    cells = np.array([[0, 0, 1], [0, 0, 2]], np.int16)
    np.savez(
        file,
        **{"block.cm": cells, "block.fitness": np.array([0, 2], np.uint8)},
        **{"mug.cm": cells[:0], "mug.fitness": np.zeros(0, np.uint8)},
    )
    monkeypatch.setenv("QDGRASP_ASSET_PATH", str(tmp_path / "assets"))
    return file


def on(scene: Scene, name: str) -> Scene:
    return msgspec.structs.replace(scene, object=msgspec.structs.replace(scene.object, name=name))


@pytest.mark.parametrize("hand", ["bh280", "ref_bh280", "barrett"])
@pytest.mark.parametrize(("name", "stand_in"), [("block", True), ("ycb_block", False)])
def test_the_published_set_of_a_hand_serves_its_models_and_stand_ins_are_marked(
    published: Path, make_scene: SceneMaker, hand: str, name: str, stand_in: bool
) -> None:
    found = Targets().of(on(make_scene(hand), name), name)
    assert (found.size, found.stand_in, found.why) == (2, stand_in, "")


def test_why_there_is_no_set_is_said(published: Path, make_scene: SceneMaker) -> None:
    scene = make_scene("barrett")
    assert Targets().of(on(scene, "ycb_mug"), "ycb_mug").why == "S_G of bh280 and mug is empty"
    assert Targets().of(on(scene, "ycb_bowl"), "ycb_bowl").why == "no S_G of bh280 and bowl"
    assert Targets().of(make_scene("jaw"), "block").why == "no S_G of jaw and block"


def test_another_object_of_the_same_name_is_not_compared(published: Path, make_scene: SceneMaker) -> None:
    assert Targets().of(on(make_scene("barrett"), "block"), "my/block.stl").size == 0


def test_a_set_of_one_s_own_goes_before_the_published_ones(
    published: Path, tmp_path: Path, make_scene: SceneMaker
) -> None:
    folder = record(tmp_path / "run", make_scene("barrett"), random_rows(200), gripper="barrett")
    own = tmp_path / "own.npz"
    size = len(build([folder], own)["block"])
    assert size > 2
    found = Targets([own]).of(folder.scene(), folder.spec.object)
    assert (found.size, found.stand_in) == (size, False)
    assert Targets([own]).of(make_scene("jaw"), "block.stl").size == 0


def test_a_file_without_origin_says_its_hand_by_its_name(
    published: Path, tmp_path: Path, make_scene: SceneMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("QDGRASP_ASSET_PATH")
    scene = on(make_scene("barrett"), "ycb_block")
    assert Targets().of(scene, "ycb_block").size == 0
    assert Targets([published]).of(scene, "ycb_block").size == 2
