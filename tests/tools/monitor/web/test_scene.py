"""The view in 3D in a browser: on the page, and alone."""

import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tests import browser
from tests.browser import expect
from tests.common import PATIENCE, with_gripper
from tests.coordinator.scenes import made_scene
from tests.tools.monitor.web.conftest import (
    BUDGET,
    STEP,
    FakeFeed,
    HandMadeRecords,
    engine_table,
    finds,
    random_finds,
    serving,
)

from qdgrasp_assets.scene import SceneObject, Synergy
from qdgrasp_coordinator.storage.success_pages import SuccessTable
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.monitor.records import JournalId
from qdgrasp_tools.monitor.web import run_cache
from qdgrasp_tools.monitor.web.run_cache import RunCaches

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
RESTS = """() => new Promise((done) => {
  let drawn = -1, frames = 0;
  const look = () => {
    frames = view.renderer.drawn === drawn ? frames + 1 : 0;
    drawn = view.renderer.drawn;
    frames < 40 ? requestAnimationFrame(look) : done(drawn);
  };
  look();
})"""
STAND = """(are) => view.objects.hand.visible === are && view.objects.mark.visible === are"""
"""True where the hand, and the mark at its cell, are there."""
CONTENT = """() => Object.fromEntries(Array.from({ length: view.cells.size }, (_, slot) => slot).map(
  (slot) => [view.cells.number(slot), [...view.cells.cell(slot), view.cells.kind(slot)]]))"""
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
    made = HandMadeRecords(with_gripper(made_scene(), links=links), run="mug")
    made.record(FEW)
    return made


@contextmanager
def serving_records(records: HandMadeRecords) -> Iterator[str]:
    feed = FakeFeed().step(time.time() + PATIENCE)  # it stays live however slow the browser is
    with serving(feed, library=RunCaches(records)) as address:
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


def test_what_is_found_while_one_looks_appears(page: Page, records: HandMadeRecords) -> None:
    records.record(finds([12, 13], [(0, 0, 9), (0, -9, 3)], [Outcome.HELD] * 2))  # one is in a known cell
    expect(page.locator("#scene-words")).to_have_text("5 cells of 1 cm")
    expect(page.locator("#scene-key li b")).to_have_text(["0", "1", "4"])


def test_what_a_recorder_took_with_it_is_said(chromium: Any, records: HandMadeRecords) -> None:
    feed = FakeFeed()
    feed.steps = BUDGET // STEP
    feed.step(time.time() - 40)
    with serving(feed, library=RunCaches(records)) as address:
        for page in visited(chromium, f"{address}/#job=mug"):
            expect(page.locator("#state")).to_contain_text("ended")
            expect(page.locator("#scene-words")).to_have_text(
                re.compile("^4 cells of 1 cm; .* more are in the run's folder: qdgrasp view$")
            )


def test_another_job_of_the_same_name_is_shown_with_its_own_object(alone, records) -> None:
    assert alone.evaluate("[view.description.gripper, view.cells.size]") == ["jaw", 4]
    many = finds(range(30), [(9, 9, k) for k in range(30)], [Outcome.HELD] * 30)
    records.become(made_scene("claw"), JournalId("2" * 64, 2.0), many)
    alone.wait_for_function("() => view.objects?.description.gripper === 'claw' && view.cells.size === 30")


def test_the_keyboard_goes_through_grasps_the_best_first(page: Page) -> None:
    page.locator("#scene").focus()
    page.keyboard.press("n")
    expect(page.locator("#grasp h4")).to_have_text("Grasp 8")
    page.keyboard.press("Escape")
    expect(page.locator("#grasp")).to_be_hidden()
    for key, number in {"n": 8, "p": 3}.items():
        page.keyboard.press(key)
        expect(page.locator("#grasp h4")).to_have_text(f"Grasp {number}")
    expect(page.locator("#grasp .replay code").first).to_have_text("qdgrasp show runs/mug --grasp 3")
    expect(page.locator("#grasp")).to_contain_text("no disturbance survived")


def test_thousands_are_written_in_one_way(page: Page, records: HandMadeRecords) -> None:
    many = [(column, row, 20) for column in range(30) for row in range(40)]
    records.record(finds(range(20, 1220), many, [Outcome.HELD] * 1200))
    expect(page.locator("#scene-words")).to_have_text(re.compile("^1\u202f204 cells of 1 cm"))
    expect(page.locator("#scene-key li b").last).to_have_text("1\u202f202")


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


def test_kinds_may_be_left_out(page: Page) -> None:
    page.locator("#scene-key").get_by_role("button", name="all survived").click()
    expect(page.locator("#scene-words")).to_have_text("2 of 4 cells of 1 cm")
    page.get_by_role("button", name="Next grasp").click()
    expect(page.locator("#grasp h4")).to_have_text("Grasp 4")


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


def test_a_click_beside_all_voxels_lets_the_grasp_go(alone: Page) -> None:
    alone.evaluate("view.select(8)")
    alone.wait_for_function("() => window.grasp && view.objects.hand.visible")
    alone.mouse.click(20, 20)
    alone.wait_for_function("() => window.grasp === null")
    alone.wait_for_function(STAND, arg=False)


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


def test_between_two_of_the_server_s_frames_the_hand_is_between_them(alone: Page) -> None:
    alone.evaluate("view.select(8)")
    alone.wait_for_function("() => window.grasp && view.objects.hand.visible")
    alone.evaluate("view.closed = 0.45")
    first, second = (np.array(alone.evaluate("grasp.frames.left_finger"))[place, :3] for place in (4, 5))
    found = np.reshape(alone.evaluate(STANDS)["left_finger"], (4, 4)).T[:3, 3]
    assert np.linalg.norm(second - first) > 1e-3
    assert np.allclose(found, (first + second) / 2, atol=1e-9)


def test_pages_that_come_by_and_by_leave_what_one_would(alone: Page, records: HandMadeRecords) -> None:
    more = random_finds(300)
    more["number"] += 20
    for start in range(0, 300, 100):
        records.record(more[start : start + 100])
        alone.wait_for_function("(upto) => Math.max(...view.cells.order()) >= upto - 60", arg=records.rows)
    cells = len(np.unique(records.found["descriptor"], axis=0))
    alone.wait_for_function("(words) => window.words === words", arg=f"{cells} cells of 1 cm")
    by_and_by = alone.evaluate(CONTENT)
    alone.evaluate("view.stop()")
    alone.evaluate(ALONE)
    assert alone.evaluate(CONTENT) == by_and_by


def test_a_journal_that_fell_back_is_shown_anew(alone: Page, records: HandMadeRecords) -> None:
    records.found, records.rows = FEW[:0], 0
    records.record(finds([2], [(0, 0, 9)], [Outcome.SHAKEN]))
    alone.wait_for_function("() => window.words === '1 cell of 1 cm'")
    assert alone.evaluate(CONTENT) == {"2": [0, 0, 9, 1]}


def test_nothing_is_drawn_while_nothing_changes(alone: Page) -> None:
    drawn = alone.evaluate(RESTS)
    assert drawn > 0
    alone.evaluate("view.cut = true")
    assert alone.evaluate(RESTS) > drawn


def test_the_view_comes_back_after_the_graphics_were_lost(alone: Page) -> None:
    alone.evaluate("window.card = view.renderer.webgl.getContext().getExtension('WEBGL_lose_context')")
    alone.evaluate("card.loseContext()")
    alone.wait_for_function("() => window.words.startsWith('The graphics were lost')")
    drawn = alone.evaluate("view.renderer.drawn")
    alone.evaluate("card.restoreContext()")
    alone.wait_for_function("(drawn) => view.renderer.drawn > drawn", arg=drawn)
    click(alone, 9)


def test_a_view_that_was_stopped_holds_nothing(alone: Page, records: HandMadeRecords) -> None:
    alone.evaluate("view.select(8)")
    alone.wait_for_function("() => window.grasp && view.objects.hand.visible")
    alone.evaluate(RESTS)
    assert alone.evaluate("view.renderer.webgl.info.memory.geometries") > 0
    alone.evaluate("view.stop()")
    assert alone.evaluate("view.renderer.webgl.info.memory.geometries") == 0
    assert alone.evaluate("document.querySelectorAll('.scene-axes').length") == 0


def test_where_motion_is_unwelcome_new_cells_do_not_flash(chromium: Any, place: str, records) -> None:
    for page in visited(chromium, place.replace("#job=mug", BARE), reduced_motion="reduce"):
        page.evaluate(ALONE)
        records.record(finds([12], [(0, 0, 9)], [Outcome.HELD]))
        page.wait_for_function("() => window.words === '5 cells of 1 cm'")
        assert not page.evaluate("view.objects.voxels.glows(performance.now() / 1000)")


def test_keys_turn_move_and_zoom_and_home_takes_all_of_it_back(alone: Page) -> None:
    state = (
        "[...view.renderer.projection.camera.position.toArray(), view.renderer.projection.scale, "
        "...view.renderer.controls.target.toArray()]"
    )
    first = alone.evaluate(state)
    alone.locator("canvas").focus()
    for key, changed in {"ArrowLeft": 0, "ArrowUp": 2, "+": 3, "Shift+ArrowRight": 4}.items():
        before = alone.evaluate(state)
        alone.keyboard.press(key)
        alone.wait_for_function(
            f"([before, k]) => Math.abs({state}[k] - before[k]) > 1e-3", arg=[before, changed]
        )
    alone.keyboard.press("Home")
    alone.evaluate(RESTS)
    assert np.allclose(alone.evaluate(state), first)


def test_plus_shows_things_larger_and_minus_smaller(alone: Page) -> None:
    scale = "view.renderer.projection.scale"
    alone.locator("canvas").focus()
    first = alone.evaluate(scale)
    alone.keyboard.press("+")
    alone.wait_for_function(f"(before) => {scale} > 1.1 * before", arg=first)
    for _ in range(2):
        alone.keyboard.press("-")
    alone.wait_for_function(f"(before) => {scale} < before / 1.1", arg=first)


def test_around_a_large_object_voxels_are_drawn_large_enough_to_be_seen(alone: Page) -> None:
    """Squares have a quarter more than the edge of a cube, which is at least 5 pixels."""
    sizes = alone.evaluate("""() => {
      const { renderer, objects } = view, { right, up, toward } = renderer.projection;
      return [100, 400, 4000].map((scale) => objects.voxels.aim({ right, up, toward, scale, plain: true }));
    }""")
    assert sizes == pytest.approx([1.25 * 5, 1.25 * 5, 1.25 * 0.0078 * 4000])


def test_what_takes_long_is_drawn_coarsely_and_finely_again_when_it_does_not(alone: Page) -> None:
    finest, coarsest, again = alone.evaluate(
        """async () => {
          const { RenderQuality } = await import("/static/scene/renderer.js");
          const quality = new RenderQuality(), levels = [quality.level];
          for (const ms of [90, 8]) {
            for (let frame = 0; frame < 40; frame++) quality.addFrame(ms);
            levels.push(quality.level);
          }
          return levels;
        }"""
    )
    assert finest == again == {"scale": 1, "plain": False, "share": 1}
    assert coarsest["plain"]
    assert coarsest["scale"] * coarsest["share"] < 0.5


def test_another_view_may_take_over_the_canvas(alone: Page) -> None:
    alone.evaluate("view.stop()")
    alone.evaluate(
        """async () => {
          const { SceneView } = await import("/static/scene/scene_view.js");
          window.view = new SceneView(document.querySelector("canvas"), "/api", "mug", "mug");
          view.onselect = (grasp) => (window.grasp = grasp);
          await view.start();
        }"""
    )
    click(alone, 9)


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
    made = HandMadeRecords(scene, run="mug")
    made.record(SCORED)
    return made


@pytest.fixture
def filtered(chromium: Any, scored: HandMadeRecords) -> Iterator[Page]:
    with serving_records(scored) as found:
        for page in visited(chromium, found):
            expect(page.locator("#scene-words")).to_have_text("5 cells of 1 cm")
            page.locator("#scene-filters summary").click()
            yield page


def slide(filtered: Page, name: str, to: float) -> None:
    """Move a handle, as the arrow keys would."""
    filtered.get_by_label(name).evaluate(
        "(node, to) => { node.value = to; node.dispatchEvent(new Event('input', { bubbles: true })); }", to
    )


def kinds(filtered: Page) -> Any:
    """Expect numbers of cells of each kind, from worst to best."""
    return expect(filtered.locator("#scene-key li b"))


def test_of_each_cell_the_best_grasp_is_shown_at_first(filtered: Page) -> None:
    kinds(filtered).to_have_text(["1", "1", "3"])


def test_a_synergy_shows_the_cells_that_it_grasps_from_with_its_own_best(filtered: Page) -> None:
    filtered.get_by_label("Synergy").select_option("power")
    expect(filtered.locator("#scene-words")).to_have_text("3 of 5 cells of 1 cm")
    kinds(filtered).to_have_text(["2", "0", "1"])
    filtered.get_by_label("Synergy").select_option("any")
    expect(filtered.locator("#scene-words")).to_have_text("5 cells of 1 cm")


def test_a_kind_that_is_left_out_uncovers_what_else_is_in_its_cells(filtered: Page) -> None:
    filtered.locator("#scene-key").get_by_role("button", name="all survived").click()
    expect(filtered.locator("#scene-words")).to_have_text("3 of 5 cells of 1 cm")
    kinds(filtered).to_have_text(["2", "1", "\N{EN DASH}"])


def test_only_grasps_with_the_least_eta_are_shown(filtered: Page) -> None:
    slide(filtered, "eta at least", 0.5)
    expect(filtered.locator("#scene-words")).to_have_text("3 of 5 cells of 1 cm")
    expect(filtered.locator("#scene-filters summary")).to_have_text("Filters 1 in use")
    slide(filtered, "eta at least", 0.75)
    expect(filtered.locator("#scene-words")).to_have_text("1 of 5 cells of 1 cm")


def test_what_holds_in_two_engines_is_shown_alone_where_there_is_a_table(filtered, scored) -> None:
    expect(filtered.get_by_label("Holds in")).to_be_hidden()
    scored.tables = {"mujoco": engine_table(SCORED, [Outcome.HELD, Outcome.HELD, Outcome.SHAKEN])}
    filtered.get_by_label("Holds in bullet and mujoco").check()
    expect(filtered.locator("#scene-words")).to_have_text("1 of 5 cells of 1 cm")
    expect(filtered.locator("#scene-filters summary")).to_have_text("Filters 1 in use")
    assert "all=1" in filtered.url
    filtered.get_by_role("button", name="Show all").click()
    expect(filtered.locator("#scene-words")).to_have_text("5 cells of 1 cm")
    assert "all" not in filtered.url.partition("#")[2]


def test_a_box_shows_what_is_in_it(filtered: Page) -> None:
    slide(filtered, "y lowest", 1)
    expect(filtered.locator("#scene-words")).to_have_text("2 of 5 cells of 1 cm")
    slide(filtered, "z highest", 0)
    expect(filtered.locator("#scene-words")).to_have_text("1 of 5 cells of 1 cm")
    expect(filtered.locator("#scene-filters summary")).to_have_text("Filters 2 in use")


def test_one_handle_takes_the_other_along_rather_than_go_beyond_it(filtered: Page) -> None:
    slide(filtered, "x highest", -3)
    slide(filtered, "x lowest", 5)
    has_values(filtered, "5", "5")
    expect(filtered.locator("#scene-words")).to_have_text("0 of 5 cells of 1 cm")


def test_two_handles_in_one_place_are_drawn_either_way(filtered: Page) -> None:
    for name in ("x lowest", "x highest"):
        slide(filtered, name, 0)
    drag(filtered, "x highest", -4)
    has_values(filtered, "-4", "-4")
    drag(filtered, "x highest", 6)
    has_values(filtered, "-4", "6")


def drag(filtered: Page, name: str, to: float) -> None:
    """Draw a handle of the axis, from -9 to 9, with the mouse."""
    handle = filtered.get_by_label(name)
    handle.scroll_into_view_if_needed()
    place = handle.bounding_box()
    height = place["y"] + place["height"] / 2
    at = [
        place["x"] + 8 + (value + 9) / 18 * (place["width"] - 16) for value in (int(handle.input_value()), to)
    ]
    filtered.mouse.move(at[0], height)
    filtered.mouse.down()
    filtered.mouse.move(at[1], height, steps=4)
    filtered.mouse.up()


def has_values(filtered: Page, lowest: str, highest: str) -> None:
    """Wait until the handles of x are there."""
    expect(filtered.get_by_label("x lowest")).to_have_value(lowest)
    expect(filtered.get_by_label("x highest")).to_have_value(highest)


def test_show_all_takes_every_filter_back(filtered: Page) -> None:
    filtered.get_by_label("Synergy").select_option("pinch")
    slide(filtered, "x lowest", 0)
    slide(filtered, "eta at least", 0.3)
    filtered.get_by_role("button", name="Show all").click()
    expect(filtered.locator("#scene-words")).to_have_text("5 cells of 1 cm")
    expect(filtered.get_by_label("Synergy")).to_have_value("")
    expect(filtered.get_by_label("x lowest")).to_have_value("-9")
    expect(filtered.get_by_role("button", name="Show all")).to_be_disabled()


def test_the_next_grasp_is_among_those_that_are_shown_the_best_first(filtered: Page) -> None:
    filtered.get_by_label("Synergy").select_option("power")
    for number, synergy in ((5, "power"), (3, "power"), (12, "power"), (5, "power")):
        filtered.locator("#scene").press("n")
        expect(filtered.locator("#grasp h4")).to_have_text(f"Grasp {number}")
        expect(filtered.locator("#grasp")).to_contain_text(synergy)


def test_what_is_found_while_one_looks_passes_the_filters_too(filtered, scored) -> None:
    filtered.get_by_label("Synergy").select_option("power")
    more = finds([20, 21], [(9, 9, 9), (8, 8, 8)], [Outcome.HELD] * 2, synergies=[0, 1], etas=[0.2, 0.2])
    scored.record(more)
    expect(filtered.locator("#scene-words")).to_have_text("4 of 7 cells of 1 cm")
    expect(filtered.get_by_label("y highest")).to_have_attribute("max", "9")
    expect(filtered.get_by_label("z highest")).to_have_value("9")


def test_the_card_says_which_frame_is_meant(filtered: Page) -> None:
    filtered.locator("#scene").press("n")
    card = filtered.locator("#grasp")
    expect(card.locator("summary").first).to_have_text("Commanded pose of palm")
    expect(card).to_contain_text("Where the hand settled is not recorded: drawn is the commanded pose")
    expect(card).to_contain_text("From the centre of mass [mm]0.0, -90.0, 30.0")
    expect(card).to_contain_text("eta0.900")
    names = filtered.locator(".scene-frames .name")
    expect(names).to_have_text(["object (centre of mass)", "hand (palm)"])


FRAMES = """() => [...document.querySelectorAll(".scene-frames > g")].map((frame) => {
  const { x, width } = frame.querySelector(".name").getBBox(), lines = [...frame.querySelectorAll("line")];
  const along = (line, axis) => line[`${axis}2`].baseVal.value - line[`${axis}1`].baseVal.value;
  const length = (line) => Math.hypot(along(line, "x"), along(line, "y"));
  return [x, x + width, lines[0].x1.baseVal.value, Math.max(...lines.map(length))];
})"""
"""Of each frame: both ends of its name, its origin, and its longest axis [px]."""


def test_names_of_frames_stand_beside_them_and_axes_are_seen_from_afar(filtered: Page) -> None:
    filtered.locator("#scene").press("n")
    expect(filtered.locator(".scene-frames .name")).to_have_count(2)
    for _ in range(20):
        filtered.locator("#scene").press("-")
    filtered.wait_for_function(f"() => ({FRAMES})().every(([, , , longest]) => longest < 27)")
    for left, right, origin, longest in filtered.evaluate(FRAMES):
        assert not left <= origin <= right
        assert longest > 20


def test_frames_may_be_left_out(filtered: Page) -> None:
    filtered.locator("#scene").press("n")
    expect(filtered.locator(".scene-frames")).to_be_visible()
    filtered.locator("#scene").press("f")
    expect(filtered.locator(".scene-frames")).to_be_hidden()
    expect(filtered.get_by_role("button", name="Draw the frames")).to_have_attribute("aria-pressed", "false")


CLOSED = finds(
    [2, 3, 5, 8, 9],
    [(0, -9, 3), (0, -9, 3), (9, 0, 3), (-9, 0, 3), (0, 9, 3)],
    [Outcome.HELD, Outcome.DROPPED, Outcome.HELD, Outcome.SHAKEN, Outcome.HELD],
    penetration=[0.006, 0.001, 0.002, 0.004, 0.0],
    contacts=[1, 2, 3, 2, 1],
    settled=[
        *((0, -0.09, 0.03 + moved, 0, 0, 0, 1) for moved in (0.001, 0.002)),
        (0.09, 0, 0.04, 0, 0, 0, 1),
        (-0.09, 0, 0.05, 0, 0, 0, 1),
        np.zeros(7),
    ],
)


@pytest.fixture
def closed(chromium: Any) -> Iterator[tuple[Page, str]]:
    """A page with its filters open, and its address."""
    records = HandMadeRecords(made_scene(), run="mug")
    records.record(CLOSED)
    with serving_records(records) as found:
        for page in visited(chromium, found):
            expect(page.locator("#scene-words")).to_have_text("4 cells of 1 cm")
            page.locator("#scene-filters summary").click()
            yield page, found


@pytest.mark.parametrize(
    ("name", "most", "cells", "numbers"),
    [
        ("Most penetration [mm]", "2", "3 of 4 cells of 1 cm", [5, 9, 3]),
        ("Most motion [mm]", "9.9", "1 of 4 cells of 1 cm", [2]),
        ("Fewest finger links", "2", "3 of 4 cells of 1 cm", [5, 8, 3]),
    ],
)
def test_only_grasps_that_closed_so_well_are_shown_and_gone_through(closed, name, most, cells, numbers):
    page, _ = closed
    page.get_by_label(name).fill(most)
    expect(page.locator("#scene-words")).to_have_text(cells)
    expect(page.locator("#scene-filters summary")).to_have_text("Filters 1 in use")
    for number in [*numbers, numbers[0]]:
        page.locator("#scene").press("n")
        expect(page.locator("#grasp h4")).to_have_text(f"Grasp {number}")


def test_filters_are_kept_in_the_address_until_all_is_shown(closed: tuple[Page, str], chromium: Any) -> None:
    page, found = closed
    page.get_by_label("Most penetration").fill("5")
    page.get_by_label("Fewest finger links").fill("2")
    expect(page).to_have_url(f"{found}&penetration=5&contacts=2")
    for other in visited(chromium, page.url):
        expect(other.locator("#scene-words")).to_have_text("3 of 4 cells of 1 cm")
        expect(other.locator("#scene-filters summary")).to_have_text("Filters 2 in use")
        other.locator("#scene-filters summary").click()
        expect(other.get_by_label("Most penetration")).to_have_value("5")
        other.get_by_role("button", name="Show all").click()
        expect(other.locator("#scene-words")).to_have_text("4 cells of 1 cm")
        expect(other).to_have_url(found)
        expect(other.get_by_label("Fewest finger links")).to_have_value("")


def test_margins_are_counted_as_they_come_and_then_filtered_by(closed, monkeypatch) -> None:
    margins, goes_on = {2: 0.01, 3: 0.05, 5: 0.02, 8: 0.06}, threading.Event()

    def computed(rows: SuccessTable, _: SceneObject) -> NDArray[np.float64]:
        assert rows["number"][0] != 8 or goes_on.wait(PATIENCE)
        return np.array([margins[number] for number in rows["number"].tolist()])

    monkeypatch.setattr(run_cache, "recorded_margins", computed)
    monkeypatch.setattr(run_cache, "MARGINS_AT_ONCE", 1)
    monkeypatch.setattr(run_cache, "MARGIN_SECONDS", -1.0)  # out of time after each
    page, found = closed
    words, summary = page.locator("#scene-words"), page.locator("#scene-filters summary")
    page.get_by_label("Least margin").fill("0.05")
    expect(summary).to_have_text("Filters 1 in use, margins: 3 of 4")
    expect(words).to_have_text("1 of 4 cells of 1 cm")
    goes_on.set()
    expect(summary).to_have_text("Filters 1 in use")
    expect(words).to_have_text("2 of 4 cells of 1 cm")
    expect(page).to_have_url(f"{found}&margin=0.05")
    for number in (8, 3, 8):
        page.locator("#scene").press("n")
        expect(page.locator("#grasp h4")).to_have_text(f"Grasp {number}")


@pytest.mark.parametrize(
    ("there", "missing"),
    [
        pytest.param("Most penetration", ("Most motion", "Least margin"), id="no grasp settled"),
        pytest.param("x lowest", ("Synergy", "eta at least"), id="neither synergies nor eta"),
    ],
)
def test_there_is_no_filter_of_what_no_grasp_has(there: str, missing: tuple[str, ...], chromium: Any) -> None:
    records = HandMadeRecords(made_scene(), run="mug")
    records.record(SCORED)
    with serving_records(records) as found:
        for page in visited(chromium, found):
            page.locator("#scene-filters summary").click()
            expect(page.get_by_label(there)).to_be_visible()
            for label in missing:
                expect(page.get_by_label(label)).to_be_hidden()
