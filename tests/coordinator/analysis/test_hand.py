import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.analysis.hand import hand

AT_HOME = np.array([0, 0, 0, 0, 0, 0, 1.0])


def bounds(scene: Scene, pose: np.ndarray, joints: list[float]) -> dict[str, np.ndarray]:
    posed = hand(scene.gripper).posed(pose, np.array(joints))
    return {shape.link: np.stack([points.min(axis=0), points.max(axis=0)]) for shape, points in posed}


def test_the_fingers_stand_where_their_joints_put_them(make_scene) -> None:
    found = bounds(make_scene(), AT_HOME, [0.03, 0.01])
    assert np.allclose(found["palm"][:, 2], [0.0, 0.06])
    assert np.allclose(found["left_finger"][:, 1], [0.03, 0.05])
    assert np.allclose(found["right_finger"][:, 1], [-0.03, -0.01])
    assert np.allclose(found["left_finger"][:, 2], [0.06, 0.11])


def test_only_finger_links_are_fingers(make_scene) -> None:
    found = hand(make_scene().gripper)
    assert {shape.link: found.is_finger(shape) for shape in found.shapes} == {
        "palm": False,
        "left_finger": True,
        "right_finger": True,
    }


def test_the_hand_goes_where_its_base_is(make_scene) -> None:
    turned = Rotation.from_rotvec([0.3, -0.5, 1.1])
    pose = np.concatenate([[0.1, -0.2, 0.3], turned.as_quat()])
    home = {s.link: p for s, p in hand(make_scene().gripper).posed(AT_HOME, np.array([0.02, 0.02]))}
    away = {s.link: p for s, p in hand(make_scene().gripper).posed(pose, np.array([0.02, 0.02]))}
    for link, points in home.items():
        assert np.allclose(turned.apply(points) + pose[:3], away[link])


@pytest.mark.parametrize("protocol", ["paper", "released"])
def test_the_carrier_of_a_reference_hand_is_not_drawn(
    reference_data, monkeypatch: pytest.MonkeyPatch, protocol: str
) -> None:
    from qdgrasp_assets.catalog import find_gripper

    monkeypatch.setenv("QDGRASP_ASSET_PATH", str(reference_data))
    drawn = hand(find_gripper("ref_panda_2f").on_carrier(protocol))
    points = np.concatenate([points for _, points in drawn.posed(AT_HOME, np.array([0.04, 0.04]))])
    assert {shape.link for shape in drawn.shapes} == {"panda_hand", "panda_leftfinger", "panda_rightfinger"}
    assert np.allclose(points.max(axis=0)[2], 0.1124, atol=2e-3)
