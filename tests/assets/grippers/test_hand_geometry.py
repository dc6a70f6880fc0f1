import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.coordinator.scenes import made_scene

from qdgrasp_assets.grippers.hand_geometry import hand_geometry

AT_HOME = np.array([0, 0, 0, 0, 0, 0, 1.0])


def test_the_fingers_stand_where_their_joints_put_them() -> None:
    posed = hand_geometry(made_scene().gripper).place_meshes(AT_HOME, np.array([0.03, 0.01]))
    found = {shape.link: np.stack([points.min(axis=0), points.max(axis=0)]) for shape, points in posed}
    assert np.allclose(found["palm"][:, 2], [0.0, 0.06])
    assert np.allclose(found["left_finger"][:, 1], [0.03, 0.05])
    assert np.allclose(found["right_finger"][:, 1], [-0.03, -0.01])
    assert np.allclose(found["left_finger"][:, 2], [0.06, 0.11])


def test_the_hand_goes_where_its_base_is() -> None:
    turned = Rotation.from_rotvec([0.3, -0.5, 1.1])
    pose = np.concatenate([[0.1, -0.2, 0.3], turned.as_quat()])
    hand = hand_geometry(made_scene().gripper)
    home, away = (hand.place_meshes(at, np.array([0.02, 0.02])) for at in (AT_HOME, pose))
    for (_, points), (_, moved) in zip(home, away, strict=True):
        assert np.allclose(turned.apply(points) + pose[:3], moved)


@pytest.mark.parametrize("protocol", ["paper", "released"])
def test_the_carrier_of_a_reference_hand_is_not_drawn(reference_data, monkeypatch, protocol) -> None:
    from qdgrasp_assets.catalog import find_gripper

    monkeypatch.setenv("QDGRASP_ASSET_PATH", str(reference_data))
    drawn = hand_geometry(find_gripper("ref_panda_2f").on_carrier(protocol))
    points = np.concatenate([points for _, points in drawn.place_meshes(AT_HOME, np.array([0.04, 0.04]))])
    assert {shape.link for shape in drawn.shapes} == {"panda_hand", "panda_leftfinger", "panda_rightfinger"}
    assert np.allclose(points.max(axis=0)[2], 0.1124, atol=2e-3)
