"""HDF5 that tells no grasps, and how it is refused before it is read."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from tests.coordinator.exchange.foreign import acronym, check_refusal, matrix

SKEW = np.eye(4) + 0.1 * np.eye(4, k=1)
MIRROR = np.diag([1.0, 1.0, -1.0, 1.0])
BAD_TRANSFORMS = {
    "none": (np.zeros((0, 4, 4)), "there is none in it"),
    "another shape": (np.zeros((2, 3, 4)), "must be numbers of shape (n, 4, 4)"),
    "a scalar": (np.array([1.0]), "must be numbers of shape (n, 4, 4)"),
    "words": (np.full((1, 4, 4), b"x"), "must be numbers of shape (n, 4, 4)"),
    "NaN": (np.full((1, 4, 4), np.nan), "transform 0 is not a rotation and a translation"),
    "infinity": (np.full((1, 4, 4), np.inf), "transform 0 is not a rotation and a translation"),
    "no rotation": (np.stack([np.eye(4), SKEW]), "transform 1 is not a rotation and a translation"),
    "a mirror": (np.stack([MIRROR]), "transform 0 is not a rotation and a translation"),
    "zeros": (np.zeros((1, 4, 4)), "transform 0 is not a rotation and a translation"),
    "a last row": (np.stack([np.eye(4)]) * 2, "transform 0 is not a rotation and a translation"),
}


@pytest.mark.parametrize(("transforms", "why"), BAD_TRANSFORMS.values(), ids=BAD_TRANSFORMS)
def test_hdf5_with_impossible_transforms_is_refused(panda, tmp_path: Path, transforms, why: str) -> None:
    acronym(tmp_path / "f.h5", transforms)
    check_refusal(panda, tmp_path / "f.h5", why)


BAD_DATASETS = {
    "too few positions": (
        {"gripper__joint_names": ["a", "b"], "grasps__pregrasp_joint_positions": np.zeros((1, 1))},
        "must be numbers of shape (1, 2)",
    ),
    "no names": ({"grasps__pregrasp_joint_positions": np.zeros((1, 1))}, "no dataset 'gripper/joint_names'"),
    "a label": (
        {"gripper__synergy_names": ["a"], "grasps__synergy": [5]},
        "must hold -1 or places in 'gripper/synergy_names'",
    ),
    "another synergy": ({"gripper__synergy_names": ["a"], "grasps__synergy": [0]}, "it names synergy 'a'"),
    "too few numbers": ({"qdgrasp__number": [1, 2]}, "'qdgrasp/number' must be numbers of shape (1)"),
    "words": ({"qdgrasp__about": "{}"}, "what it says of itself cannot be read"),
    "no weight": (
        {"object__mass": -1.0},
        "the object's mass in it must be a number greater than 0, and is -1",
    ),
    "a list": ({"object__friction": [1.0, 2.0]}, "'object/friction' must be a number"),
    "a list of texts": ({"qdgrasp__about": ["{}"]}, "'qdgrasp/about' must be a text"),
    "a long name": (
        {"gripper__synergy_names": ["a" * 201], "grasps__synergy": [0]},
        "its synergies must be of 200 letters at most, and 'aaaaaaaaaaaaaaaaaaaa...' is longer",
    ),
    "wide names": (
        {"gripper__synergy_names": np.array([b"a"], "S100000"), "grasps__synergy": [0]},
        "'gripper/synergy_names' must be a list of names",
    ),
    "a group": ({"qdgrasp__about__x": 1}, "its 'qdgrasp/about' is no dataset"),
}


@pytest.mark.parametrize(("datasets", "why"), BAD_DATASETS.values(), ids=BAD_DATASETS)
def test_hdf5_with_impossible_datasets_is_refused(panda, tmp_path: Path, datasets, why: str) -> None:
    acronym(tmp_path / "f.h5", [matrix()], **datasets)
    check_refusal(panda, tmp_path / "f.h5", why)


def test_hdf5_that_promises_more_than_can_be_read_is_refused_unread(panda, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file.create_dataset("grasps/transforms", (10**12, 4, 4), "f8", chunks=(1, 4, 4))
    check_refusal(panda, tmp_path / "f.h5", "it has 1000000000000 grasps; at most 2000000 are read")


def test_small_hdf5_that_promises_much_is_refused_unread(panda, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file.create_dataset("grasps/transforms", (10**6, 4, 4), "f8", chunks=(1, 4, 4))
    check_refusal(panda, tmp_path / "f.h5", "its dataset 'grasps/transforms' is far larger than the file")
    acronym(tmp_path / "g.h5", [matrix()])
    with h5py.File(tmp_path / "g.h5", "a") as file:
        file.create_dataset("qdgrasp/about", (2**40,), "f8", chunks=(1,))
    check_refusal(panda, tmp_path / "g.h5", "its dataset 'qdgrasp/about' must be a text")


def test_hdf5_that_points_out_of_itself_is_refused_unread(panda, tmp_path: Path) -> None:
    acronym(tmp_path / "whole.h5", [matrix()])
    (tmp_path / "secret").write_bytes(np.eye(4).tobytes())
    with h5py.File(tmp_path / "link.h5", "w") as file:
        file["grasps"] = h5py.ExternalLink("whole.h5", "/grasps")
    with h5py.File(tmp_path / "soft.h5", "w") as file:
        file["grasps"] = h5py.SoftLink("/grasps")
    with h5py.File(tmp_path / "raw.h5", "w") as file:
        outside = [(str(tmp_path / "secret"), 0, 128)]
        file.create_dataset("grasps/transforms", (1, 4, 4), "f8", external=outside)
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        made = h5py.VirtualLayout((1, 4, 4), "f8")
        made[:] = h5py.VirtualSource(tmp_path / "whole.h5", "grasps/transforms", (1, 4, 4))
        file.create_virtual_dataset("grasps/transforms", made)
    for name in ("link.h5", "soft.h5"):
        check_refusal(panda, tmp_path / name, "is a link to elsewhere, which is not followed")
    for name in ("raw.h5", "virtual.h5"):
        check_refusal(panda, tmp_path / name, "lies in another file, which is not read")


def test_hdf5_that_is_no_acronym_file_is_refused(panda, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file["a"] = 1
    check_refusal(panda, tmp_path / "f.h5", "it is HDF5, but not an ACRONYM file")
