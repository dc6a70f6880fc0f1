import msgspec
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from tests.coordinator.scenes import made_scene

from qdgrasp_assets.scene import Scene, SceneGripper
from qdgrasp_protocol.rows import Outcome, Rows, RowShape
from qdgrasp_tools.rendering.ray_renderer import fit_camera
from qdgrasp_tools.rendering.views import (
    AZIMUTHS,
    LEAST_DISTANCE,
    LEAST_FACING,
    LEAST_HANDS,
    MOST_HANDS,
    best_azimuth,
    spread_grasps,
)

VIEW = fit_camera(np.array([[-0.1, -0.1, -0.1], [0.1, 0.1, 0.1]]), 0.0, 0.0, 100, 100)
"""Seen from +x: y to the right, z up."""
Z = np.array([0.0, 0.0, 1.0])


@pytest.fixture
def jaw() -> SceneGripper:
    """Two fingers, approach along z."""
    return made_scene().gripper


def around(n: int, outcome: Outcome, seed: int = 0) -> Rows:
    """Hands on a ball of 12 cm that look at its middle."""
    places = np.random.default_rng(seed).normal(size=(n, 3))
    places *= 0.12 / np.linalg.norm(places, axis=1, keepdims=True)
    rows = RowShape(7, 2).empty(n)
    turns = [Rotation.align_vectors([-place], [Z])[0].as_quat() for place in places]
    rows["outcome"] = outcome
    rows["base_to_object"][:, :3], rows["base_to_object"][:, 3:] = places, np.reshape(turns, (n, 4))
    return rows


def test_robust_grasps_come_before_grasps_and_those_before_successes(jaw: SceneGripper) -> None:
    dropped, shaken, held = (
        around(30, outcome, outcome) for outcome in (Outcome.DROPPED, Outcome.SHAKEN, Outcome.HELD)
    )
    assert set(spread_grasps(np.concatenate([dropped, shaken, held]), jaw, VIEW)["outcome"]) == {Outcome.HELD}
    assert set(spread_grasps(np.concatenate([dropped, shaken]), jaw, VIEW)["outcome"]) == {Outcome.SHAKEN}
    assert set(spread_grasps(dropped, jaw, VIEW)["outcome"]) == {Outcome.DROPPED}


def test_no_hand_stands_between_the_object_and_the_eye(jaw: SceneGripper) -> None:
    chosen = spread_grasps(around(500, Outcome.HELD), jaw, VIEW)
    assert len(chosen) == MOST_HANDS
    toward_eye = chosen["base_to_object"][:, 0] / 0.12
    assert toward_eye.max() < LEAST_FACING + 1e-6


def test_of_a_hand_with_many_fingers_fewer_are_chosen(jaw: SceneGripper) -> None:
    hand = msgspec.structs.replace(jaw, finger_links=tuple(f"link_{number}" for number in range(20)))
    assert len(spread_grasps(around(500, Outcome.HELD), hand, VIEW)) == LEAST_HANDS


def test_chosen_hands_are_apart_and_the_like_of_one_another_are_not_chosen_twice(jaw: SceneGripper) -> None:
    chosen = spread_grasps(around(500, Outcome.HELD), jaw, VIEW)["base_to_object"][:, :3]
    gaps = np.linalg.norm(chosen[:, None] - chosen[None], axis=2)[~np.eye(len(chosen), dtype=bool)]
    assert gaps.min() > LEAST_DISTANCE
    assert len(spread_grasps(np.repeat(around(1, Outcome.HELD, 7), 50), jaw, VIEW)) == 1


def test_a_hand_before_the_object_is_chosen_when_there_is_no_other(jaw: SceneGripper) -> None:
    rows = around(500, Outcome.HELD)
    facing = rows[rows["base_to_object"][:, 0] > 0.1]
    assert len(facing) > 5
    assert len(spread_grasps(facing, jaw, VIEW)) > 0


def test_of_no_successes_none_is_chosen(jaw: SceneGripper) -> None:
    assert len(spread_grasps(around(0, Outcome.HELD), jaw, VIEW)) == 0


def scene_of(shape: trimesh.Trimesh) -> Scene:
    scene = made_scene()
    mesh = {
        "mesh_vertices": shape.vertices.astype("<f4").tobytes(),
        "mesh_faces": shape.faces.astype("<u4").tobytes(),
    }
    return msgspec.structs.replace(scene, object=msgspec.structs.replace(scene.object, **mesh))


def test_a_plate_is_seen_from_its_broad_side() -> None:
    plate = trimesh.creation.box((0.02, 0.2, 0.1))
    side = best_azimuth(scene_of(plate), around(0, Outcome.HELD))
    assert abs(np.cos(side)) > 0.9


def test_grasps_on_one_side_are_not_seen_from_straight_ahead_or_behind() -> None:
    ball = trimesh.creation.icosphere(radius=0.05)
    rows = around(2000, Outcome.HELD)
    for azimuth in AZIMUTHS[::3]:
        toward = rows["base_to_object"][:, :2] @ [np.cos(azimuth), np.sin(azimuth)]
        side = best_azimuth(scene_of(ball), rows[toward > 0.11])
        assert abs(np.cos(side - azimuth)) < 0.9
