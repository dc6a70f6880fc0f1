"""The page in a browser: jobs made by hand."""

import re
import time
from collections.abc import Callable, Iterator
from itertools import count
from typing import Any

import pytest
from msgspec.structs import replace
from tests import browser
from tests.browser import PHONE, expect, figure, number
from tests.common import free_port, wait_for
from tests.tools.monitor.sample_jobs import curve, run, values
from tests.tools.monitor.web.conftest import BUDGET, STEP, FakeFeed, FakeLibrary, serving

from qdgrasp_coordinator.metrics.job_status import RunListing, RunListings, to_json
from qdgrasp_protocol.keys import Keys

pytestmark = browser.needed
Page = Any
Look = Callable[..., Page]

CONTRAST = """() => {
  const channel = (value) => ((value /= 255) <= 0.03928 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);
  const brightness = ([r, g, b]) => 0.2126 * channel(r) + 0.7152 * channel(g) + 0.0722 * channel(b);
  const parts = (colour) => colour.match(/[\\d.]+/g).map(Number);
  const behind = (node) => {
    for (; node; node = node.parentElement) {
      const [r, g, b, alpha = 1] = parts(getComputedStyle(node).backgroundColor);
      if (alpha > 0.5) return [r, g, b];
    }
    return [255, 255, 255];
  };
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const found = [];
  while (texts.nextNode()) {
    const node = texts.currentNode.parentElement, words = texts.currentNode.textContent.trim();
    if (!words || !node.checkVisibility() || node.closest(".unseen, script")) continue;
    const [one, other] = [parts(getComputedStyle(node).color), behind(node)].map(brightness);
    found.push([words, (Math.max(one, other) + 0.05) / (Math.min(one, other) + 0.05)]);
  }
  return found;
}"""
NAMELESS = """() => [...document.querySelectorAll("button, a, input, progress, [role=img], [tabindex]")]
  .filter((node) => node.checkVisibility() && !node.closest("[aria-hidden=true]"))
  .filter((node) => !(node.ariaLabel || node.textContent.trim() || node.getAttribute("aria-labelledby")))
  .map((node) => node.outerHTML)"""


FOCUSED = """() => {
  const node = document.activeElement;
  return [node.id || node.closest("[id]")?.id, getComputedStyle(node).outlineStyle];
}"""


def reached_by_keys(page: Page, steps: int) -> set[str]:
    """Names of the parts to which the tab key leads in so many steps; the focus is seen at each."""
    reached = set()
    for _ in range(steps):
        page.keyboard.press("Tab")
        seen, outline = page.evaluate(FOCUSED)
        reached.add(seen)
        assert seen in (None, "body") or outline != "none", f"where the focus is cannot be seen: {seen}"
    return reached


@pytest.fixture(scope="module")
def place() -> Iterator[str]:
    """A page of jobs that go on."""
    feed = FakeFeed()
    with feed.going_on(), serving(feed) as address:
        feed.happen("Worker 7 joined from node1.")
        yield address


def test_the_page_shows_numbers_that_grow(look: Look, place: str) -> None:
    page = look(f"{place}/#job=mug")
    expect(page).to_have_title(re.compile("^mug, running . qdgrasp$"))
    found = figure(page, "Successes")
    before = number(found.inner_text())
    page.wait_for_function(
        "([node, before]) => Number(node.textContent.replace(/\\D/g, '')) > before",
        arg=[found.element_handle(), before],
    )
    assert number(page.locator("#done").inner_text().partition(" of ")[0]) > 0
    assert float(page.locator("#progress").get_attribute("value") or 0) > 0


def test_where_evaluations_end_adds_up(look: Look, place: str) -> None:
    page = look(f"{place}/#job=mug")
    entries = page.locator("#outcomes li")
    expect(entries).to_have_count(8)
    counts, whole = page.evaluate(
        "() => [[...document.querySelectorAll('#outcomes .number')].map((node) => node.textContent), "
        "document.querySelector('#outcomes-words').textContent]"
    )
    assert sum(map(number, counts)) == number(whole)


def test_curves_are_drawn_and_their_last_points_are_told(look: Look, place: str) -> None:
    page = look(f"{place}/#job=mug")
    for plot, names in {
        "cells": ["Cells"],
        "successes": ["Successes", "Robust"],
        "speed": ["Evaluations/s"],
    }.items():
        expect(page.locator(f"#{plot} canvas")).to_be_visible()
        expect(page.locator(f"#{plot}-legend dt")).to_have_text(names)
        expect(page.locator(f"#{plot}-legend dd")).to_have_text([re.compile("[1-9]")] * len(names))


def test_of_a_few_runs_each_line_is_named_with_its_last_value(look: Look, place: str) -> None:
    page = look(f"{place}/#job=hands")
    for plot, what in {"cells": "Cells", "successes": "Successes"}.items():
        legend = page.locator(f"#{plot}-legend")
        expect(legend.locator("dt")).to_have_text([re.compile(r"^panda-\w+-aimed-s[01]$")] * 6)
        expect(legend.locator("dd")).to_have_text([re.compile("[1-9]")] * 6)
        expect(legend).to_have_attribute("data-of", what)
        colours = legend.locator("i").evaluate_all(
            "all => all.map((one) => getComputedStyle(one).borderTopColor)"
        )
        assert len({*colours}) == 6


def test_of_many_runs_the_line_near_the_cursor_is_named(look: Look) -> None:
    feed = FakeFeed(seeds=3)
    with feed.going_on(), serving(feed) as place:
        page = look(f"{place}/#job=hands")
        legend = page.locator("#cells-legend dt")
        expect(legend).to_have_text("Cells, most of 9 runs")
        expect(page.locator("#cells canvas")).to_be_visible()
        nudges = count()
        wait_for(lambda: near(page, next(nudges) % 3) and legend.inner_text().startswith("Cells of panda-"))
        page.context.close()


def test_waiting_runs_and_shapes_that_are_being_built_are_told(look: Look) -> None:
    feed = FakeFeed()
    shapes = {"scenes": 4, "scenes_done": 1, "building": ["/parts/lever.stl", "mug"]}
    told = {key: value for key, value in values(runs=7, **shapes).items() if "/stat/run/" not in key}
    feed.jobs.receive_answers(told, time.time() + browser.PATIENCE)
    with serving(feed) as place:
        page = look(f"{place}/#job=mugs")
        expect(page.locator("#runs-words")).to_have_text("2 in progress, 5 waiting, 0 done")
        expect(page.locator("#done")).to_contain_text("1 of 4 shapes (being built: lever, mug)")
        page.context.close()


def test_before_a_run_has_begun_the_view_says_what_it_waits_for(look: Look) -> None:
    feed = FakeFeed()
    told = values(runs=7, runs_open=0, scenes=1, building=["mug"])
    told = {key: value for key, value in told.items() if "/stat/run/" not in key}
    feed.jobs.receive_answers(told, time.time() + browser.PATIENCE)
    with serving(feed) as place:
        page = look(f"{place}/#job=mugs")
        words = "Shapes that are being built: mug. 7 runs wait; grasps appear here when one begins."
        expect(page.locator("#scene-empty")).to_have_text(words)
        expect(page.get_by_role("button", name="Next grasp")).to_be_hidden()
        expect(page.locator("#runs")).to_be_hidden()
        expect(page.locator(".found .plot[data-none], .speed .plot[data-none]")).to_have_count(3)
        expect(page.locator("canvas:visible")).to_have_count(1)  # the view's
        page.context.close()


def near(page: Page, nudge: int) -> bool:
    """Move the cursor near the lines of the cells; what is drawn anew has to see it move."""
    box = page.locator("#cells .u-over").bounding_box()
    page.mouse.move(box["x"] + 0.9 * box["width"] + nudge, box["y"] + 0.2 * box["height"])
    return True


def test_the_view_in_3d_stands_there(look: Look, place: str) -> None:
    page = look(f"{place}/#job=mug")
    expect(page.locator("#scene-words")).to_have_text("Nothing found yet.")
    expect(page.locator("#scene-empty")).to_be_hidden()


def test_a_worker_that_was_killed_is_shown_as_gone(look: Look) -> None:
    feed = FakeFeed().step()
    with serving(feed) as place:
        page = look(f"{place}/#job=mug")
        expect(page.locator("#workers-words")).to_have_text("4 working")
        feed.gone = {2}
        feed.step()
        expect(page.locator("#workers tr[data-state=gone] th")).to_have_text("node2 4102")
        expect(page.locator("#workers-words")).to_have_text("3 working, 1 gone")


def test_the_page_goes_on_by_itself_when_the_monitor_is_back(look: Look) -> None:
    feed, port = FakeFeed(), free_port()
    feed.step()
    with serving(feed, port) as place:
        page = look(f"{place}/#job=mug")
        expect(page.locator("#link")).to_have_text("live")
        page.evaluate("() => (window.kept = true)")
    expect(page.locator("#link")).to_have_text(re.compile(r"^not connected since \d\d:\d\d:\d\d$"))
    before = number(figure(page, "Successes").inner_text())
    feed.step()
    with serving(feed, port):
        expect(page.locator("#link")).to_have_text("live")
        assert number(figure(page, "Successes").inner_text()) > before
        assert page.evaluate("() => window.kept"), "the page was loaded again"
        page.context.close()


def test_the_address_keeps_what_was_chosen(look: Look, place: str) -> None:
    page = look(f"{place}/")
    page.get_by_role("link", name=re.compile("^hands")).click()
    expect(page.locator("#name")).to_have_text("hands")
    page.get_by_role("link", name="panda-drill-aimed-s1").click()
    expect(page.locator("#name")).to_have_text("panda-drill-aimed-s1")
    assert page.url.endswith("#job=hands&run=panda-drill-aimed-s1")
    page.reload()
    expect(page.locator("#name")).to_have_text("panda-drill-aimed-s1")
    page.go_back()
    expect(page.locator("#name")).to_have_text("hands")


def test_a_job_that_is_not_heard_of_is_waited_for(look: Look) -> None:
    feed = FakeFeed()
    with serving(feed) as place:
        page = look(f"{place}/#job=mug")
        expect(page.get_by_role("heading", name="Nothing is heard of the job mug")).to_be_visible()
        expect(page.get_by_text("hears no coordinator")).to_have_count(0)  # of other jobs it may hear some
        feed.step()
        expect(page.locator("#name")).to_have_text("mug")


def test_it_says_when_the_monitor_does_not_reach_its_router(look: Look) -> None:
    feed = FakeFeed().step()
    with serving(feed) as place:
        page = look(f"{place}/#job=mug")
        expect(page.locator("#link")).to_have_text("live")
        feed.jobs.link_changed(False, time.time())
        expect(page.locator("#link")).to_have_text("the monitor does not reach its router")


def test_of_workers_of_a_silent_job_it_says_since_when_nobody_tells(look: Look) -> None:
    feed = FakeFeed().step(time.time() - 40)
    feed.jobs.link_changed(False, time.time())
    with serving(feed) as place:
        page = look(f"{place}/#job=mug")
        expect(page.locator("#workers-words")).to_have_text(
            re.compile(r"^nobody tells of them for 0:0\d:\d\d$")
        )
        expect(page.locator("#workers td[data-name=state]")).to_have_text(["unknown"] * 4)
        assert not {"now"} & set(page.locator("#workers td[data-name=seen]").all_inner_texts())
        expect(figure(page, "Workers")).to_have_text("\N{EN DASH}")


def test_a_job_that_nobody_carries_out_has_no_workers(look: Look) -> None:
    feed = FakeFeed().step(time.time() - 40)
    with serving(feed) as place:
        page = look(f"{place}/#job=mug")
        expect(page.locator("#workers-words")).to_have_text("nobody works: the job has no coordinator")
        expect(page.locator("#workers tbody tr")).to_have_count(0)
        expect(figure(page, "Workers")).to_have_text("0")


def test_of_a_router_that_went_with_its_jobs_nothing_is_said(look: Look) -> None:
    feed = FakeFeed()
    feed.steps = BUDGET // STEP
    feed.step()
    feed.jobs.link_changed(False, time.time())
    with serving(feed) as place:
        page = look(f"{place}/#job=mug")
        expect(page.locator("#state")).to_contain_text("ended")
        expect(page.locator("#link")).to_have_text("all is over")
        expect(page.locator("#workers-words")).to_have_text("nobody works: the job has ended")
        expect(page.locator("#workers")).to_be_hidden()
        expect(page.locator("#origin")).to_have_text("coordinator on head, epoch 2, version 0")  # up no more
        left = re.compile(r"^[\d\s]+ cells are in the run's folder: qdgrasp view$")
        expect(page.locator("#scene-words")).to_have_text(left)


def test_workers_are_sorted_by_the_column_that_was_chosen(look: Look, place: str) -> None:
    page = look(f"{place}/#job=mug")
    memory = page.locator("#workers td[data-name=memory]")
    expect(memory).to_have_count(4)
    page.get_by_role("button", name="Memory").click()
    sizes = [re.compile(rf"^{size}\b") for size in (201, 194, 187, 180)]
    expect(memory).to_have_text(sizes)
    expect(page.locator("#workers th[aria-sort]")).to_have_text("Memory")
    page.get_by_role("button", name="Memory").press("Enter")
    expect(memory).to_have_text(sizes[::-1])


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("phone", [False, True], ids=["desktop", "phone"])
def test_words_stand_out_from_what_is_behind_them(look: Look, place: str, theme: str, phone: bool) -> None:
    page = look(f"{place}/#job=hands", color_scheme=theme, phone=phone)
    expect(page.locator("#name")).to_have_text("hands")
    page.wait_for_function(f"() => ({CONTRAST})().length > 60")
    contrasts = page.evaluate(CONTRAST)
    assert [(words, round(ratio, 2)) for words, ratio in contrasts if ratio < 4.5] == []


def test_the_switch_wins_over_the_system_and_is_remembered(look: Look, place: str) -> None:
    page = look(f"{place}/#job=mug", color_scheme="dark")
    dark = page.evaluate("() => getComputedStyle(document.body).backgroundColor")
    switch = page.get_by_role("button", name=re.compile("^Colours"))
    switch.click()
    expect(switch).to_have_text("Light")
    light = page.evaluate("() => getComputedStyle(document.body).backgroundColor")
    assert light != dark
    page.reload()
    assert page.evaluate("() => getComputedStyle(document.body).backgroundColor") == light


@pytest.mark.parametrize("job", ["mug", "hands"])
def test_a_phone_shows_everything_without_scrolling_sideways(look: Look, place: str, job: str) -> None:
    page = look(f"{place}/#job={job}", phone=True)
    expect(page.locator("#workers tbody tr").first).to_be_visible()
    assert page.evaluate("() => document.documentElement.scrollWidth") == PHONE["width"]
    panels = (
        "() => [...document.querySelectorAll('.panel')].map((node) => node.getBoundingClientRect().right)"
    )
    assert max(page.evaluate(panels)) <= PHONE["width"]


def test_a_phone_shows_the_chosen_job_and_runs_of_long_names_with_their_figures(look: Look) -> None:
    feed = FakeFeed()
    for job in ("bottles", "boxes", "cups", "mugs"):
        told = {key: value for key, value in values(job).items() if "/stat/run/" not in key}
        told[Keys(job).stat("run/long")] = to_json(run("panda-tennis_ball-aimed-s0-sigma0_05"))
        feed.jobs.receive_answers(told, time.time() + browser.PATIENCE)
    with serving(feed) as place:
        page = look(f"{place}/#job=mugs", phone=True)
        for part in ("#jobs [aria-current]", "#runs tbody td[data-name=cells] >> nth=0"):
            box = page.locator(part).bounding_box()
            assert box["x"] + box["width"] <= PHONE["width"], part
        page.context.close()


def test_whatever_can_be_used_has_a_name(look: Look, place: str) -> None:
    page = look(f"{place}/#job=hands")
    expect(page.locator("#workers tbody tr").first).to_be_visible()
    assert page.evaluate(NAMELESS) == []
    assert page.evaluate("() => document.documentElement.lang") == "en"
    for only in ("h1", "main", "nav"):
        expect(page.locator(only)).to_have_count(1)


def test_the_keyboard_reaches_everything_and_shows_where_it_is(look: Look, place: str) -> None:
    page = look(f"{place}/#job=hands")
    expect(page.locator("#workers tbody tr").first).to_be_visible()
    page.keyboard.press("Tab")
    assert page.evaluate("() => document.activeElement.id") == "skip"
    assert {"theme", "jobs", "runs", "scene", "workers", "events"} <= reached_by_keys(page, 60)


def test_the_skip_link_leads_to_the_job_and_keeps_the_choice(look: Look, place: str) -> None:
    page = look(f"{place}/#job=hands")
    expect(page.locator("#name")).to_have_text("hands")
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    assert page.evaluate("() => document.activeElement.id") == "main"
    assert page.url.endswith("#job=hands")


def test_the_token_opens_the_page_and_leaves_the_address(look: Look) -> None:
    feed = FakeFeed().step()
    with serving(feed, 0, "a-token-of-some-length") as place:
        page = look(place)
        page.get_by_label("Token").fill("a-token-of-some-length")
        page.keyboard.press("Enter")
        expect(page.locator("#link")).to_have_text("live")
        assert page.url == f"{place}/"
        page.context.close()


OVER = run("over", evaluations=1000, cells=100, finished="its budget is spent")


class Recorded(FakeLibrary):
    """A library that knows how the run `over` of `mugs` grew: all its cells came at once."""

    def runs(self, job: str) -> bytes:
        known = {name: getattr(OVER, name) for name in RunListing.__struct_fields__}
        return to_json(RunListings(runs=[RunListing(**known)]))

    def scene(self, job: str, run: str) -> bytes:
        return super().scene(job, "mug")

    def curve(self, job: str, run: str) -> bytes:
        grown = curve(run, *range(100, 1001, 100))
        points = [replace(point, cells=100) for point in grown.points]
        return to_json(replace(grown, points=points))


def test_the_curve_of_a_run_that_nobody_watched_is_the_recorded_one(chromium: Any) -> None:
    feed = FakeFeed()
    feed.jobs.receive_answers(values(), time.time())
    with serving(feed, library=Recorded()) as place:
        visit = browser.Visit(chromium, f"{place}/#job=mugs&run=over")
        over, legend = visit.page.locator("#cells .u-over"), visit.page.locator("#cells-legend dd")
        over.wait_for()
        box, nudges = over.bounding_box(), count()
        assert box is not None
        wait_for(lambda: under(visit.page, legend, box["x"] + 0.4 * box["width"] + next(nudges) % 3) == "100")
        visit.context.close()
        assert visit.complaints == []


def under(page: Any, legend: Any, x: float) -> str:
    """The legend's words on the cells at the cursor."""
    page.mouse.move(x, page.locator("#cells .u-over").bounding_box()["y"] + 9)
    return str(legend.inner_text())
