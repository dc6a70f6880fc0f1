"""Data of the view in 3D."""

from base64 import b64decode
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tests.coordinator.scenes import restricted_scene
from tests.tools.monitor.web.conftest import finds, random_finds

from qdgrasp_assets.grippers.hand_geometry import HandGeometry, hand_geometry
from qdgrasp_assets.scene import Synergy
from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.storage.success_pages import SuccessTable
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.monitor.web import scene_data
from qdgrasp_tools.monitor.web.scene_data import HEADER, VoxelPages, browser_scene, grasp_view


def corners_of(mesh: dict[str, str]) -> NDArray[np.float32]:
    """Corners (f, 3, 3) of the triangles of a mesh for the browser."""
    positions = np.frombuffer(b64decode(mesh["positions"]), "<f4").reshape(-1, 3)
    return positions[np.frombuffer(b64decode(mesh["indices"]), "<u4").reshape(-1, 3)]


@pytest.fixture
def drawn(make_scene) -> HandGeometry:
    return hand_geometry(make_scene().gripper)


def test_the_object_stands_in_its_centre_of_mass_frame(make_scene, drawn: HandGeometry) -> None:
    stands: Any = browser_scene(make_scene(), drawn)
    corners = corners_of(stands["mesh"])
    assert np.allclose(
        sorted(corners.reshape(-1, 9).tolist()), sorted(make_scene().object.triangles.reshape(-1, 9).tolist())
    )
    assert np.allclose(corners.min(axis=(0, 1)), stands["low"], atol=1e-6)
    assert np.allclose(corners.max(axis=(0, 1)), stands["high"], atol=1e-6)


def test_what_may_be_touched_has_margins_above_0_and_neighbours_are_there(drawn: HandGeometry) -> None:
    shown: Any = browser_scene(restricted_scene(), drawn)
    heights = np.frombuffer(b64decode(shown["mesh"]["positions"]), "<f4").reshape(-1, 3)[:, 2]
    margins = np.frombuffer(b64decode(shown["mesh"]["margins"]), "<f4")
    clear = np.abs(heights) > 1e-3
    assert clear.sum() > 100
    assert ((margins > 0) == (heights > 0))[clear].all()
    assert corners_of(shown["neighbours"])[..., 0].min() == pytest.approx(0.19)


def test_a_grasp_says_all_that_is_known_of_it(make_scene, drawn: HandGeometry) -> None:
    scene = replace(make_scene(), object=replace(make_scene().object, com_in_mesh=(0.0, 0.1, 0.0)))
    synergies = tuple(Synergy(name=name, joints=("left",)) for name in ("pinch", "power"))
    scene = replace(scene, gripper=replace(scene.gripper, synergies=synergies))
    find = finds([41], [(3, -2, 7)], [Outcome.SHAKEN], synergies=1, etas=0.5)[0]
    find["joints"] = [0.02, 0.01]
    told: Any = grasp_view(find, scene, drawn)
    assert (told["number"], told["outcome"], told["fitness"], told["cell"]) == (
        41,
        Outcome.SHAKEN,
        1.0,
        [3, -2, 7],
    )
    assert np.allclose(told["commanded"]["position"], [0.03, -0.02, 0.07])
    assert told["commanded"]["quaternion"] == [0, 0, 0, 1]
    assert told["joints"] == pytest.approx({"left": 0.02, "right": 0.01})
    assert (told["base"], told["synergy"], told["eta"]) == ("palm", "power", 0.5)
    assert np.allclose(told["commanded"]["position_in_mesh"], [0.03, 0.08, 0.07])
    assert (told["settled"], told["moved"], told["turned"]) == (None, None, None)


def settled_find() -> np.void:
    """A find whose hand went 3 cm down to the object and turned by 60 degrees about z while it closed."""
    find = finds([41], [(0, 0, 7)], [Outcome.HELD], contacts=2, penetration=0.004)[0]
    find["settled"] = (0, 0, 0.04, 0, 0, 0.5, np.sqrt(0.75))
    find["pregrasp"], find["joints"] = (0.04, 0.04), (0.02, 0.01)
    find["contact_links"] = (3, 0)
    find["contact_points"][:7] = (0.01, 0, 0.02, 0, 0, -1, 12.5)
    return find


def test_a_grasp_says_how_closing_went(make_scene) -> None:
    links = ("palm", "left_finger", "right_finger")
    scene = replace(make_scene(), gripper=replace(make_scene().gripper, links=links))
    hand = hand_geometry(scene.gripper)
    told: Any = grasp_view(settled_find(), scene, hand, 0.25)
    assert told["settled"] is not None
    assert np.allclose(told["settled"]["position"], [0, 0, 0.04])
    assert (told["moved"], told["turned"]) == pytest.approx((0.03, np.pi / 3))
    assert (told["penetration"], told["finger_links"], told["margin"]) == (pytest.approx(0.004), 2, 0.25)
    assert told["pregrasp"] == pytest.approx({"left": 0.04, "right": 0.04})
    (contact,) = told["contacts"]
    assert (contact["link"], contact["finger"], contact["force"]) == ("right_finger", True, 12.5)
    assert contact["point"] == pytest.approx([0.01, 0, 0.02], abs=1e-5)


def test_midway_the_hand_has_gone_and_turned_half_the_way_with_its_joints_half_closed(
    make_scene, drawn
) -> None:
    find = settled_find()
    find["contact_links"] = 0
    frames: Any = grasp_view(find, make_scene(), drawn)["frames"]
    middle = {name: poses[len(poses) // 2] for name, poses in frames.items()}
    pose = np.array([0, 0, 0.055, 0, 0, np.sin(np.pi / 12), np.cos(np.pi / 12)])
    for name, frame in drawn.link_frames(pose, np.array([0.03, 0.025])).items():
        if name in middle:
            assert np.allclose(middle[name][:3], frame[:3, 3], atol=1e-6)
            assert np.allclose(Rotation.from_quat(middle[name][3:]).as_matrix(), frame[:3, :3], atol=1e-6)


Cell = tuple[int, int, int]
Shown = dict[int, tuple[Cell, int, int, float]]
"""The cell, outcome, synergy and eta for each journal number."""
PAGE = np.dtype(list(scene_data.PAGE_COLUMNS))


def read(page: bytes) -> tuple[int, bool, Shown]:
    """The serial to ask from next, whether there is more at once, and what a page shows."""
    mark, n, upto, more, _, _ = HEADER.unpack_from(page)
    assert mark == scene_data.MARK
    assert len(page) == HEADER.size + PAGE.itemsize * n
    found = columns_of(page)
    places = map(tuple, found["cell"].tolist())
    values = zip(places, *(found[name].tolist() for name in ("outcome", "synergy", "eta")), strict=True)
    return upto, bool(more), dict(zip(found["number"].tolist(), values, strict=True))


def in_cells(page: bytes) -> dict[Cell, tuple[int, int]]:
    """The journal number and the outcome in each cell, where it has one alone."""
    return {place: (number, outcome) for number, (place, outcome, *_) in read(page)[2].items()}


def columns_of(page: bytes) -> dict[str, NDArray[np.generic]]:
    """The columns of a page by their names."""
    n, start, found = HEADER.unpack_from(page)[1], HEADER.size, {}
    for name in PAGE.names or ():
        found[name] = np.frombuffer(page, PAGE[name], n, start)
        start += found[name].nbytes
    return found


def pages(kept: VoxelPages, first: int = 0) -> Iterator[Shown]:
    while True:
        first, more, shown = read(kept.page(first))
        yield shown
        if not more:
            return


def every(found: SuccessTable) -> Shown:
    """The same by a plain loop."""
    return {
        int(one["number"]): (
            tuple(cells(one["descriptor"]).tolist()),
            int(one["outcome"]),
            int(one["synergy"]),
            float(one["eta"]),
        )
        for one in found
    }


def shown(kept: VoxelPages) -> Shown:
    return {name: what for page in pages(kept) for name, what in page.items()}


def test_every_find_is_on_the_pages() -> None:
    found = random_finds(2000)
    kept = VoxelPages()
    kept.insert(found, 4000)
    assert shown(kept) == every(found)


def test_where_there_are_too_many_those_in_further_cells_are_added(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_data, "MAX_VOXELS", 500)
    found, kept = random_finds(2000), VoxelPages()
    for start in range(0, 2000, 500):
        kept.insert(found[start : start + 500], 2 * (start + 500))
    seen = shown(kept)
    assert seen.items() >= every(found[:500]).items()
    everywhere = {(place, outcome) for place, outcome, *_ in every(found).values()}
    assert {(place, outcome) for place, outcome, *_ in seen.values()} == everywhere
    assert len(seen) < len(found)


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
    assert heard == shown(kept) == every(found)
