"""The best grasps as pictures, two grasps beside each other, and a grasp as a file, in a browser."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests import browser
from tests.browser import expect
from tests.coordinator.scenes import made_scene
from tests.tools.monitor.web import test_scene
from tests.tools.monitor.web.conftest import HandMadeRecords, finds

from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.monitor.records import JournalId
from qdgrasp_tools.monitor.web.run_cache import run_caches

Page = Any
records = test_scene.records
"""Records of four grasps: 8, 9, 4, 3, best first."""


@pytest.fixture
def page(chromium: Any, records: HandMadeRecords) -> Iterator[Page]:
    with test_scene.serving_records(records) as place:
        for visit in test_scene.visited(chromium, place, accept_downloads=True):
            expect(visit.locator("#scene-best button")).to_have_count(4)
            yield visit


def numbers(page: Page) -> list[str]:
    return page.locator("#scene-best button span").all_inner_texts()


@browser.needed
def test_the_best_grasps_are_pictures_the_best_first(page: Page) -> None:
    assert numbers(page) == ["8", "9", "4", "3"]
    names = page.locator("#scene-best button").evaluate_all("all => all.map((one) => one.ariaLabel)")
    assert names[:2] == [
        "Grasp 8: all survived, penetration 1.0 mm",
        "Grasp 9: all survived, penetration 3.0 mm",
    ]
    loaded = (
        "() => [...document.querySelectorAll('#scene-best img')].every((one) => one.naturalWidth === 132)"
    )
    page.wait_for_function(loaded)


@browser.needed
def test_two_grasps_stand_beside_each_other_seen_from_one_side(page: Page) -> None:
    page.keyboard.press("n")
    page.get_by_role("button", name="Keep beside").click()
    kept = page.locator("#beside")
    expect(kept.locator("b")).to_have_text("Grasp 8")
    expect(kept.locator("header span")).to_have_text(
        "all survived · fitness 2 · margin 0.000 · penetration 1.00 mm · 2 finger links · moved 89.9 mm"
    )
    page.keyboard.press("n")
    expect(page.locator("#grasp h4")).to_have_text("Grasp 9")
    expect(kept.locator("b")).to_have_text("Grasp 8")
    expect(kept.locator(".scene-contacts g")).to_have_count(2)
    page.get_by_label("Closing of the hand").press("ArrowLeft")
    expect(kept.locator(".scene-contacts g")).to_have_count(0)
    kept.get_by_role("button", name="Let the kept grasp go").click()
    expect(kept).to_be_hidden()


@browser.needed
def test_a_grasp_is_a_file_with_its_frames_and_units(page: Page) -> None:
    page.keyboard.press("n")
    with page.expect_download() as download:
        page.get_by_role("button", name="Download").click()
    assert download.value.suggested_filename == "jaw-block-8.json"
    told = json.loads(Path(download.value.path()).read_text())
    assert (told["number"], told["gripper"], told["object"]) == (8, "jaw", "block")
    assert told["units"] == "m, rad, N"
    assert told["settled"]["position"] == pytest.approx([-0.05, 0, 0.03])
    assert told["joints"] == pytest.approx({"left": 0.01, "right": 0.02})
    assert len(told["contacts"]) == 2
    assert "frames" not in told


def test_in_another_journal_the_same_number_is_another_picture(records: HandMadeRecords) -> None:
    cache = run_caches(records, clock=lambda: records.now)("mug", "mug")
    before = cache.picture(8)
    records.become(made_scene(), JournalId("2" * 64, 2.0), finds([8], [(9, 9, 9)], [Outcome.HELD]))
    records.now += 100
    assert cache.picture(8) != before
