import io
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import pytest
from tests.coordinator.scenes import SceneMaker

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics.reference_coverage import ReferenceLookup, read_references
from qdgrasp_protocol.errors import AssetError, InputError


def written(path: Path, **arrays: object) -> Path:
    np.savez(path, **{key.replace("__", "."): value for key, value in arrays.items()})
    return path


CM = np.array([[1, 2, 3], [-1, 2, 3]], dtype=np.int16)


def test_a_set_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = written(tmp_path / "set.npz", mug__cm=CM, mug__fitness=np.array([0, 2], np.uint8))
    mug = read_references(path)["mug"]
    assert mug.cells.tolist() == CM.tolist()
    assert mug.robust.cells.tolist() == [[-1, 2, 3]]
    assert (len(mug), len(mug.robust)) == (2, 1)


def saved(save: Callable[..., None], *given: object) -> bytes:
    """Return the bytes of a file of arrays."""
    file = io.BytesIO()
    save(file, *given)
    return file.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        *(b"", b"hello", b"PK\x03\x04 broken", b"\x93NUMPY\x01\x00", b"\x80\x04N."),
        saved(np.save, CM),
        saved(partial(np.savez, **{"mug.cm": np.array([{"a": 1}], dtype=object)})),
    ],
    ids=["empty", "text", "zip", "numpy", "pickle", "one array", "pickled objects"],
)
def test_what_is_not_an_npz_file_of_plain_arrays_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "set.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"is not an npz file of plain arrays"):
        read_references(path)


@pytest.mark.parametrize(
    ("arrays", "reason"),
    [
        ({"base_position": np.zeros((2, 3))}, r"holds no reference set.*found base_position"),
        ({"mug__cm": CM}, "mug.fitness"),
        ({"mug__cm": CM, "mug__fitness": np.zeros(3)}, r"mug has cells \(2, 3\) and fitness \(3,\)"),
    ],
)
def test_arrays_of_another_form_are_refused(tmp_path, arrays, reason) -> None:
    with pytest.raises(AssetError, match=reason):
        read_references(written(tmp_path / "set.npz", **arrays))


@pytest.fixture
def published(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An asset path with sets of one hand: of `block`, and an empty one of `mug`."""
    file = tmp_path / "assets/reference/S_G_bh280.npz"
    file.parent.mkdir(parents=True)
    cells, fitness = np.array([[0, 0, 1], [0, 0, 2]], np.int16), np.array([0, 2], np.uint8)
    written(file, block__cm=cells, block__fitness=fitness, mug__cm=cells[:0], mug__fitness=fitness[:0])
    monkeypatch.setenv("QDGRASP_ASSET_PATH", str(tmp_path / "assets"))
    return file


def on(scene: Scene, name: str) -> Scene:
    return msgspec.structs.replace(scene, object=msgspec.structs.replace(scene.object, name=name))


@pytest.mark.parametrize("hand", ["bh280", "ref_bh280", "barrett"])
@pytest.mark.parametrize(("name", "stand_in"), [("block", True), ("ycb_block", False)])
def test_the_published_set_of_a_hand_serves_its_models_and_stand_ins_are_marked(
    published: Path, make_scene: SceneMaker, hand: str, name: str, stand_in: bool
) -> None:
    found = ReferenceLookup().of(on(make_scene(hand), name), name)
    assert (found.size, found.stand_in, found.why) == (2, stand_in, "")
    other = ReferenceLookup().of(on(make_scene(hand), name), "parts/block.stl")
    assert (other.size, other.why) == (0, "no S_G of bh280 and block")


def test_a_named_file_says_its_hand_by_its_name_and_goes_before_the_published_ones(
    published, tmp_path, make_scene
):
    scene = on(make_scene("barrett"), "ycb_block")
    own = written(tmp_path / "S_G_bh280.npz", block__cm=CM[:1], block__fitness=np.zeros(1, np.uint8))
    assert ReferenceLookup([own]).of(scene, "ycb_block").size == 1
    assert ReferenceLookup([own]).of(on(make_scene("jaw"), "ycb_block"), "ycb_block").size == 0
