"""Frames of objects and hands."""

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from qdgrasp_assets.grippers.gripper_file import OriginalBase
from qdgrasp_assets.scene import Scene
from qdgrasp_tools.export.grasp_reader import scene_original_base
from qdgrasp_tools.export.grasp_table import from_matrices, to_matrices


@pytest.fixture
def poses() -> np.ndarray:
    random = np.random.default_rng(0)
    quaternions = Rotation.random(50, rng=random).as_quat()
    return np.hstack([random.normal(size=(50, 3)), np.where(quaternions[:, 3:] < 0, -1, 1) * quaternions])


def test_matrices_are_those_of_another_library_and_lead_back(poses: np.ndarray) -> None:
    matrices = to_matrices(poses)
    np.testing.assert_allclose(matrices[:, :3, :3], Rotation.from_quat(poses[:, 3:]).as_matrix(), atol=1e-14)
    np.testing.assert_array_equal(matrices[:, 3], np.tile([0, 0, 0, 1], (50, 1)))
    np.testing.assert_allclose(from_matrices(matrices), poses, atol=1e-14)


def test_a_scene_tells_the_original_base_link_of_a_hand_that_was_given_another(scene: Scene) -> None:
    assert scene_original_base(scene.gripper) is None
    centred = """<robot name="hand"><link name="palm_centre"/><link name="palm"/>
    <joint name="palm_centre_joint" type="fixed"><parent link="palm_centre"/><child link="palm"/>
    <origin xyz="-0.08 0 0.01"/></joint></robot>"""
    hand = msgspec.structs.replace(scene.gripper, urdf=centred, base_link="palm_centre")
    assert scene_original_base(hand) == OriginalBase(link="palm", position=(-0.08, 0.0, 0.01))
    other = msgspec.structs.replace(hand, urdf=centred.replace('"fixed"', '"revolute"'))
    assert scene_original_base(other) is None
