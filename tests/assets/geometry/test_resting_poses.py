"""Resting poses of shapes with known ones."""

import numpy as np
import pytest

from qdgrasp_assets.geometry.mesh import Mesh, box, geodesic, parts_to_obj
from qdgrasp_assets.geometry.resting_poses import resting_poses
from qdgrasp_protocol.errors import AssetError


def poses_of(*parts: Mesh):
    return resting_poses(parts_to_obj(parts))


def test_a_cube_rests_on_each_side_alike_and_first_as_it_was_modelled():
    poses = poses_of(box((0.04, 0.04, 0.04)))
    assert [pose.up for pose in poses] == [
        (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0),
        (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0),
    ]  # fmt: skip
    assert [pose.probability for pose in poses] == pytest.approx([1 / 6] * 6, abs=1e-5)
    assert {pose.height for pose in poses} == {-0.02}


def test_an_object_comes_to_rest_on_its_heavy_side():
    tall = box((0.04, 0.04, 0.2)).moved((-0.03, 0.0, 0.0))
    with pytest.raises(AssetError, match="its centre of mass is not inside it"):
        poses_of(tall)
    leaning = box((0.04, 0.04, 0.2)).moved((-0.019, 0.0, 0.0))
    shares = {pose.up: pose.probability for pose in poses_of(leaning)}
    assert shares[(-1.0, 0.0, 0.0)] > 3 * shares.get((1.0, 0.0, 0.0), 0.0)


def test_a_ball_has_one_and_a_flat_object_none():
    assert len(poses_of(geodesic(0.03, 3))) == 1
    flat = Mesh(
        np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)]) * 0.1, np.array([(0, 1, 2), (1, 3, 2)])
    )
    with pytest.raises(AssetError, match="flat"):
        poses_of(flat)
