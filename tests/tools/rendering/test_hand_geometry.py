import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.coordinator.scenes import made_scene

from qdgrasp_assets.grippers.hand_geometry import hand_geometry
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.rows import Rows, RowShape
from qdgrasp_tools.rendering.table import AS_MODELLED, orientation, table_under

AT_HOME = np.array([0, 0, 0, 0, 0, 0, 1.0])


def test_the_fingers_stand_where_their_joints_put_them() -> None:
    posed = hand_geometry(made_scene().gripper).place_meshes(AT_HOME, np.array([0.03, 0.01]))
    found = {shape.link: np.stack([points.min(axis=0), points.max(axis=0)]) for shape, points in posed}
    assert np.allclose(found["palm"][:, 2], [0.0, 0.06])
    assert np.allclose(found["left_finger"][:, 1], [0.03, 0.05])
    assert np.allclose(found["right_finger"][:, 1], [-0.03, -0.01])
    assert np.allclose(found["left_finger"][:, 2], [0.06, 0.11])


def test_only_finger_links_are_fingers() -> None:
    found = hand_geometry(made_scene().gripper)
    fingers = {shape.link: found.is_finger(shape) for shape in found.shapes}
    assert fingers == {"palm": False, "left_finger": True, "right_finger": True}


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


SHAPE = RowShape(genes=7, joints=2)
DOWN = Rotation.from_euler("x", 180, degrees=True)
"""The jaw's fingers point along its z: turned so, they point down."""


def grasps(positions: object, turns: Rotation, joints: float = 0.02) -> Rows:
    rows = SHAPE.empty(len(np.atleast_2d(positions)))
    rows["base_to_object"][:, :3] = positions
    rows["base_to_object"][:, 3:] = turns.as_quat()
    rows["joints"] = joints
    return rows


def clear(scene: Scene, rows: Rows, pose: Rotation = AS_MODELLED) -> list[bool]:
    return table_under(scene, pose).is_clear_of(scene, "contact", rows).tolist()


def test_a_grasp_from_above_is_kept_and_one_from_below_is_not() -> None:
    scene = made_scene()  # a block of 6 cm, so that the table is 3 cm below its centre
    assert clear(scene, grasps([0, 0, 0.1], DOWN)) == [True]
    assert clear(scene, grasps([0, 0, -0.1], Rotation.identity())) == [False]


def test_a_hand_is_kept_just_as_long_as_its_fingertips_are_above_the_table() -> None:
    heights = np.array([0.0801, 0.0799])  # the fingertips are 11 cm from the base
    places = np.column_stack([np.zeros(2), np.zeros(2), heights])
    assert clear(made_scene(), grasps(places, Rotation.concatenate([DOWN, DOWN]))) == [True, False]


def test_a_hand_must_be_clear_both_open_and_at_the_grasp() -> None:
    scene, random = made_scene(), np.random.default_rng(8)
    rows = grasps(random.uniform(-0.1, 0.1, (300, 3)), Rotation.random(300, random_state=random))
    rows["joints"] = random.uniform(0, 0.08, (300, 2))
    drawn, poses = hand_geometry(scene.gripper), rows["base_to_object"].astype(float)
    is_clear = {
        name: drawn.lowest_points(poses, joints.astype(float), np.array([0, 0, 1.0])) >= -0.03
        for name, joints in (("open", np.full((300, 2), 0.04)), ("grasp", rows["joints"]))
    }
    assert (is_clear["open"] & ~is_clear["grasp"]).any()
    assert (is_clear["grasp"] & ~is_clear["open"]).any()
    assert clear(scene, rows) == (is_clear["open"] & is_clear["grasp"]).tolist()


def test_the_object_pose_says_which_side_is_down() -> None:
    scene = made_scene()
    assert clear(scene, grasps([0, 0, 0.1], DOWN), orientation("180,0,0")) == [False]
    assert clear(scene, grasps([0, 0, -0.1], Rotation.identity()), orientation("1,0,0,0")) == [True]


def test_turning_object_and_hand_together_changes_nothing() -> None:
    scene, random = made_scene(), np.random.default_rng(5)
    turns = Rotation.random(200, random_state=random)
    rows = grasps(random.uniform(-0.15, 0.15, (200, 3)), turns, joints=0.01)
    kept = clear(scene, rows)
    assert 20 < sum(kept) < 180
    turn = Rotation.from_rotvec([0.4, -1.2, 0.7])
    vertices = np.frombuffer(scene.object.mesh_vertices, "<f4").reshape(-1, 3)
    turned = msgspec.structs.replace(scene.object, mesh_vertices=turn.apply(vertices).astype("<f4").tobytes())
    other = grasps(turn.apply(rows["base_to_object"][:, :3]), turn * turns, joints=0.01)
    again = clear(msgspec.structs.replace(scene, object=turned), other, turn.inv())
    assert np.mean(np.array(again) == kept) > 0.98  # what touches the plane within rounding may differ


def test_many_hands_reach_as_low_as_each_alone() -> None:
    random = np.random.default_rng(6)
    poses = np.hstack([random.normal(size=(9, 3)), Rotation.random(9, random_state=random).as_quat()])
    joints, up = random.uniform(0, 0.04, (9, 2)), np.array([0.0, 0.6, 0.8])
    drawn = hand_geometry(made_scene().gripper)
    alone = [
        min(float((points @ up).min()) for _, points in drawn.place_meshes(pose, joint))
        for pose, joint in zip(poses, joints, strict=True)
    ]
    assert np.allclose(drawn.lowest_points(poses, joints, up), alone, atol=1e-12)


@pytest.mark.parametrize("words", ["", "1,2", "0,0,0,0", "a,b,c", "1,2,3,4,5", "nan,0,0"])
def test_an_orientation_that_is_none_is_refused(words: str) -> None:
    with pytest.raises(ImpossibleValue, match="a quaternion x,y,z,w or angles x,y,z in degrees"):
        orientation(words)


def test_angles_turn_about_the_fixed_axes_in_turn() -> None:
    assert np.allclose(orientation("90,0,90").apply([0, 1, 0]), [0, 0, 1])
