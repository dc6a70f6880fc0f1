"""Poses from outside: what is read, what is refused, and what goes back."""

import numpy as np
import pytest

from qdgrasp_coordinator.poses import read_poses, scores, write_scores
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Shape

POSES = {
    "base_position": np.array([[0.0, 0.0, 0.1], [0.1, 0.0, 0.0]]),
    "base_quaternion_xyzw": np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 2.0]]),
}


def saved(path, **arrays):
    np.savez(path, **arrays)
    return path


def test_positions_and_quaternions_are_enough(tmp_path):
    poses = read_poses(saved(tmp_path / "poses.npz", **POSES, notes=np.arange(5)))
    assert len(poses) == 2
    assert (poses.synergies == -1).all()
    assert np.isnan(poses.spreads).all()


def test_no_synergy_and_no_spread_are_accepted_for_every_hand(tmp_path):
    arrays = {**POSES, "synergy": np.array([-1, -1], np.int8), "spread": np.full((2, 2), np.nan)}
    assert len(read_poses(saved(tmp_path / "poses.npz", **arrays))) == 2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"base_position": np.zeros((2, 2))}, "shape (n, 3)"),
        ({"base_position": np.zeros((3, 3))}, "3 rows"),
        ({"base_position": np.full((2, 3), np.nan)}, "not finite"),
        ({"base_quaternion_xyzw": np.zeros((2, 4))}, "length zero"),
        ({"synergy": np.zeros(3, np.int8)}, "synergy"),
        ({"synergy": np.array(["thumb", "index"])}, "synergy"),
        ({"synergy": np.array([np.inf, 0.0])}, "infinite"),
        ({"base_position": np.zeros((0, 3)), "base_quaternion_xyzw": np.zeros((0, 4))}, "no poses"),
    ],
)
def test_arrays_that_cannot_be_are_named(tmp_path, change, words):
    with pytest.raises(InputError, match=r".") as raised:
        read_poses(saved(tmp_path / "poses.npz", **(POSES | change)))
    assert words in str(raised.value)


def test_a_missing_array_is_named_with_those_that_are_there(tmp_path):
    with pytest.raises(InputError, match=r"base_quaternion_xyzw.*base_position"):
        read_poses(saved(tmp_path / "poses.npz", base_position=POSES["base_position"]))


@pytest.mark.parametrize("content", [b"", b"no zip at all", b"PK\x03\x04 cut short"])
def test_a_file_that_is_no_npz_is_refused_in_one_sentence(tmp_path, content):
    (tmp_path / "poses.npz").write_bytes(content)
    with pytest.raises(InputError, match=r"poses\.npz"):
        read_poses(tmp_path / "poses.npz")


def test_a_lone_array_is_no_npz(tmp_path):
    np.save(tmp_path / "poses.npy", POSES["base_position"])
    with pytest.raises(InputError, match="not an npz file"):
        read_poses(tmp_path / "poses.npy")


def test_pickled_arrays_are_never_loaded(tmp_path):
    np.savez(tmp_path / "poses.npz", base_position=np.array([{}], dtype=object))
    with pytest.raises(InputError):
        read_poses(tmp_path / "poses.npz")


def test_scores_are_false_and_zero_for_overlaps(tmp_path):
    rows = Shape(genes=7, joints=2).empty(3)
    rows["outcome"] = [Outcome.OVERLAP, Outcome.BRUSHED, Outcome.HELD]
    rows["fitness"] = [0, 0, 2]
    found = scores(rows)
    assert found["valid"].tolist() == [False, True, True]
    assert found["touched"].tolist() == [False, True, True]
    assert found["success"].tolist() == [False, False, True]
    assert found["fitness"].tolist() == [0, 0, 2]
    assert found["fitness"].dtype == np.uint8
    write_scores(tmp_path / "scores.npz", rows)
    with np.load(tmp_path / "scores.npz", allow_pickle=False) as file:
        assert set(file.files) == set(found)


def test_a_place_that_cannot_be_written_is_named_and_nothing_is_left(tmp_path):
    with pytest.raises(InputError, match="nowhere"):
        write_scores(tmp_path / "nowhere" / "scores.npz", Shape(genes=7, joints=2).empty(1))
    assert list(tmp_path.iterdir()) == []
