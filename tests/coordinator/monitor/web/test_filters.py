"""Filters of the view in 3D in a browser: what they leave, and that they say so."""

import time
from collections.abc import Iterator
from typing import Any

import pytest
from msgspec.structs import replace
from tests import browser
from tests.browser import expect
from tests.common import PATIENCE, free_port
from tests.coordinator.monitor.web.conftest import serving
from tests.coordinator.monitor.web.fakes import FakeFeed, HandMadeRecords, finds
from tests.coordinator.scenes import made_scene

from qdgrasp_assets.scene import Scene, Synergy
from qdgrasp_coordinator.monitor.web.run_cache import RunCaches
from qdgrasp_protocol.rows import Outcome

pytestmark = browser.needed
NUMBERS = [2, 3, 5, 8, 9, 12]
FOUND = finds(
    NUMBERS,
    [(0, -9, 3), (0, -9, 3), (9, 0, 3), (-9, 0, 3), (0, 9, 3), (0, 9, -4)],
    [Outcome.HELD, Outcome.DROPPED, Outcome.HELD, Outcome.SHAKEN, Outcome.HELD, Outcome.DROPPED],
    synergies=[0, 1, 1, 0, 0, 1],
    etas=[0.9, 0.1, 0.5, 0.4, 0.7, 0.0],
)
Page = Any


def robust_scene() -> Scene:
    scene = made_scene()
    named = tuple(Synergy(name=name, joints=("left",)) for name in ("pinch", "power"))
    return replace(scene, protocol="robust", gripper=replace(scene.gripper, synergies=named))


@pytest.fixture
def records() -> HandMadeRecords:
    made = HandMadeRecords(robust_scene(), run="mug")
    made.record(FOUND)
    return made


@pytest.fixture
def page(chromium: Any, records: HandMadeRecords) -> Iterator[Page]:
    feed = FakeFeed()
    feed.step(time.time() + PATIENCE)  # it stays live however slow the browser is
    with serving(feed, free_port(), library=RunCaches(records)) as address:
        visit = browser.Visit(chromium, f"{address}/#job=mug")
        expect(visit.page.locator("#scene-words")).to_have_text("5 cells of 1 cm")
        visit.page.locator("#scene-filters summary").click()
        yield visit.page
        visit.context.close()
        assert visit.complaints == []


def slide(page: Page, name: str, to: float) -> None:
    """Move a handle, as the arrow keys would."""
    page.get_by_label(name).evaluate(
        "(node, to) => { node.value = to; node.dispatchEvent(new Event('input', { bubbles: true })); }", to
    )


def shown(page: Page) -> Any:
    """What is expected of the numbers of cells that show each kind, from worst to best."""
    return expect(page.locator("#scene-key li b"))


def test_of_each_cell_the_best_grasp_is_shown_at_first(page: Page) -> None:
    shown(page).to_have_text(["1", "1", "3"])


def test_a_synergy_shows_the_cells_that_it_grasps_from_with_its_own_best(page: Page) -> None:
    page.get_by_label("Synergy").select_option("power")
    expect(page.locator("#scene-words")).to_have_text("3 of 5 cells of 1 cm")
    shown(page).to_have_text(["2", "0", "1"])
    page.get_by_label("Synergy").select_option("any")
    expect(page.locator("#scene-words")).to_have_text("5 cells of 1 cm")


def test_a_kind_that_is_left_out_uncovers_what_else_is_in_its_cells(page: Page) -> None:
    page.get_by_role("button", name="both survived").click()
    expect(page.locator("#scene-words")).to_have_text("3 of 5 cells of 1 cm")
    shown(page).to_have_text(["2", "1", "\N{EN DASH}"])


def test_only_grasps_with_the_least_eta_are_shown(page: Page) -> None:
    slide(page, "eta at least", 0.5)
    expect(page.locator("#scene-words")).to_have_text("3 of 5 cells of 1 cm")
    expect(page.locator("#scene-filters summary")).to_have_text("Filters 1 in use")
    slide(page, "eta at least", 0.75)
    expect(page.locator("#scene-words")).to_have_text("1 of 5 cells of 1 cm")


def test_a_box_shows_what_is_in_it(page: Page) -> None:
    slide(page, "y lowest", 1)
    expect(page.locator("#scene-words")).to_have_text("2 of 5 cells of 1 cm")
    slide(page, "z highest", 0)
    expect(page.locator("#scene-words")).to_have_text("1 of 5 cells of 1 cm")
    expect(page.locator("#scene-filters summary")).to_have_text("Filters 2 in use")


def test_one_handle_takes_the_other_along_rather_than_go_beyond_it(page: Page) -> None:
    slide(page, "x highest", -3)
    slide(page, "x lowest", 5)
    has_values(page, "5", "5")
    expect(page.locator("#scene-words")).to_have_text("0 of 5 cells of 1 cm")


def test_two_handles_in_one_place_are_drawn_either_way(page: Page) -> None:
    for name in ("x lowest", "x highest"):
        slide(page, name, 0)
    drag(page, "x highest", -4)
    has_values(page, "-4", "-4")
    drag(page, "x highest", 6)
    has_values(page, "-4", "6")


def drag(page: Page, name: str, to: float) -> None:
    """Draw a handle of the axis, from -9 to 9, with the mouse."""
    handle = page.get_by_label(name)
    handle.scroll_into_view_if_needed()
    place = handle.bounding_box()
    height = place["y"] + place["height"] / 2
    at = [
        place["x"] + 8 + (value + 9) / 18 * (place["width"] - 16) for value in (int(handle.input_value()), to)
    ]
    page.mouse.move(at[0], height)
    page.mouse.down()
    page.mouse.move(at[1], height, steps=4)
    page.mouse.up()


def has_values(page: Page, lowest: str, highest: str) -> None:
    """Wait until the handles of x are there."""
    expect(page.get_by_label("x lowest")).to_have_value(lowest)
    expect(page.get_by_label("x highest")).to_have_value(highest)


def test_show_all_takes_every_filter_back(page: Page) -> None:
    page.get_by_label("Synergy").select_option("pinch")
    slide(page, "x lowest", 0)
    slide(page, "eta at least", 0.3)
    page.get_by_role("button", name="Show all").click()
    expect(page.locator("#scene-words")).to_have_text("5 cells of 1 cm")
    expect(page.get_by_label("Synergy")).to_have_value("")
    expect(page.get_by_label("x lowest")).to_have_value("-9")
    expect(page.get_by_role("button", name="Show all")).to_be_disabled()


def test_the_next_grasp_is_among_those_that_are_shown_the_best_first(page: Page) -> None:
    page.get_by_label("Synergy").select_option("power")
    for number, synergy in ((5, "power"), (3, "power"), (12, "power"), (5, "power")):
        page.locator("#scene").press("n")
        expect(page.locator("#grasp h4")).to_have_text(f"Grasp {number}")
        expect(page.locator("#grasp")).to_contain_text(synergy)


def test_what_is_found_while_one_looks_passes_the_filters_too(page: Page, records: HandMadeRecords) -> None:
    page.get_by_label("Synergy").select_option("power")
    more = finds([20, 21], [(9, 9, 9), (8, 8, 8)], [Outcome.HELD] * 2, synergies=[0, 1], etas=[0.2, 0.2])
    records.record(more)
    expect(page.locator("#scene-words")).to_have_text("4 of 7 cells of 1 cm")
    expect(page.get_by_label("y highest")).to_have_attribute("max", "9")
    expect(page.get_by_label("z highest")).to_have_value("9")


def test_the_card_says_which_frame_is_meant(page: Page) -> None:
    page.locator("#scene").press("n")
    card = page.locator("#grasp")
    expect(card.locator("h5")).to_have_text("Pose of palm")
    expect(card).to_contain_text("From the centre of mass [mm]0.0, -90.0, 30.0")
    expect(card).to_contain_text("eta0.900")
    names = page.locator(".scene-frames .name")
    expect(names).to_have_text(["object (centre of mass)", "hand (palm)"])


def test_frames_may_be_left_out(page: Page) -> None:
    page.locator("#scene").press("n")
    expect(page.locator(".scene-frames")).to_be_visible()
    page.locator("#scene").press("f")
    expect(page.locator(".scene-frames")).to_be_hidden()
    expect(page.get_by_role("button", name="Draw the frames")).to_have_attribute("aria-pressed", "false")


def test_a_hand_without_synergies_or_eta_has_no_such_filters(chromium: Any) -> None:
    records, feed = HandMadeRecords(made_scene(), run="mug"), FakeFeed()
    records.record(FOUND)
    feed.step()
    with serving(feed, free_port(), library=RunCaches(records)) as address:
        visit = browser.Visit(chromium, f"{address}/#job=mug")
        expect(visit.page.locator("#scene-words")).to_contain_text("cells of 1 cm")
        visit.page.locator("#scene-filters summary").click()
        expect(visit.page.get_by_label("x lowest")).to_be_visible()
        expect(visit.page.get_by_label("Synergy")).to_be_hidden()
        expect(visit.page.get_by_label("eta at least")).to_be_hidden()
        visit.context.close()
