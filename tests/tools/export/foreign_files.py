"""Files of grasps as other tools write them, all of one and the same grasp."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from qdgrasp_tools.export.grasp_table import UnreadableGrasps
from qdgrasp_tools.export.importer import ImportedPoses
from qdgrasp_tools.export.jaw_files import DATA, INDEX_FILE

COM = np.array([0.01, 0.02, 0.03])
POSITION, TURN = [0.1, -0.2, 0.3], Rotation.from_euler("xyz", [20, -50, 130], degrees=True)
ACROSS = Rotation.from_euler("z", -90, degrees=True)
ISAAC = """format: isaac_grasp
format_version: 1.0
object_frame_link: /World/mug
gripper_frame_link: /World/panda_hand
grasps:
  "grasp 0":
    confidence: 0.7
    position: [0.1, -0.2, 0.3]
    orientation: {{w: {3!r}, xyz: [{0!r}, {1!r}, {2!r}]}}
    cspace_position:
      panda_finger_joint1: 0.02
    pregrasp_cspace_position:
      panda_finger_joint1: 0.04
""".format(*TURN.as_quat().tolist())


def matrix(turn: Rotation = TURN * ACROSS) -> np.ndarray:
    """The pose (4, 4) of a hand whose axes open along x."""
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = turn.as_matrix(), POSITION
    return transform


def acronym(path: Path, transforms: Any, **datasets: Any) -> None:
    """A file as the data set has them."""
    with h5py.File(path, "w") as file:
        file["grasps/transforms"] = transforms
        file["grasps/qualities/flex/object_in_gripper"] = np.ones(len(transforms), np.int64)
        for name, value in ({"object__scale": 1.0} | datasets).items():
            file[name.replace("__", "/")] = value


def imported_file(out: Path) -> Path:
    """The file of an export that is imported: of a folder the JSON of its grasps."""
    (found,) = set((out / DATA).iterdir()) - {out / DATA / INDEX_FILE} if out.is_dir() else [out]
    return found


def check_pose(found: ImportedPoses, position: Any = POSITION - COM) -> None:
    """The one grasp that all files here tell."""
    np.testing.assert_allclose(found.arrays["base_position"], [position], atol=1e-7)
    turn = Rotation.from_quat(found.arrays["base_quaternion_xyzw"][0]).inv() * TURN
    assert turn.magnitude() < 1e-6


def check_refusal(read: Callable[..., ImportedPoses], path: Path, why: str) -> None:
    with pytest.raises(UnreadableGrasps) as refused:
        read(path)
    sentence = str(refused.value)
    assert sentence.startswith(f"No grasps can be read from '{path}': ")
    assert why in sentence
    assert "\n" not in sentence
