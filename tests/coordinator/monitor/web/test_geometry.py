from base64 import b64decode

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tests.coordinator.monitor.web.finds import finds

from qdgrasp_assets.catalog import find_gripper
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.analysis.fitness import COLOURS
from qdgrasp_coordinator.analysis.hand import hand
from qdgrasp_coordinator.monitor.web.app import STATIC
from qdgrasp_coordinator.monitor.web.geometry import Triangles, grasp, stage
from qdgrasp_protocol.outcome import Outcome


def positions(mesh: Triangles) -> NDArray[np.float32]:
    return np.frombuffer(b64decode(mesh.positions), "<f4").reshape(-1, 3)


def indices(mesh: Triangles) -> NDArray[np.uint32]:
    return np.frombuffer(b64decode(mesh.indices), "<u4").reshape(-1, 3)


def scene_of(name: str, make_scene) -> Scene:
    if name == "jaw":
        return make_scene()
    return replace(make_scene(), gripper=find_gripper(name).on_carrier("paper"))


@pytest.mark.parametrize("name", ["jaw", "panda", "allegro", "barrett", "shadow"])
def test_links_stand_where_pictures_draw_them(make_scene, name: str) -> None:
    scene = scene_of(name, make_scene)
    drawn, random = hand(scene.gripper), np.random.default_rng(7)
    find = finds([4], [(3, -2, 7)], [Outcome.HELD], joints=len(scene.gripper.joints))[0]
    find["base_to_object"][3:] = Rotation.random(random_state=7).as_quat()
    find["joints"] = [random.uniform(*sorted((j.opened, j.closed))) for j in scene.gripper.joints]
    told = grasp(find, drawn, stage(scene, drawn), [])
    shown = {link.name: link for link in stage(scene, drawn).links}
    expected: dict[str, list[NDArray[np.float64]]] = {}
    for shape, vertices in drawn.posed(find["base_to_object"].astype(float), find["joints"].astype(float)):
        expected.setdefault(shape.link, []).append(vertices)
    assert told.links.keys() == shown.keys() == expected.keys()
    for link, parts in expected.items():
        frame = np.array(told.links[link]).reshape(4, 4)
        placed = positions(shown[link].mesh) @ frame[:3, :3].T + frame[:3, 3]
        assert np.allclose(placed, np.concatenate(parts), rtol=0, atol=1e-6)


def test_the_object_stands_in_its_centre_of_mass_frame(make_scene) -> None:
    scene = make_scene()
    told = stage(scene, hand(scene.gripper))
    corners = positions(told.mesh)[indices(told.mesh)]
    assert np.array_equal(corners, scene.object.triangles)
    assert np.allclose(corners.min(axis=(0, 1)), told.low, atol=1e-6)
    assert np.allclose(corners.max(axis=(0, 1)), told.high, atol=1e-6)


def test_only_links_whose_contact_counts_are_fingers(make_scene) -> None:
    scene = make_scene()
    links = stage(scene, hand(scene.gripper)).links
    assert {link.name: link.finger for link in links} == {
        "palm": False,
        "left_finger": True,
        "right_finger": True,
    }


def test_the_kinds_of_cells_are_all_successes_from_worst_to_best(make_scene) -> None:
    scene = make_scene()
    kinds = stage(scene, hand(scene.gripper)).kinds
    assert [kind.outcome for kind in kinds] == [kind for kind in Outcome if kind.is_success]
    assert len({kind.colour for kind in kinds}) == len({kind.words for kind in kinds}) == len(kinds)


def test_a_grasp_says_all_that_is_known_of_it(make_scene) -> None:
    scene = make_scene()
    scene = replace(scene, object=replace(scene.object, com_in_mesh=(0.0, 0.1, 0.0)))
    drawn = hand(scene.gripper)
    stands = replace(stage(scene, drawn), synergies=["pinch", "power"])
    find = finds([41], [(3, -2, 7)], [Outcome.SHAKEN], synergies=1, etas=0.5)[0]
    find["joints"] = [0.02, 0.01]
    told = grasp(find, drawn, stands, ["qdgrasp show runs/mug --grasp 41"])
    assert (told.number, told.outcome, told.fitness, told.cell) == (41, Outcome.SHAKEN, 1.0, [3, -2, 7])
    assert np.allclose(told.position, [0.03, -0.02, 0.07])
    assert told.quaternion == [0, 0, 0, 1]
    assert told.joints == pytest.approx({"left": 0.02, "right": 0.01})
    assert told.commands == ["qdgrasp show runs/mug --grasp 41"]
    assert (told.base, told.synergy, told.eta) == ("palm", "power", 0.5)
    assert np.allclose(told.position_in_mesh, [0.03, 0.08, 0.07])


def test_the_frame_of_the_hand_s_base_is_its_pose(make_scene) -> None:
    scene = scene_of("barrett", make_scene)
    drawn = hand(scene.gripper)
    find = finds([4], [(3, -2, 7)], [Outcome.HELD], joints=len(scene.gripper.joints))[0]
    find["base_to_object"][3:] = Rotation.random(random_state=7).as_quat()
    frame = np.array(grasp(find, drawn, stage(scene, drawn), []).frame).reshape(4, 4)
    assert np.allclose(frame[:3, 3], [0.03, -0.02, 0.07], atol=1e-7)
    assert np.allclose(frame[:3, :3], Rotation.from_quat(find["base_to_object"][3:]).as_matrix(), atol=1e-6)


def test_what_is_not_known_of_a_grasp_is_left_out(make_scene) -> None:
    scene = make_scene()
    drawn = hand(scene.gripper)
    told = grasp(finds([4], [(3, -2, 7)], [Outcome.HELD])[0], drawn, stage(scene, drawn), [])
    assert (told.synergy, told.eta) == ("", None)


def test_the_page_has_the_colours_of_pictures() -> None:
    style = (STATIC / "style.css").read_text()
    for name, colour in zip(("dropped", "shaken", "held"), COLOURS, strict=True):
        assert f"--{name}: {colour};" in style
