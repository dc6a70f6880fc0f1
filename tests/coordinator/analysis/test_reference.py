from pathlib import Path

import numpy as np
import pytest

from qdgrasp_coordinator.analysis.reference import BuiltFrom, ReferenceSet, is_stand_in, read_reference
from qdgrasp_protocol.errors import AssetError, InputError, UnknownName


def written(path: Path, **arrays: object) -> Path:
    np.savez(path, **{key.replace("__", "."): value for key, value in arrays.items()})
    return path


CM = np.array([[1, 2, 3], [-1, 2, 3]], dtype=np.int16)


def test_a_set_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = written(tmp_path / "set.npz", mug__cm=CM, mug__fitness=np.array([0, 2], np.uint8))
    mug = read_reference(path, "mug")
    assert mug.cells.tolist() == CM.tolist()
    assert mug.robust.cells.tolist() == [[-1, 2, 3]]
    assert (len(mug), len(mug.robust)) == (2, 1)


def test_an_empty_set_is_a_set(tmp_path: Path) -> None:
    path = written(tmp_path / "set.npz", mug__cm=CM[:0], mug__fitness=np.zeros(0, np.uint8))
    assert len(read_reference(path, "mug")) == 0


def test_an_object_that_the_set_lacks_is_refused_and_those_it_has_are_named(tmp_path: Path) -> None:
    fitness = np.zeros(2, np.uint8)
    path = written(tmp_path / "set.npz", mug__cm=CM, mug__fitness=fitness, bowl__cm=CM, bowl__fitness=fitness)
    with pytest.raises(UnknownName, match=r"'ycb_mug'.*Known: bowl, mug"):
        read_reference(path, "ycb_mug")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"No reference set can be read at .*no\.npz.*No such file"):
        read_reference(tmp_path / "no.npz", "mug")


@pytest.mark.parametrize(
    "content", [b"", b"hello", b"PK\x03\x04 broken", b"\x93NUMPY\x01\x00", b"\x80\x04N."]
)
def test_what_is_not_an_npz_file_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "set.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"is not an npz file of plain arrays"):
        read_reference(path, "mug")


def test_one_array_in_npy_form_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "set.npy"
    np.save(path, CM)
    with pytest.raises(InputError, match=r"is not an npz file of plain arrays"):
        read_reference(path, "mug")


def test_pickled_objects_are_not_loaded(tmp_path: Path) -> None:
    path = written(tmp_path / "set.npz", mug__cm=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError, match=r"is not an npz file of plain arrays"):
        read_reference(path, "mug")


def test_an_archive_of_other_arrays_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "poses.npz", base_position=np.zeros((2, 3)))
    with pytest.raises(AssetError, match=r"holds no reference set.*found base_position"):
        read_reference(path, "mug")


@pytest.mark.parametrize(
    ("cm", "fitness", "reason"),
    [
        (CM / 100, np.zeros(2), r"whole numbers \(n, 3\), got float64 \(2, 3\)"),
        (CM[0], np.zeros(2), "whole numbers"),
        (CM, np.zeros(3), r"must be \(2,\), got float64 \(3,\)"),
        (CM[[0, 0]], np.zeros(2), "more than once"),
    ],
)
def test_arrays_of_another_form_are_refused(
    tmp_path: Path, cm: np.ndarray, fitness: np.ndarray, reason: str
) -> None:
    path = written(tmp_path / "set.npz", mug__cm=cm, mug__fitness=fitness)
    with pytest.raises(AssetError, match=reason):
        read_reference(path, "mug")


def test_a_set_without_fitness_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match=r"got nothing"):
        read_reference(written(tmp_path / "set.npz", mug__cm=CM), "mug")


def mug(origin: BuiltFrom | None) -> ReferenceSet:
    return ReferenceSet("mug", CM.astype(np.int64), np.zeros(2, np.uint8), origin)


def test_the_scan_and_its_stand_in_compare_and_nothing_else_does() -> None:
    for origin in (None, BuiltFrom("panda", "ycb_mug", "scan", ("paper",))):
        assert not is_stand_in("ycb_mug", "another scan", mug(origin))
        assert is_stand_in("mug", "stand-in", mug(origin))
        with pytest.raises(
            InputError, match=r"'ycb_mug' or on the stand-in 'mug', but this run is on 'ycb_bowl'"
        ):
            is_stand_in("ycb_bowl", "bowl", mug(origin))


def test_a_set_of_our_own_compares_with_the_object_that_it_was_built_from_and_no_other() -> None:
    own = mug(BuiltFrom("panda", "part.stl", "part", ("paper",)))
    assert not is_stand_in("moved/elsewhere/part.stl", "part", own)
    for name in ("part.stl", "mug", "ycb_mug"):
        with pytest.raises(InputError, match=rf"built from runs on 'part.stl', but this run is on '{name}'"):
            is_stand_in(name, "another", own)
