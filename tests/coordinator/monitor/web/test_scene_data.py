"""Data of the view in 3D."""

from base64 import b64decode
from collections.abc import Iterator

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tests.coordinator.monitor.web.conftest import finds, random_finds

from qdgrasp_assets.catalog import find_gripper
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.metrics.success_metrics import FITNESS_COLOURS
from qdgrasp_coordinator.monitor.web import scene_data
from qdgrasp_coordinator.monitor.web.scene_data import (
    HEADER,
    BrowserScene,
    VoxelPages,
    browser_scene,
    grasp_view,
)
from qdgrasp_coordinator.monitor.web.server import STATIC
from qdgrasp_coordinator.rendering.hand_geometry import HandGeometry, hand_geometry
from qdgrasp_coordinator.storage.success_pages import SuccessTable
from qdgrasp_protocol.rows import Outcome


def positions(mesh: scene_data.TriangleMesh) -> NDArray[np.float32]:
    return np.frombuffer(b64decode(mesh.positions), "<f4").reshape(-1, 3)


def indices(mesh: scene_data.TriangleMesh) -> NDArray[np.uint32]:
    return np.frombuffer(b64decode(mesh.indices), "<u4").reshape(-1, 3)


def scene_of(name: str, make_scene) -> Scene:
    if name == "jaw":
        return make_scene()
    return replace(make_scene(), gripper=find_gripper(name).on_carrier("paper"))


@pytest.mark.parametrize("name", ["jaw", "panda", "allegro", "barrett", "shadow"])
def test_links_stand_where_pictures_draw_them(make_scene, name: str) -> None:
    scene = scene_of(name, make_scene)
    drawn, random = hand_geometry(scene.gripper), np.random.default_rng(7)
    find = finds([4], [(3, -2, 7)], [Outcome.HELD], joints=len(scene.gripper.joints))[0]
    find["base_to_object"][3:] = Rotation.random(random_state=7).as_quat()
    find["joints"] = [random.uniform(*sorted((j.opened, j.closed))) for j in scene.gripper.joints]
    told = grasp_view(find, drawn, browser_scene(scene, drawn), [])
    shown = {link.name: link for link in browser_scene(scene, drawn).links}
    expected: dict[str, list[NDArray[np.float64]]] = {}
    joints = find["base_to_object"].astype(float), find["joints"].astype(float)
    for shape, vertices in drawn.place_meshes(*joints):
        expected.setdefault(shape.link, []).append(vertices)
    assert told.links.keys() == shown.keys() == expected.keys()
    for link, parts in expected.items():
        frame = np.array(told.links[link]).reshape(4, 4)
        placed = positions(shown[link].mesh) @ frame[:3, :3].T + frame[:3, 3]
        assert np.allclose(placed, np.concatenate(parts), rtol=0, atol=1e-6)


@pytest.fixture
def drawn(make_scene) -> HandGeometry:
    return hand_geometry(make_scene().gripper)


@pytest.fixture
def stands(make_scene, drawn: HandGeometry) -> BrowserScene:
    return browser_scene(make_scene(), drawn)


def test_the_object_stands_in_its_centre_of_mass_frame(make_scene, stands: BrowserScene) -> None:
    corners = positions(stands.mesh)[indices(stands.mesh)]
    assert np.array_equal(corners, make_scene().object.triangles)
    assert np.allclose(corners.min(axis=(0, 1)), stands.low, atol=1e-6)
    assert np.allclose(corners.max(axis=(0, 1)), stands.high, atol=1e-6)


def test_only_links_whose_contact_counts_are_fingers(stands: BrowserScene) -> None:
    fingers = {link.name: link.finger for link in stands.links}
    assert fingers == {"palm": False, "left_finger": True, "right_finger": True}


def test_the_kinds_of_cells_are_all_successes_from_worst_to_best(stands: BrowserScene) -> None:
    kinds = stands.kinds
    assert [kind.outcome for kind in kinds] == [kind for kind in Outcome if kind.is_success]
    assert len({kind.colour for kind in kinds}) == len({kind.words for kind in kinds}) == len(kinds)


def test_a_grasp_says_all_that_is_known_of_it(make_scene, drawn: HandGeometry) -> None:
    scene = replace(make_scene(), object=replace(make_scene().object, com_in_mesh=(0.0, 0.1, 0.0)))
    stands = replace(browser_scene(scene, drawn), synergies=["pinch", "power"])
    find = finds([41], [(3, -2, 7)], [Outcome.SHAKEN], synergies=1, etas=0.5)[0]
    find["joints"] = [0.02, 0.01]
    told = grasp_view(find, drawn, stands, ["qdgrasp show runs/mug --grasp 41"])
    assert (told.number, told.outcome, told.fitness, told.cell) == (41, Outcome.SHAKEN, 1.0, [3, -2, 7])
    assert np.allclose(told.position, [0.03, -0.02, 0.07])
    assert told.quaternion == [0, 0, 0, 1]
    assert told.joints == pytest.approx({"left": 0.02, "right": 0.01})
    assert told.commands == ["qdgrasp show runs/mug --grasp 41"]
    assert (told.base, told.synergy, told.eta) == ("palm", "power", 0.5)
    assert np.allclose(told.position_in_mesh, [0.03, 0.08, 0.07])


def test_the_frame_of_the_hand_s_base_is_its_pose(make_scene) -> None:
    scene = scene_of("barrett", make_scene)
    drawn = hand_geometry(scene.gripper)
    find = finds([4], [(3, -2, 7)], [Outcome.HELD], joints=len(scene.gripper.joints))[0]
    find["base_to_object"][3:] = Rotation.random(random_state=7).as_quat()
    frame = np.array(grasp_view(find, drawn, browser_scene(scene, drawn), []).frame).reshape(4, 4)
    assert np.allclose(frame[:3, 3], [0.03, -0.02, 0.07], atol=1e-7)
    assert np.allclose(frame[:3, :3], Rotation.from_quat(find["base_to_object"][3:]).as_matrix(), atol=1e-6)


def test_what_is_not_known_of_a_grasp_is_left_out(stands: BrowserScene, drawn: HandGeometry) -> None:
    told = grasp_view(finds([4], [(3, -2, 7)], [Outcome.HELD])[0], drawn, stands, [])
    assert (told.synergy, told.eta) == ("", None)


def test_the_page_has_the_colours_of_pictures() -> None:
    style = (STATIC / "style.css").read_text()
    for name, colour in zip(("dropped", "shaken", "held"), FITNESS_COLOURS, strict=True):
        assert f"--{name}: {colour};" in style


Cell = tuple[int, int, int]
Shown = dict[tuple[Cell, int, int], tuple[int, float]]
"""The journal number and the eta for each cell, outcome and synergy."""


def read(page: bytes) -> tuple[int, bool, Shown]:
    """The serial to ask from next, whether there is more at once, and what a page shows."""
    mark, n, upto, more, _, _ = HEADER.unpack_from(page)
    assert mark == scene_data.MARK
    assert len(page) == HEADER.size + 17 * n
    numbers = np.frombuffer(page, "<u4", n, HEADER.size).tolist()
    etas = np.frombuffer(page, "<f4", n, HEADER.size + 4 * n).tolist()
    places = np.frombuffer(page, "<i2", 3 * n, HEADER.size + 8 * n).reshape(-1, 3).tolist()
    labels = np.frombuffer(page, "<i2", n, HEADER.size + 14 * n).tolist()
    outcomes = np.frombuffer(page, "u1", n, HEADER.size + 16 * n).tolist()
    names = zip(map(tuple, places), outcomes, labels, strict=True)
    return upto, bool(more), dict(zip(names, zip(numbers, etas, strict=True), strict=True))


def in_cells(page: bytes) -> dict[Cell, tuple[int, int]]:
    """The journal number and the outcome in each cell, where it has one alone."""
    return {place: (number, outcome) for (place, outcome, _), (number, _) in read(page)[2].items()}


def pages(kept: VoxelPages, first: int = 0) -> Iterator[Shown]:
    while True:
        first, more, shown = read(kept.page(first))
        yield shown
        if not more:
            return


def best(found: SuccessTable) -> Shown:
    """The same by the plainest means."""
    kept: Shown = {}
    for one in found:
        name = (tuple(cells(one["descriptor"]).tolist()), int(one["outcome"]), int(one["synergy"]))
        if name not in kept or one["eta"] > kept[name][1]:
            kept[name] = (int(one["number"]), float(one["eta"]))
    return kept


def shown(kept: VoxelPages) -> Shown:
    return {name: what for page in pages(kept) for name, what in page.items()}


def test_each_cell_outcome_and_synergy_keeps_its_best_find_and_of_equals_the_first() -> None:
    found = random_finds(2000)
    kept = VoxelPages()
    kept.insert(found, 4000)
    assert shown(kept) == best(found)
    assert len(kept) == len(best(found))


@pytest.mark.parametrize("on_a_page", [1, 7, 100])
def test_pages_add_up_to_the_same_however_long_they_are(
    monkeypatch: pytest.MonkeyPatch, on_a_page: int
) -> None:
    found = random_finds(500)
    kept = VoxelPages()
    kept.insert(found, 1000)
    whole = shown(kept)
    monkeypatch.setattr(scene_data, "MAX_PAGE_VOXELS", on_a_page)
    assert shown(kept) == whole
    assert {len(page) for page in list(pages(kept))[:-1]} <= {on_a_page}


def test_whoever_asks_on_while_finds_come_has_what_a_late_comer_gets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_data, "MAX_PAGE_VOXELS", 20)
    found, kept = random_finds(900), VoxelPages()
    heard: Shown = {}
    first = 0
    for start in range(0, 900, 90):
        kept.insert(found[start : start + 90], 2 * (start + 90))
        first, _, page = read(kept.page(first))  # one page at a time: it falls behind
        heard |= page
    for page in pages(kept, first):
        heard |= page
    assert heard == shown(kept) == best(found)


def test_only_what_changed_is_on_a_later_page() -> None:
    kept = VoxelPages()
    kept.insert(finds([3, 5], [(0, 0, 1), (0, 0, 2)], [Outcome.DROPPED, Outcome.SHAKEN]), 6)
    first, _, _ = read(kept.page(0))
    kept.insert(finds([6, 7, 8], [(0, 0, 1), (0, 0, 2), (0, 0, 3)], [Outcome.SHAKEN] * 3), 9)
    upto, more, page = read(kept.page(first))
    assert not more
    assert page == {((0, 0, 1), Outcome.SHAKEN, -1): (6, -1), ((0, 0, 3), Outcome.SHAKEN, -1): (8, -1)}
    assert read(kept.page(upto))[2] == {}


def test_a_find_that_is_told_again_is_news_when_its_eta_is_known() -> None:
    kept, found = VoxelPages(), finds([3, 5], [(0, 0, 1)] * 2, [Outcome.HELD] * 2)
    kept.insert(found, 3)
    first, _, _ = read(kept.page(0))
    kept.insert(found, 3)
    assert read(kept.page(first)) == (first, False, {})
    kept.insert(finds([3, 5], [(0, 0, 1)] * 2, [Outcome.HELD] * 2, etas=[0.25, 0.5]), 6)
    assert read(kept.page(first))[2] == {((0, 0, 1), Outcome.HELD, -1): (5, 0.5)}


def test_it_is_told_when_there_is_more_to_read() -> None:
    kept = VoxelPages()
    kept.insert(random_finds(5), 10, is_whole=False)
    assert read(kept.page(0))[1]


def test_there_is_an_answer_before_anything_was_found() -> None:
    assert read(VoxelPages().page(0)) == (0, False, {})


def test_no_more_are_kept_than_there_is_room_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_data, "MAX_VOXELS", 100)
    kept, found = VoxelPages(), random_finds(2000)
    for start in range(0, 2000, 500):
        kept.insert(found[start : start + 500], 2 * (start + 500))
    assert len(kept) == 100
    assert shown(kept).keys() <= best(found).keys()


def test_a_find_beyond_all_reach_is_left_out() -> None:
    kept = VoxelPages()
    kept.insert(finds([0, 1], [(10**6, 0, 0), (1, 2, 3)], [Outcome.HELD] * 2), 2)
    assert shown(kept) == {((1, 2, 3), Outcome.HELD, -1): (1, -1)}
