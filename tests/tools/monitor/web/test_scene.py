"""The view in 3D in a browser: on the page, and alone."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation
from tests import browser
from tests.browser import expect
from tests.common import PATIENCE, with_gripper
from tests.coordinator.scenes import made_scene
from tests.tools.monitor.web.conftest import FakeFeed, HandMadeRecords, finds, serving

from qdgrasp_assets.scene import Synergy
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.monitor.web.run_cache import JobCaches

pytestmark = browser.needed
FEW = finds(
    [3, 4, 8, 9],
    [(0, -9, 3), (9, 0, 3), (-9, 0, 3), (0, 9, 3)],
    [Outcome.DROPPED, Outcome.SHAKEN, Outcome.HELD, Outcome.HELD],
    pregrasp=(0.04, 0.04),
    settled=[np.zeros(7), np.zeros(7), (-0.05, 0, 0.03, 0, 0, 0.6, 0.8), (0, 0.085, 0.03, 0, 0, 0, 1)],
    contacts=[1, 1, 2, 2],
    penetration=[0, 0.006, 0.001, 0.003],
    contact_links=[(0, 0), (0, 0), (1, 2), (0, 0)],
    contact_points=np.full((4, 14), 0.02),
)
FEW["joints"] = 0.01, 0.02
BARE = "static/scene.css"
"""A page of the server's on which nothing goes on,"""
FAVICON = "status of 404"
"""and which names no icon, so that the browser looks for one in vain."""
ALONE = """async () => {
  const stage = document.createElement("div"), canvas = document.createElement("canvas");
  document.body.replaceChildren(stage);
  canvas.tabIndex = 0;
  stage.append(canvas);
  Object.assign(stage.style, { position: "relative", width: "600px", height: "500px" });
  Object.assign(canvas.style, { position: "absolute", width: "600px", height: "500px" });
  const { SceneView } = await import("/static/scene/scene_view.js");
  window.view = new SceneView(canvas, "/api", "mug", "mug");
  view.onselect = (grasp) => (window.grasp = grasp);
  view.onstatus = (words) => (window.words = words);
  await view.start();
}"""
PLACE = """(number) => {
  const { renderer, cells } = view, place = view.objects.mark.position.clone();
  place.fromArray(cells.cell(cells.slotOf(number))).multiplyScalar(0.01).project(renderer.projection.camera);
  const { left, top, width, height } = view.canvas.getBoundingClientRect();
  return [left + (width * (1 + place.x)) / 2, top + (height * (1 - place.y)) / 2];
}"""
STAND = """(are) => view.objects.hand.visible === are && view.objects.mark.visible === are"""
"""True where the hand, and the mark at its cell, are there."""
STANDS = """() => {
  view.renderer.scene.updateMatrixWorld();
  const { description, objects } = view;
  const frame = (k) => objects.hand.children[k].matrixWorld.toArray();
  return Object.fromEntries(description.links.map(({ name }, k) => [name, frame(k)]));
}"""
"""The frames of the hand's links as they are drawn, 4 x 4 column by column."""
Page = Any


@pytest.fixture
def records() -> HandMadeRecords:
    links = ("palm", "left_finger", "right_finger")
    made = HandMadeRecords(with_gripper(made_scene(), links=links))
    made.record(FEW)
    return made


@contextmanager
def serving_records(records: HandMadeRecords) -> Iterator[str]:
    feed = FakeFeed().step(time.time() + PATIENCE)  # it stays live however slow the browser is
    with serving(feed, library=JobCaches(records)) as address:
        yield f"{address}/#job=mug"


@pytest.fixture
def place(records: HandMadeRecords) -> Iterator[str]:
    with serving_records(records) as found:
        yield found


@pytest.fixture
def page(chromium: Any, place: str) -> Iterator[Page]:
    for visit in visited(chromium, place):
        expect(visit.locator("#scene-words")).to_have_text("4 cells of 1 cm")
        yield visit


@pytest.fixture
def alone(chromium: Any, place: str) -> Iterator[Page]:
    """The view without the page around it: `view`, `grasp` and `words` are what a script finds."""
    for visit in visited(chromium, place.replace("#job=mug", BARE)):
        visit.evaluate(ALONE)
        yield visit


def visited(chromium: Any, place: str, **looks: Any) -> Iterator[Page]:
    visit = browser.Visit(chromium, place, **looks)
    yield visit.page
    visit.context.close()
    assert [words for words in visit.complaints if not (BARE in place and FAVICON in words)] == []


def test_all_cells_are_there_and_counted_by_kind(page: Page) -> None:
    expect(page.locator("#scene-key li b")).to_have_text(["1", "1", "2"])


def test_the_keyboard_goes_through_grasps_the_best_first(page: Page) -> None:
    page.locator("#scene").focus()
    page.keyboard.press("n")
    expect(page.locator("#grasp h4")).to_have_text("Grasp 8")
    page.keyboard.press("Escape")
    expect(page.locator("#grasp")).to_be_hidden()
    for key, number in {"n": 8, "p": 3}.items():
        page.keyboard.press(key)
        expect(page.locator("#grasp h4")).to_have_text(f"Grasp {number}")
    expect(page.locator("#grasp")).to_contain_text("no disturbance survived")


def chosen(page: Page, number: int) -> Any:
    """The card of a grasp, once it is chosen; best first they are 8, 9, 4, 3."""
    for _ in range([8, 9, 4, 3].index(number) + 1):
        page.locator("#scene").press("n")
    expect(page.locator("#grasp h4")).to_have_text(f"Grasp {number}")
    return page.locator("#grasp")


def test_the_card_says_how_closing_went(page: Page) -> None:
    card = chosen(page, 8)
    for words in ("Penetration1.00 mm", "Finger links in contact2", "Object moved89.9 mm, 73.7°"):
        expect(card).to_contain_text(words)
    expect(card.locator("summary")).to_have_text(
        [
            "Settled pose of palm",
            "Commanded pose of palm",
            "2 joints, open → closed [rad or m]",
            "2 contacts [N]",
        ]
    )
    expect(card).to_contain_text("0.0400 → 0.0100")
    expect(page.locator(".scene-frames")).to_contain_text("hand (palm)")


def test_the_hand_is_closed_and_opened_by_keys_and_contacts_are_there_when_it_is_closed(page: Page) -> None:
    chosen(page, 8)
    slider, marks = page.get_by_label("Closing of the hand"), page.locator(".scene-contacts g")
    expect(slider).to_have_value("1")
    expect(marks).to_have_count(2)
    expect(page.locator(".scene-contacts .finger")).to_have_count(1)
    slider.press("ArrowLeft")
    expect(slider).to_have_attribute("aria-valuetext", "99 % closed")
    expect(marks).to_have_count(0)
    slider.press("Home")
    expect(page.locator("#grasp .closing output")).to_have_text("open")
    page.locator("#scene").press("n")  # the next grasp is open as well
    expect(page.locator("#grasp h4")).to_have_text("Grasp 9")
    expect(slider).to_have_value("0")
    slider.press("End")
    expect(page.locator("#grasp .closing output")).to_have_text("closed")


def test_without_3d_the_page_says_so_and_goes_on(chromium: Any, place: str) -> None:
    context = chromium.new_context()
    context.add_init_script("HTMLCanvasElement.prototype.getContext = new Proxy("
        "HTMLCanvasElement.prototype.getContext, { apply: (get, canvas, [kind, ...rest]) => "
        "kind.startsWith('webgl') ? null : Reflect.apply(get, canvas, [kind, ...rest]) })")  # fmt: skip
    page = context.new_page()
    page.goto(place)
    expect(page.locator("#scene-empty")).to_contain_text("The view in 3D cannot be drawn here: no WebGL 2")
    expect(page.locator("#workers tbody tr").first).to_be_visible()
    context.close()


def click(alone: Page, number: int) -> None:
    """Click on the voxel of a grasp, and wait until it is chosen."""
    alone.mouse.click(*alone.evaluate(PLACE, number))
    alone.wait_for_function("() => window.grasp")
    assert alone.evaluate("grasp.number") == number


@pytest.mark.parametrize("number", [4, 9])
def test_a_click_on_a_voxel_chooses_its_grasp(alone: Page, number: int) -> None:
    click(alone, number)
    alone.wait_for_function(STAND, arg=True)


def test_the_hand_stands_where_the_server_says(alone: Page, records: HandMadeRecords) -> None:
    alone.evaluate("view.select(8)")
    alone.wait_for_function("() => window.grasp && view.objects.hand.visible")
    frames = alone.evaluate("grasp.frames")
    for closed, place in ((1, -1), (0, 0), (0.5, 5)):
        alone.evaluate("(closed) => (view.closed = closed)", closed)
        stands = alone.evaluate(STANDS)
        assert stands.keys() == frames.keys()
        for name, matrix in stands.items():
            expected = np.array(frames[name][place])
            found = np.reshape(matrix, (4, 4)).T
            assert np.allclose(found[:3, 3], expected[:3], atol=1e-9)
            assert np.allclose(found[:3, :3], Rotation.from_quat(expected[3:]).as_matrix(), atol=1e-6)


SCORED = finds(
    [2, 3, 5, 8, 9, 12],
    [(0, -9, 3), (0, -9, 3), (9, 0, 3), (-9, 0, 3), (0, 9, 3), (0, 9, -4)],
    [Outcome.HELD, Outcome.DROPPED, Outcome.HELD, Outcome.SHAKEN, Outcome.HELD, Outcome.DROPPED],
    synergies=[0, 1, 1, 0, 0, 1],
    etas=[0.9, 0.1, 0.5, 0.4, 0.7, 0.0],
)


@pytest.fixture
def scored() -> HandMadeRecords:
    named = tuple(Synergy(name=name, joints=("left",)) for name in ("pinch", "power"))
    scene = replace(with_gripper(made_scene(), synergies=named), protocol="robust")
    made = HandMadeRecords(scene)
    made.record(SCORED)
    return made


@pytest.fixture
def filtered(chromium: Any, scored: HandMadeRecords) -> Iterator[Page]:
    with serving_records(scored) as found:
        for page in visited(chromium, found):
            expect(page.locator("#scene-words")).to_have_text("5 cells of 1 cm")
            page.locator("#scene-filters summary").click()
            yield page


def test_a_box_shows_what_is_in_it(filtered: Page) -> None:
    filtered.get_by_label("y lowest").fill("1")
    expect(filtered.locator("#scene-words")).to_have_text("2 of 5 cells of 1 cm")
    filtered.get_by_label("z highest").fill("0")
    expect(filtered.locator("#scene-words")).to_have_text("1 of 5 cells of 1 cm")
    expect(filtered.locator("#scene-filters summary")).to_have_text("Filters 2 in use")


def test_filters_are_kept_in_the_address_until_all_is_shown(page: Page, place: str, chromium: Any) -> None:
    page.locator("#scene-filters summary").click()
    page.get_by_label("Most penetration").fill("5")
    page.get_by_label("Fewest finger links").fill("2")
    expect(page).to_have_url(f"{place}&penetration=5&contacts=2")
    for other in visited(chromium, page.url):
        expect(other.locator("#scene-words")).to_have_text("2 of 4 cells of 1 cm")
        expect(other.locator("#scene-filters summary")).to_have_text("Filters 2 in use")
        other.locator("#scene-filters summary").click()
        expect(other.get_by_label("Most penetration")).to_have_value("5")
        other.get_by_role("button", name="Show all").click()
        expect(other.locator("#scene-words")).to_have_text("4 cells of 1 cm")
        expect(other).to_have_url(place)
        expect(other.get_by_label("Fewest finger links")).to_have_value("")
