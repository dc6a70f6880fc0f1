"""The rival that `qdgrasp run` is measured against: its poses close on the object."""

import numpy as np
import trimesh
from benchmarks.naive import OPENING, REACH, antipodal_poses
from scipy.spatial.transform import Rotation


def test_a_jaw_of_a_drawn_pose_closes_across_the_object() -> None:
    width = 0.04
    box = trimesh.creation.box((width, 0.2, 0.2))
    poses = antipodal_poses(box, 200, np.random.default_rng(0))
    assert len(poses)
    turns = Rotation.from_quat(poses[:, 3:])
    np.testing.assert_allclose(np.abs(turns.apply((0, 1, 0))[:, 0]), 1, atol=1e-9)
    tips = poses[:, :3] + turns.apply((0, 0, REACH))
    assert np.abs(tips[:, 0]).max() < 1e-9
    assert width < OPENING
